"""One measurement by a cell of our own, followed to its closed Run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from app.cli.terminal import NotedProgress, say
from app.errors import MeasurementFailed
from app.jobs.live_estimation import LiveEstimation, LiveSteering
from app.jobs.live_process import LiveEstimateOrder
from app.measurement.cell import Cell
from app.measurement.messages import (
    CellState,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from app.motion.configurations import Commanded

SILENCE_S = 30.0  # without a word from the cell process: something is broken


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
    with ExitStack() as stack:
        stack.callback(cell.close)
        cell.start()
        cell.connect()
        steering = None
        if target_um is not None or order.grows:
            asked = LiveEstimateOrder(order.machine, order.commanded, request=request)
            live = LiveEstimation(asked, lambda _: None)
            stack.callback(live.close)
            live.start()
            first = order.commanded if order.grows else None
            steering = LiveSteering(live, cell, first, target_um, _say_part)
        cell.begin(replace(order, live=steering is not None))
        return _follow_events(cell, on_progress, steering)


def _follow_events(
    cell: Cell, on_progress: NotedProgress, steering: LiveSteering | None
) -> RunClosed:
    failure = MeasurementFailed("the measurement ended early")
    heard_s = time.monotonic()
    while time.monotonic() - heard_s < SILENCE_S:
        for event in cell.poll(0.2):
            heard_s = time.monotonic()
            match event:
                case MeasurementProgress():
                    on_progress(*_describe_progress(event))
                case FaultReported(text=text, action=action):
                    failure = MeasurementFailed("; ".join(filter(None, [text, action])))
                case RunClosed(outcome=CellState.FINISHED):
                    return event
                case RunClosed():
                    raise failure
                case _ if steering is not None:
                    steering.handle(event)
                case _:
                    pass
        if steering is not None:
            steering.advance()
        if not cell.alive:
            raise MeasurementFailed("the cell process has died; its Run can be opened")
    raise MeasurementFailed(f"the cell process is silent for {SILENCE_S:.0f} s")


def _say_part(_rows: Commanded, part: Mapping[str, Any]) -> None:
    lines = f"part {part['part']}: {part['rows']} lines, {part['duration_s']:.0f} s"
    say(f"{lines}; predicted to leave {2.0 * part['predicted_um']:.2f} µm (k = 2)")


def _describe_progress(event: MeasurementProgress) -> tuple[float, str, str]:
    share = event.done / event.total if event.total else 0.0
    lost = f"{event.samples} samples, {event.lost_samples} lost"
    return min(share, 1.0), event.stage, lost
