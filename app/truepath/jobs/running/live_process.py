"""Body of the process that estimates during motion.

An estimate follows as soon as blocks complete a line or a point: in the form of
`result.json`, µm, µrad, k = 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from multiprocessing.connection import Connection
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

from truepath.files.bundle.run import PointBlock
from truepath.files.earlier.verdict import verdict_json
from truepath.kinematics.machine.machine import Machine
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.motion.configurations import Commanded, Configurations, append_part
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path, TrackerSamples

if TYPE_CHECKING:
    from truepath.estimation.live.live import LiveEstimator
    from truepath.estimation.live.segment_check import PreviousRun
    from truepath.planning.adaptive_plan import AdaptivePlanner, Part
    from truepath.planning.plan_request import PlanRequirements

_BEHIND, _AHEAD = 2, 10
"""Rows before and after the newest whose predicted positions are reported."""
_GATHER_S = 0.2
"""Blocks of this time are collected before the tables are solved for once."""
_MICRO = 1e3  # mm to µm


@dataclass(frozen=True, slots=True)
class LiveEstimateOrder:
    """Measurement to estimate.

    request : as in `plan_requests`: the model whose effects are estimated too, and the
        aim of the further parts of an adaptive measurement
    total : planned lines or points, where they are commanded part by part
    earlier_files : Runs of the measurement that is resumed
    """

    machine: Machine
    commanded: Path | Configurations
    perpendicular_only: bool = False
    request: Mapping[str, Any] | None = None
    total: int = 0
    earlier_files: tuple[str, ...] = ()


class LiveCommand(Enum):
    """Sent to the process between blocks."""

    CHOOSE_PART = "choose what to drive next"
    END = "no block follows"


@dataclass(frozen=True, slots=True)
class Estimated:
    """Sent by the process: an estimate as in `GET /jobs/{id}/estimate`."""

    body: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class PartChosen:
    """Sent by the process: the reply to `CHOOSE_PART`."""

    part: Part


@dataclass(frozen=True, slots=True)
class EstimateFailed:
    """Sent by the process: no further estimate, with the reason."""

    reason: str


def estimate_live(order: LiveEstimateOrder, link: Connection) -> None:
    """Estimate until the last block or the end of the parent process.

    link : TrackerSamples or PointBlocks come in order, between them CHOOSE_PART, at
        last END
    """
    try:
        _estimate(link, order)
    except (EOFError, OSError):
        return
    except Exception as error:  # ends the live estimate alone
        with suppress(OSError):
            link.send(EstimateFailed(f"{type(error).__name__}: {error}"))


def _estimate(link: Connection, order: LiveEstimateOrder) -> None:
    # Imported where it computes: the service itself carries no science.
    from truepath.estimation.live.live import LiveEstimator
    from truepath.estimation.live.segment_check import align_earlier
    from truepath.jobs.running.plan_requests import read_plan_requirements

    files = order.earlier_files
    earlier = align_earlier([open_recorded(FilePath(file)) for file in files])
    request = read_plan_requirements(order.request or {})
    live = LiveEstimator(
        order.machine,
        order.commanded,
        perpendicular_only=order.perpendicular_only,
        known=request.select_effects(order.machine),
        earlier=earlier,
    )
    chooser = _PartChooser(order, request, live, earlier)
    stream = _Stream(link)
    while not stream.is_over:
        is_new = False
        blocks = stream.gather()
        for part in stream.pop_parts():
            chooser.extend(part)
            is_new = True
        for block in blocks:
            is_new = live.add_block(block) or is_new
        if stream.is_over:
            is_new = live.finish()
        if is_new:
            _send_live_estimate(link, live, chooser, stream)
        if stream.is_part_requested:
            stream.is_part_requested = False
            part = chooser.next()
            link.send(PartChosen(part))
            if part.rows:  # its first line is to be known as commanded
                _send_live_estimate(link, live, chooser, stream)


def _send_live_estimate(
    link: Connection, live: LiveEstimator, chooser: _PartChooser, stream: _Stream
) -> None:
    now, begun_s = live.estimate(), stream.begun_s or 0.0
    if now is None:
        return
    body = {
        **estimate_json(now),
        "notices": [notice_json(n, begun_s) for n in live.list_notices()],
        "total": chooser.total,
        "elapsed_s": round(now.time_s - begun_s, 4),
        **_state_rows(live),
    }
    link.send(Estimated({**body, "is_last": stream.is_over}))


class _PartChooser:
    def __init__(
        self,
        order: LiveEstimateOrder,
        request: PlanRequirements,
        live: LiveEstimator,
        earlier: Sequence[PreviousRun],
    ) -> None:
        self._order, self._request, self._live = order, request, live
        self._earlier = earlier
        self._choice: AdaptivePlanner | None = None
        self._commanded = order.commanded
        self.total = max(_count(order.commanded), order.total)

    def extend(self, part: Commanded) -> None:
        self._commanded = append_part(self._commanded, part)
        self._live.extend(self._commanded)
        self.total = max(self.total, _count(self._commanded))

    def next(self) -> Part:
        from truepath.planning.adaptive_plan import AdaptivePlanner, Part

        if self._choice is None:
            order = self._order
            self._choice = AdaptivePlanner(
                order.machine, order.commanded, self._request, self._earlier
            )
        now, found = self._live.estimate(), self._live.findings()
        if now is None or found is None:
            return Part(None)  # too little is known so far to continue
        part = self._choice.next(found, now.volumetric_sigma_mm)
        self._live.extend(self._choice.commanded)
        self.total += part.rows
        return part


def _count(commanded: Commanded) -> int:
    return len(commanded) - isinstance(commanded, Path)


class _Stream:
    """Blocks of the link, gathered for `_GATHER_S`.

    begun_s : the tracker's clock at the first sample, None before it
    is_part_requested : a part has been requested after the blocks so far
    """

    def __init__(self, link: Connection) -> None:
        self._link = link
        self.is_over = self.is_part_requested = False
        self.begun_s: float | None = None
        self._parts: list[Commanded] = []

    def pop_parts(self) -> list[Commanded]:
        parts, self._parts = self._parts, []
        return parts

    def gather(self) -> list[TrackerSamples | PointBlock]:
        blocks = self._receive()
        until_s = host_clock.now_s() + _GATHER_S
        while (left_s := until_s - host_clock.now_s()) > 0:
            if self.is_over or self.is_part_requested:
                break
            if self._link.poll(left_s):
                blocks += self._receive()
        return blocks

    def _receive(self) -> list[TrackerSamples | PointBlock]:
        match self._link.recv():
            case LiveCommand.CHOOSE_PART:
                self.is_part_requested = True
            case LiveCommand.END:
                self.is_over = True
            case Path() | Configurations() as part:
                self._parts.append(part)
            case block:
                self._note_begin(block)
                return [block]
        return []

    def _note_begin(self, block: TrackerSamples | PointBlock) -> None:
        samples = block.samples if isinstance(block, PointBlock) else block
        if self.begun_s is None and len(samples):
            self.begun_s = float(samples.device_time_s[0])


def estimate_json(now: Any) -> dict[str, Any]:
    """A LiveEstimate in the form of `result.json`."""
    from truepath.results.error_tables import build_error_tables
    from truepath.results.result_assessment import assess_live

    tables = build_error_tables(now)
    places = {
        place.symbol: _number(place, f"_{place.unit}") for place in tables.locations
    }
    return {
        "verdict": verdict_json(assess_live(now.check, now.done)),
        "volumetric_uncertainty_um": round(_MICRO * now.volumetric_sigma_mm, 4),
        "done": now.done,
        "cells": now.cells,
        "device_time_s": round(now.time_s, 4),
        "error_tables": {table.symbol: _table(table) for table in tables.tables},
        "squareness_urad": {s.symbol: _number(s) for s in tables.squareness},
        **({"axis_location": places} if places else {}),
    }


def _state_rows(live: LiveEstimator) -> dict[str, Any]:
    """Predicted positions in the tracker's frame; {} for points."""
    found, places = live.findings(), live.find_commanded_mm()
    if found is None or places is None:
        return {}
    newest = max(found.rows, default=0)
    first = max(newest - _BEHIND, 0)
    shown = places[first : newest + _AHEAD + 1].round(4).tolist()
    return {"commanded": {"first_row": first, "tracker_mm": shown}}


def notice_json(notice: Any, begun_s: float) -> dict[str, Any]:
    """A Notice in the form of the job; times from `begun_s`."""
    return {
        "number": notice.number,
        "kind": notice.kind,
        "grade": notice.grade,
        "axis": notice.axis,
        "since_row": notice.since_row,
        "noticed_row": notice.noticed_row,
        "noticed_s": round(notice.noticed_s - begun_s, 2),
        "size_um": round(_MICRO * notice.size_mm, 2),
        "uncertainty_um": round(_MICRO * notice.sigma_mm, 2),
        "is_over": notice.is_over,
    }


def _number(found: Any, unit: str = "") -> dict[str, float]:
    values = round(found.value, 3), round(found.uncertainty, 3)
    return {f"value{unit}": values[0], f"uncertainty{unit}": values[1]}


def _table(table: Any) -> Mapping[str, Any]:
    return {
        f"position_{table.position_unit}": table.position_mm.round(3).tolist(),
        f"value_{table.unit}": table.value.round(3).tolist(),
        f"uncertainty_{table.unit}": table.uncertainty.round(3).tolist(),
    }
