"""One measurement by a cell of our own, followed to its closed Run."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from app.cli.terminal import NotedProgress, say
from app.errors import MeasurementFailed
from app.jobs.live_estimation import LiveEstimation, PartSupplier
from app.jobs.live_process import LiveEstimateOrder
from app.measurement.cell import Cell
from app.measurement.messages import (
    BlockRecorded,
    CellEvent,
    CellState,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    PartRequested,
    RunClosed,
    StateChanged,
)
from app.motion.configurations import Commanded

SILENCE_S = 30.0  # without a word from the cell process: something is broken
_ENDED_BADLY = frozenset({CellState.ABORTED, CellState.FAILED, CellState.FAULTED})


def follow_measurement(
    cell: Cell,
    order: MeasurementOrder,
    on_progress: NotedProgress,
    *,
    target_um: float | None = None,
    request: Mapping[str, Any] | None = None,
) -> RunClosed:
    """Measure and return what the cell said of the closed Run.

    target_um : volumetric uncertainty (k = 1) at which the rest of the path is left out
    request : within what further parts are planned, as `plan_orders` states it

    Raises DeviceError, MeasurementFailed. Stops the machine on the way out in any case.
    """
    cell.start()
    try:
        cell.connect()
        with _live_estimation(order, target_um, request) as live:
            supplier = None
            if order.grows and live is not None:
                supplier = PartSupplier(
                    live, order.commanded, cell.extend, cell.conclude, _say_part
                )
            cell.begin(replace(order, live=live is not None))
            follower = _Follower(cell, on_progress, live, target_um or 0.0, supplier)
            return follower.follow()
    finally:
        cell.close()


@contextmanager
def _live_estimation(
    order: MeasurementOrder, target_um: float | None, request: Mapping[str, Any] | None
) -> Iterator[LiveEstimation | None]:
    if target_um is None and not order.grows:
        yield None
        return
    live_order = LiveEstimateOrder(order.machine, order.commanded, request=request)
    live = LiveEstimation(live_order, lambda _: None)
    try:
        live.start()
        yield live
    finally:
        live.close()


@dataclass(slots=True)
class _Follower:
    """Follows the events of a cell until its Run is closed."""

    cell: Cell
    on_progress: NotedProgress
    live: LiveEstimation | None
    target_um: float
    supplier: PartSupplier | None
    is_concluded: bool = False
    has_ended_badly: bool = False
    failure: Exception = field(
        default_factory=lambda: MeasurementFailed("the measurement ended early")
    )

    def follow(self) -> RunClosed:
        heard_s = time.monotonic()
        while time.monotonic() - heard_s < SILENCE_S:
            for event in self.cell.poll(0.2):
                heard_s = time.monotonic()
                self._handle(event)
                if isinstance(event, RunClosed):
                    if self.has_ended_badly:
                        raise self.failure
                    return event
            self._conclude_or_extend()
            if not self.cell.alive:
                raise MeasurementFailed(
                    "the cell process has died; its Run can be opened"
                )
        raise MeasurementFailed(f"the cell process is silent for {SILENCE_S:.0f} s")

    def _handle(self, event: CellEvent) -> None:
        match event:
            case BlockRecorded(samples) if self.live is not None:
                self.live.offer(samples)
            case PartRequested() if self.supplier is not None:
                self.supplier.ask()
            case MeasurementProgress():
                self.on_progress(*_describe_progress(event))
            case FaultReported(text=text, action=action):
                message = "; ".join(filter(None, [text, action]))
                self.failure = MeasurementFailed(message)
            case StateChanged(state) if state in _ENDED_BADLY:
                self.has_ended_badly = True

    def _conclude_or_extend(self) -> None:
        if self.is_concluded:
            return
        if _has_reached(self.live, self.target_um):
            self.cell.conclude()
            self.is_concluded = True
        elif self.supplier is not None:
            self.supplier.pass_on()


def _say_part(_rows: Commanded, part: Mapping[str, Any]) -> None:
    lines = f"part {part['part']}: {part['rows']} lines, {part['duration_s']:.0f} s"
    say(f"{lines}; predicted to leave {2.0 * part['predicted_um']:.2f} µm (k = 2)")


def _has_reached(live: LiveEstimation | None, target_um: float) -> bool:
    newest = live.newest if live is not None else None
    return newest is not None and newest["volumetric_uncertainty_um"] <= target_um


def _describe_progress(event: MeasurementProgress) -> tuple[float, str, str]:
    share = event.done / event.total if event.total else 0.0
    lost = f"{event.samples} samples, {event.lost_samples} lost"
    return min(share, 1.0), event.stage, lost
