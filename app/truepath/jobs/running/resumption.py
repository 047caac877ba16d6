"""Resumption of a measurement that the service, or a fault, has interrupted.

The plan of the job keeps its parts: one Run each, with its first row. After
`acknowledge` a worker reads the progress of the last part; the job waits to be armed
like any other. Once armed, the machine revisits its last standstills, and only if the
target is where it was are the remaining rows measured, as a further Run. Recorded data
are not changed; the analysis takes all parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import structlog

from truepath.catalogue.errors import MachineFault
from truepath.catalogue.job import Job, Json, Stage, make_id
from truepath.catalogue.transitions import State
from truepath.errors import MeasurementFailed
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.fixed_path_measurement import measure_rows
from truepath.motion.configurations import (
    Commanded,
    Configurations,
    join_rows,
    select_rows,
    split_by_target,
)
from truepath_drivers.interfaces.records import Path

CLOSURE_DWELL_S = 1.5
_SAME = 1e-5  # mm or deg: as rows are rounded where they are kept
_FEWEST = 6  # lines or points of a part: fewer do not determine its pose
CLOSURE_CODE = "closure"
_REMEDY = (
    "Look at reflector, its nest and the tracker: one of them has moved since. Put it "
    "back and acknowledge the job to check again, or measure anew; what was recorded "
    "is kept."
)

log = structlog.get_logger(__name__)


def list_part_ids(plan: Json) -> list[str]:
    """Runs of the parts of a plan, made or about to be made."""
    return [part["run_id"] for part in plan.get("parts", ())]


def choose_first_row(commanded: Commanded, next_row: int) -> int:
    """First row of a further part; some rows are repeated where few are left.

    A line begins at the end of the previous one. At least six rows of the current
    target follow, so that the part determines its own pose.
    """
    first, end = _find_target(commanded, next_row)
    latest = max(end - _FEWEST, first)
    if isinstance(commanded, Path):
        return max(min(next_row, latest) - 1, first)
    return min(next_row, latest)


def _find_target(commanded: Commanded, row: int) -> tuple[int, int]:
    """First row and end (exclusive) of the target that a row measures."""
    ends = np.cumsum([len(block) for block in split_by_target(commanded)])
    number = int(np.searchsorted(ends[:-1], row, side="right"))
    return int(ends[number - 1]) if number else 0, int(ends[number])


def _append_later_rows(plan: Json, base: int, told: Commanded) -> Commanded:
    """A measurement that chooses rows as it moves may have commanded more than the plan
    could store.

    base : row of the plan that the Run begins with

    Raises MeasurementFailed where the plan is another one.
    """
    planned = decode_commanded_json(plan)
    both = min(len(planned) - base, len(told))
    apart = planned.position[base : base + both] - told.position[:both]
    if np.abs(apart).max(initial=0.0) > _SAME:
        raise MeasurementFailed(
            "the rows that are kept with the job are not those that its Run was told; "
            "begin a new job and analyse the Runs of both together"
        )
    more = select_rows(told, slice(both, None))
    left = select_rows(planned, slice(base + both, None))
    return join_rows([select_rows(planned, slice(base + both)), more, left])


@dataclass(frozen=True, slots=True)
class Resumption:
    """How a measurement is resumed, as the plan keeps it.

    first_row : of the plan, where the further part begins
    kept_run_ids : of the parts that the analysis takes
    closure_row : rows of the plan to revisit before; the last ones are compared
    place_mm : previous target positions there, in the tracker's frame
    """

    first_row: int
    kept_run_ids: tuple[str, ...]
    closure_row: tuple[int, ...]
    place_mm: tuple[tuple[float, ...], ...]

    @classmethod
    def read(cls, plan: Json) -> Resumption | None:
        """None for a plan that begins at its first row."""
        found = plan.get("resumption")
        if found is None:
            return None
        return cls(
            found["first_row"],
            tuple(found["kept_run_ids"]),
            tuple(found["closure_row"]),
            tuple(tuple(place) for place in found["place_mm"]),
        )

    @property
    def continuation(self) -> tuple[int, tuple[str, ...]]:
        """First row of the further part, and the Runs before it."""
        return self.first_row, self.kept_run_ids

    def select_rest(self, commanded: Commanded) -> Commanded:
        """Remaining rows; a path begins where the machine is."""
        return select_rows(commanded, slice(self.first_row, None))

    def select_closure(self, commanded: Commanded) -> Configurations:
        """Standstills of the closure check."""
        rows = list(self.closure_row)
        return Configurations(
            commanded.axes,
            commanded.position[rows],
            np.full(len(rows), CLOSURE_DWELL_S),
            tuple(commanded.target[row] for row in rows if commanded.target),
        )


@dataclass(frozen=True, slots=True)
class ResumedSteps:
    """Steps of a job that is resumed.

    compute : runs a task in the executor
    """

    job: Job
    active: ActiveJob
    context: JobContext
    compute: Callable[..., Any]

    def prepare(self) -> None:
        """Find the progress of the job; store with its plan how it is resumed."""
        plan = dict(self.context.store.read_plan(self.job.id) or {})
        parts = plan.get("parts") or [{"run_id": self.job.id, "first_row": 0}]
        recorded = set(self.context.runs.find([part["run_id"] for part in parts]))
        parts = [part for part in parts if part["run_id"] in recorded]
        plan |= {"parts": parts, "resumption": None, **self._find(plan, parts)}
        found = plan["resumption"]
        self.context.store.store_plan(self.job.id, plan)
        log.info("the measurement can go on", row=found and found["first_row"])

    def _find(self, plan: Json, parts: Sequence[Json]) -> Mapping[str, Any]:
        """Empty where no recorded data can be used."""
        files = [str(self.context.runs.file(part["run_id"])) for part in parts]
        found = self.compute(
            State.PREPARING,
            Stage.PLANNING,
            self.context.resumer,
            files,
            self.context.require_machine(),
        )
        usable = [k for k, one in enumerate(found) if one is not None]
        if not usable:
            return {}
        last, base = found[usable[-1]], parts[usable[-1]]["first_row"]
        commanded = _append_later_rows(
            plan, base, decode_commanded_json(last["commanded"])
        )
        rows = [base + row for row in last["row"]]
        first, _ = _find_target(commanded, rows[-1])
        rows = [row for row in rows if row >= first]  # no target is changed
        resumption = {
            "first_row": choose_first_row(commanded, base + last["next_row"]),
            "kept_run_ids": [parts[k]["run_id"] for k in usable],
            # One row more: the first place is then come to from where it was before.
            "closure_row": [*range(max(rows[0] - 1, first), rows[0]), *rows],
            "place_mm": last["place_mm"][-len(rows) :],
        }
        return {**encode_commanded_json(commanded), "resumption": resumption}

    def begin_part(self, resumption: Resumption, commanded: Commanded) -> str:
        """Check the closure; gives the Run of the part to be measured.

        Raises MachineFault where the target is not where it was.
        """
        run_id, closure_id = make_id(), make_id()
        part = {"run_id": run_id, "first_row": resumption.first_row}
        points = resumption.select_closure(commanded)
        measure_rows(
            self.job, self.active, self.context, points, closure_id, what="closure"
        )
        self._require_closure(resumption, closure_id)
        self._append_part({**part, "closure_id": closure_id})
        return run_id

    def list_kept(self, resumption: Resumption | None) -> tuple[str, ...]:
        """Runs that the answer takes in addition to the part to be measured.

        Of extra lines those of the discovery come first.
        """
        plan = self.context.store.read_plan(self.job.id) or {}
        own = {self.job.id, *list_part_ids(plan)}
        others = tuple(run_id for run_id in self.job.run_ids if run_id not in own)
        return (*others, *(() if resumption is None else resumption.kept_run_ids))

    def start_over(self) -> str:
        """Run of a part from the first row, where no earlier Run can be used."""
        run_id = make_id()
        self._append_part({"run_id": run_id, "first_row": 0})
        return run_id

    def _append_part(self, part: Json) -> None:
        plan = dict(self.context.store.read_plan(self.job.id) or {})
        plan["parts"] = [*plan["parts"], part]
        self.context.store.store_plan(self.job.id, plan)

    def _require_closure(self, resumption: Resumption, closure_id: str) -> None:
        found = self.compute(
            State.RUNNING,
            Stage.MEASURING,
            self.context.closer,
            str(self.context.runs.file(closure_id)),
            resumption.place_mm,
        )
        log.info("closure checked", **found)
        if found["problem"]:
            raise MachineFault(CLOSURE_CODE, found["problem"], _REMEDY)
