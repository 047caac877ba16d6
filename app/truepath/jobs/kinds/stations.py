"""Measurement from several stations of the tracker, one Run each.

Known points come first at every station: they show that the tracker was moved, sees the
targets, and agrees with the station before. Between stations the job waits until an
operator moves the tracker and arms it again. A station that contradicts the known
points is repeated, with the reason shown. The Runs of each station are catalogued, and
named in the plan, before the next one begins: a job that ended early is continued from
there; an interrupted station resumes with its remaining rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from truepath.catalogue.errors import MachineFault, MeasurementEnded
from truepath.catalogue.job import (
    Json,
    Stage,
    StationCheck,
    StationProgress,
    make_id,
)
from truepath.catalogue.transitions import State
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.jobs.kinds.job_steps import MachineSteps
from truepath.jobs.kinds.motion import measure_fixed_rows
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.arming import hash_commanded, list_commanded
from truepath.jobs.running.resumption import (
    count_measured,
    list_analysed_ids,
    list_kept_ids,
    list_run_ids,
    make_resumption,
    select_remaining,
)
from truepath.motion.configurations import Commanded

_UNSEEN = frozenset({"beam-lost", "not-resumed"})
_ASKED = frozenset({"moved", "residual"})
_MOVED = "Put it back, or arm as it stands: the rest is then measured as a new station."

log = structlog.get_logger(__name__)


def begin_at_station(active: ActiveJob, plan: Json) -> None:
    """Show the first unmeasured station, if there are several."""
    stations = plan.get("stations", ())
    for number, station in enumerate(stations, start=1):
        if not station.get("measured"):
            active.store_values(station=_show(stations, number))
            return


def _show(stations: list[Json], number: int) -> StationProgress:
    place_mm = tuple(stations[number - 1]["position_mm"])
    return StationProgress(number, len(stations), place_mm)


class StationSteps:
    """The stations of one job, armed once for the first unmeasured one.

    poll_devices : polls the devices while the tracker is moved
    show_path : shows the path that waits to be armed; empty once it is armed
    """

    def __init__(
        self,
        steps: MachineSteps,
        poll_devices: Callable[[], None],
        show_path: Callable[[Sequence[Commanded]], None],
    ) -> None:
        self._steps, self._read_plan = steps, steps.read_plan
        self.job, self.active, self.context = steps.job, steps.active, steps.context
        self.poll_devices, self.show_path = poll_devices, show_path

    def prepare(self) -> None:
        """Find the progress of an interrupted station; store it in the plan."""
        plan = self._read_plan()
        number, runs = count_measured(plan) + 1, self.context.runs
        station = plan["stations"][number - 1]
        made = station.get("parts", ())
        known = set(runs.find(list_run_ids(plan) + list_run_ids(plan, "points_id")))
        parts = [p for p in made if {p["run_id"], p["points_id"]} <= known]
        ids = [part[key] for key in ("run_id", "points_id") for part in parts]
        found = self._steps.compute(
            State.PREPARING,
            Stage.PLANNING,
            self.context.resumer,
            [str(runs.file(run_id)) for run_id in ids],
            self.context.require_machine(),
        )
        resumption = make_resumption(station, parts, found)
        self._store_station(number, parts=list(made), resumption=resumption)
        log.info("the station can go on", station=number, resumption=resumption)

    def run(self) -> tuple[str, ...]:
        """Measure from every remaining station; gives the Runs of all."""
        plan = self._read_plan()
        first = count_measured(plan) + 1
        for number in range(first, len(plan["stations"]) + 1):
            if number > first:
                self._await_move(number)
            while not self._agrees(number):
                self._await_move(number)
            self._measure(number)
        return tuple(list_analysed_ids(self._read_plan()))

    def _await_move(self, number: int) -> None:
        progress = _show(self._read_plan()["stations"], number)
        checks = self._read_progress(number).checks
        self.active.store_values(
            station=StationProgress(
                progress.number, progress.total, progress.position_mm, checks
            )
        )
        log.info("the tracker is to be moved", station=number)
        parts = list_commanded(self._read_plan())
        self.show_path(parts)
        self.active.enter(State.AWAITING_MOVE, Stage.WAITING)
        try:
            self.active.wait_until_armed(hash_commanded(parts), self.poll_devices)
        finally:
            self.show_path(())

    def _agrees(self, number: int) -> bool:
        plan, points_id = self._read_plan(), make_id()
        self._store_station(number, points_id=points_id)
        points = decode_commanded_json(plan["known_points"])
        try:
            name = f"known points, station {number}"
            self._measure_rows(points, points_id, name, gives_up=True)
            check = self._compare(number)
        except MachineFault:
            raise
        except MeasurementEnded as error:
            self.active.checkpoint()
            if error.code not in _UNSEEN:
                raise
            check = StationCheck(number, problem="not-seen", text=str(error))
        progress = self._read_progress(number).add_check(check)
        self.active.store_values(station=progress)
        log.info("station checked", station=number, problem=check.problem or "none")
        return not check.problem

    def _compare(self, number: int) -> StationCheck:
        plan, runs = self._read_plan(), self.context.runs
        here = plan["stations"][number - 1]
        if here.get("resumption") is not None:
            return self._compare_with_itself(number, here)
        other = plan["stations"][number - 2 if number > 1 else 1]
        before = str(runs.file(other["points_id"])) if number > 1 else None
        asked_mm = math.dist(other["position_mm"], here["position_mm"])
        return self._check(number, before, asked_mm)

    def _compare_with_itself(self, number: int, here: Json) -> StationCheck:
        """If the tracker was moved meanwhile, the operator is asked; if it then stays
        there, it is a new station.
        """
        resumption, file = here["resumption"], self.context.runs.file
        closure = self._steps.compute(
            State.RUNNING,
            Stage.ALIGNING,
            self.context.closer,
            str(file(here["points_id"])),
            resumption["place_mm"],
        )
        by = {"residual_um": closure["step_um"], "allowed_um": closure["allowed_um"]}
        if not closure["problem"]:
            return StationCheck(number, **by)
        checks = self._read_progress(number).checks
        if any(c.station == number and c.problem in _ASKED for c in checks):
            return self._check(number, str(file(resumption["points_id"])), 0.0)
        text = f"{closure['problem']}: tracker or reflector was moved. {_MOVED}"
        return StationCheck(number, problem="moved", text=text, **by)

    def _check(self, number: int, before: str | None, asked_mm: float) -> StationCheck:
        plan = self._read_plan()
        here = plan["stations"][number - 1]
        found = self._steps.compute(
            State.RUNNING,
            Stage.ALIGNING,
            self.context.checker,
            str(self.context.runs.file(here["points_id"])),
            before,
            here["position_mm"],
            asked_mm,
            plan["specification"],
        )
        return StationCheck(number, **found)

    def _measure(self, number: int) -> None:
        station = self._read_plan()["stations"][number - 1]
        is_first = number == 1 and not station.get("run_id")
        run_id = self.job.id if is_first else make_id()
        part = {
            "run_id": run_id,
            "points_id": station["points_id"],
            "first_row": (station.get("resumption") or {}).get("first_row", 0),
        }
        self._store_station(
            number, run_id=run_id, parts=[*station.get("parts", ()), part]
        )
        run_ids = [*list_kept_ids(station), run_id]
        try:
            self._measure_rows(
                select_remaining(station), run_id, f"station {number}", gives_up=False
            )
            self._store_station(number, measured=True, run_ids=run_ids)
        finally:
            self._store_runs()

    def _measure_rows(
        self, commanded: Commanded, run_id: str, what: str, *, gives_up: bool
    ) -> None:
        measure_fixed_rows(
            self._steps,
            commanded,
            run_id,
            what,
            gives_up=_UNSEEN if gives_up else (),
        )

    def _store_runs(self) -> None:
        known = self.context.runs.find(list_run_ids(self._read_plan()))
        if known:
            self.active.store_values(run_id=known[0], further_run_ids=tuple(known[1:]))

    def _read_progress(self, number: int) -> StationProgress:
        now = self.context.store.get(self.job.id).station
        return now or _show(self._read_plan()["stations"], number)

    def _store_station(self, number: int, **values: Any) -> None:
        plan = dict(self._read_plan())
        plan["stations"] = [
            {**station, **values} if k == number else station
            for k, station in enumerate(plan["stations"], start=1)
        ]
        self.context.store.store_plan(self.job.id, plan)
