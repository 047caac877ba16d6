"""Going on with a measurement that the service, or a fault, has cut short.

The plan of the job keeps its parts: one Run each, with the row it begins at. After
`acknowledge` a worker reads how far the last part has got; the job waits to be armed
like any other. Armed, the machine stands again at the places where it stood last, and
only where the target is seen where it was are the rows that are left driven, as a
further Run. Nothing that was recorded is changed; the analysis takes all parts.
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
from truepath.jobs.running.row_measurement import measure_rows
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
_FEWEST = 6  # lines or points of a part: fewer tell too little of their own pose
CLOSURE_CODE = "closure"
_REMEDY = (
    "Look at reflector, its nest and the tracker: one of them has moved since. Put it "
    "back and acknowledge the job to check again, or measure anew; what was recorded "
    "is kept."
)

log = structlog.get_logger(__name__)


def list_part_ids(plan: Json) -> list[str]:
    """Return the Runs of the parts of a plan, made or about to be made."""
    return [part["run_id"] for part in plan.get("parts", ())]


def choose_first_row(commanded: Commanded, next_row: int) -> int:
    """Return the row that a further part begins at; some again where few are left.

    A line begins where the one before has ended. Of the target that is measured there
    at least six rows follow, so that the part tells its own pose by it.
    """
    first, end = _find_target(commanded, next_row)
    latest = max(end - _FEWEST, first)
    if isinstance(commanded, Path):
        return max(min(next_row, latest) - 1, first)
    return min(next_row, latest)


def _find_target(commanded: Commanded, row: int) -> tuple[int, int]:
    """Return first row, and that after the last, of the target that a row measures."""
    ends = np.cumsum([len(block) for block in split_by_target(commanded)])
    number = int(np.searchsorted(ends[:-1], row, side="right"))
    return int(ends[number - 1]) if number else 0, int(ends[number])


def _join_told(plan: Json, base: int, told: Commanded) -> Commanded:
    """Return the rows of a plan, with those that its Run was told beyond them.

    What chooses rows on its way may have told its Run more than it could keep.

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
    """How a measurement goes on, as the plan keeps it.

    first_row : of the plan, where the further part begins
    kept_run_ids : of the parts that the analysis takes
    closure_row : rows of the plan to stand at before; the last ones are compared
    place_mm : where the target was there, in the tracker's frame
    """

    first_row: int
    kept_run_ids: tuple[str, ...]
    closure_row: tuple[int, ...]
    place_mm: tuple[tuple[float, ...], ...]

    @classmethod
    def read(cls, plan: Json) -> Resumption | None:
        """Return that of a plan; None where it begins from its first row."""
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
    def going_on(self) -> tuple[int, tuple[str, ...]]:
        """The row where the further part begins, and the Runs that it goes on from."""
        return self.first_row, self.kept_run_ids

    def select_rest(self, commanded: Commanded) -> Commanded:
        """Return the rows that are left; a path begins where the machine stands."""
        return select_rows(commanded, slice(self.first_row, None))

    def select_closure(self, commanded: Commanded) -> Configurations:
        """Return the standstills of the closure check."""
        rows = list(self.closure_row)
        return Configurations(
            commanded.axes,
            commanded.position[rows],
            np.full(len(rows), CLOSURE_DWELL_S),
            tuple(commanded.target[row] for row in rows if commanded.target),
        )


@dataclass(frozen=True, slots=True)
class ResumedSteps:
    """The steps of a job that goes on.

    compute : lets the executor compute a task
    """

    job: Job
    active: ActiveJob
    context: JobContext
    compute: Callable[..., Any]

    def prepare(self) -> None:
        """Find how far the job has got and keep with its plan how it goes on."""
        plan = dict(self.context.store.read_plan(self.job.id) or {})
        parts = plan.get("parts") or [{"run_id": self.job.id, "first_row": 0}]
        recorded = set(self.context.runs.find([part["run_id"] for part in parts]))
        parts = [part for part in parts if part["run_id"] in recorded]
        plan |= {"parts": parts, "resumption": None, **self._find(plan, parts)}
        found = plan["resumption"]
        self.context.store.keep_plan(self.job.id, plan)
        log.info("the measurement can go on", row=found and found["first_row"])

    def _find(self, plan: Json, parts: Sequence[Json]) -> Mapping[str, Any]:
        """Return a resumption, and the rows of the plan as its Runs were told them.

        Nothing where nothing that was recorded can be used.
        """
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
        commanded = _join_told(plan, base, decode_commanded_json(last["commanded"]))
        rows = [base + row for row in last["row"]]
        first, _ = _find_target(commanded, rows[-1])
        rows = [row for row in rows if row >= first]  # nobody changes the target
        resumption = {
            "first_row": choose_first_row(commanded, base + last["next_row"]),
            "kept_run_ids": [parts[k]["run_id"] for k in usable],
            # One row more: the first place is then come to from where it was before.
            "closure_row": [*range(max(rows[0] - 1, first), rows[0]), *rows],
            "place_mm": last["place_mm"][-len(rows) :],
        }
        return {**encode_commanded_json(commanded), "resumption": resumption}

    def begin_part(self, resumption: Resumption, commanded: Commanded) -> str:
        """Check the closure, then return the Run of the part that is to be driven.

        Raises MachineFault where the target is not where it was.
        """
        run_id, closure_id = make_id(), make_id()
        part = {"run_id": run_id, "first_row": resumption.first_row}
        points = resumption.select_closure(commanded)
        measure_rows(
            self.job, self.active, self.context, points, closure_id, what="closure"
        )
        self._require_closure(resumption, closure_id)
        self._keep_part({**part, "closure_id": closure_id})
        return run_id

    def list_kept(self, resumption: Resumption | None) -> tuple[str, ...]:
        """Return the Runs that the answer takes beside the part that is to be driven.

        Of extra lines those of the discovery that asks for them come first.
        """
        plan = self.context.store.read_plan(self.job.id) or {}
        own = {self.job.id, *list_part_ids(plan)}
        others = tuple(run_id for run_id in self.job.run_ids if run_id not in own)
        return (*others, *(() if resumption is None else resumption.kept_run_ids))

    def begin_anew(self) -> str:
        """Return the Run of a part from the first row: none before can be used."""
        run_id = make_id()
        self._keep_part({"run_id": run_id, "first_row": 0})
        return run_id

    def _keep_part(self, part: Json) -> None:
        plan = dict(self.context.store.read_plan(self.job.id) or {})
        plan["parts"] = [*plan["parts"], part]
        self.context.store.keep_plan(self.job.id, plan)

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
