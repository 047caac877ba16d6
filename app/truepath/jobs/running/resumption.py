"""What the plan of a job keeps of its measurement, and whether it can be resumed.

The plan names the parts of an interrupted measurement: one Run each, with its first
row. Once armed again, the machine revisits its last standstills, and only if the target
is where it was are the remaining rows measured, as a further Run. Recorded data are not
changed; the analysis takes all parts.

At a station of several, known points come first. If the target is where it was at them,
the station is unchanged. If not, the tracker or the reflector was moved, and the
operator decides. Continued from there, the rest is a separate station, for every Run
has its own pose; its known points have to fit those before by a rigid motion, as
between any two stations.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from truepath.catalogue.errors import MachineFileChanged, NotResumable
from truepath.catalogue.job import Job, JobKind, Json, Stage
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.transitions import LEFT_BY_ACKNOWLEDGE
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.one_machine import list_differences
from truepath.kinematics.machine.machine import Machine
from truepath.machines.machine_cells import MachineCell
from truepath.motion.configurations import (
    Commanded,
    Configurations,
    select_rows,
    split_by_target,
)
from truepath_drivers.interfaces.records import Path

CLOSURE_DWELL_S = 1.5
_FEWEST = 6  # lines or points of a part: fewer do not determine its pose
_MEASURED = frozenset(
    {
        Stage.ALIGNING,
        Stage.ESTIMATING,
        Stage.VALIDATING,
        Stage.DISCOVERING,
        Stage.REPORTING,
    }
)
_VERBS: Mapping[JobKind, str] = {
    JobKind.ANALYSE: "analyse",
    JobKind.DISCOVER: "discover in",
}


def list_part_ids(plan: Json) -> list[str]:
    """Runs of the parts of a plan, made or about to be made."""
    return [part["run_id"] for part in plan.get("parts", ())]


def list_run_ids(plan: Json, key: str = "run_id") -> list[str]:
    """Runs of the stations of a plan, made or about to be made.

    key : `points_id` for those of the known points
    """
    stations = plan.get("stations", ())
    made = (one.get(key) for s in stations for one in (*s.get("parts", ()), s))
    return list(dict.fromkeys(run_id for run_id in made if run_id))


def list_analysed_ids(plan: Json) -> list[str]:
    """Runs of the measured stations of a plan."""
    measured = [s for s in plan.get("stations", ()) if s.get("measured")]
    return [run_id for s in measured for run_id in s.get("run_ids") or [s["run_id"]]]


def count_measured(plan: Json) -> int:
    """Number of measured stations of a plan."""
    return sum(bool(s.get("measured")) for s in plan.get("stations", ()))


def choose_first_row(commanded: Commanded, next_row: int) -> int:
    """First row of a further part; some rows are repeated where few are left.

    A line begins at the end of the previous one. At least six rows of the current
    target follow, so that the part determines its own pose.
    """
    first, end = find_target(commanded, next_row)
    latest = max(end - _FEWEST, first)
    if isinstance(commanded, Path):
        return max(min(next_row, latest) - 1, first)
    return min(next_row, latest)


def find_target(commanded: Commanded, row: int) -> tuple[int, int]:
    """First row and end (exclusive) of the target that a row measures."""
    ends = np.cumsum([len(block) for block in split_by_target(commanded)])
    number = int(np.searchsorted(ends[:-1], row, side="right"))
    return int(ends[number - 1]) if number else 0, int(ends[number])


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


def select_remaining(station: Json) -> Commanded:
    """Remaining rows of a station, as the plan keeps it."""
    commanded, resumption = decode_commanded_json(station), station.get("resumption")
    if resumption is None:
        return commanded
    return select_rows(commanded, slice(resumption["first_row"], None))


def list_kept_ids(station: Json) -> list[str]:
    """Runs of a station that the analysis takes in addition to its last."""
    return list((station.get("resumption") or {}).get("kept_run_ids", ()))


def make_resumption(
    station: Json, parts: Sequence[Json], found: Sequence[Json | None]
) -> dict[str, Any] | None:
    """How a station is resumed; None where all its rows are to be measured again.

    `first_row` of the station, `kept_run_ids`, and of the known points before the last
    of these `points_id` and `place_mm`, the target position at the last of them.

    parts : `run_id`, `points_id` and `first_row` of each Run of the station
    found : progress of each Run, then of each set of known points, as in
        `find_committed_rows`
    """
    pairs = zip(parts, found[: len(parts)], found[len(parts) :], strict=True)
    usable = [(part, run, points) for part, run, points in pairs if run and points]
    if not usable:
        return None
    last, run, points = usable[-1]
    reached = last["first_row"] + run["next_row"]
    return {
        "first_row": choose_first_row(decode_commanded_json(station), reached),
        "kept_run_ids": [part["run_id"] for part, _, _ in usable],
        "points_id": last["points_id"],
        "place_mm": points["place_mm"],
    }


def require_resumable(job: Job, plan: Json | None) -> None:
    """Raise NotResumable where no further part can complete a measurement."""
    if job.state not in LEFT_BY_ACKNOWLEDGE:
        return
    if reason := _find_reason(job, plan or {}):
        raise NotResumable(f"job {job.id} ({job.kind}) cannot go on: {reason}")


def can_go_on(job: Job, plan: Json | None) -> bool:
    """Whether a measurement was interrupted and its remaining rows can be measured."""
    is_cut_short = job.kind.measures and job.state in LEFT_BY_ACKNOWLEDGE
    return is_cut_short and not _find_reason(job, plan or {})


def may_be_acknowledged(job: Job) -> bool:
    """Whether the job alone permits resumption.

    With several stations the plan decides: the stage `aligning` may be their check.
    """
    is_left = job.kind.measures and job.state in LEFT_BY_ACKNOWLEDGE
    checks = job.station is not None and job.stage is Stage.ALIGNING
    return is_left and (checks or not _find_reason(job, {}))


def find_way_to_result(job: Job) -> str:
    """Advice on analysing the Runs of a job interrupted after its last row.

    Empty for any other job.
    """
    is_left = job.kind.measures and job.state in LEFT_BY_ACKNOWLEDGE
    if not is_left or may_be_acknowledged(job):
        return ""
    if job.stage not in _MEASURED:
        return ""
    kind = _name_analysis(job.kind)
    order = json.dumps({"kind": str(kind), "run_ids": list(job.run_ids)})
    return (
        f"All rows are measured: {_VERBS[kind]} its Runs by a new job, POST /jobs "
        f"{order}; nothing has to be measured again."
    )


def require_machine_file(
    job: Job, driven: MachineCell, registry: MachineRegistry | None
) -> None:
    """Raise MachineFileChanged if a machine was measured under another file.

    Unknown versions are compared by the worker that reads the Runs.
    """
    if registry is None or job.machine is None or job.machine_version is None:
        return
    before = registry.find_version(job.machine, job.machine_version)
    if before is None:
        return
    measured = machine_from_json(before.machine_file)
    if changed := list_differences(measured, driven.machine):
        raise MachineFileChanged(
            f"job {job.id} cannot go on: machine {driven.id} is described otherwise "
            f"in version {driven.version} than in version {before.number}, by which "
            f"it was measured: {'; '.join(changed)}; put the machine file of version "
            f"{before.number} back and acknowledge again, or begin a new job"
        )


def require_targets_apart(plan: Json | None, machine: Machine) -> None:
    """Raise NotResumable where several targets have to be measured in one Run.

    With rotary axes, and with targets on tool and workpiece, Runs of one target each do
    not locate the axes. Otherwise every Run has a separate pose, and each target
    determines the same error motions at its offset.
    """
    rows = (plan or {}), *(plan or {}).get("stations", ())
    names = {name for one in rows for name in one.get("target", ())}
    sides = {target.on for target in machine.targets if target.name in names}
    if len(names) > 1 and (machine.rotary_axes or len(sides) > 1):
        raise NotResumable(
            f"the targets {', '.join(sorted(names))} have to be measured in one Run on "
            f"{machine.name}: it has rotary axes, or targets on tool and workpiece; "
            "what was recorded is kept; begin a new job"
        )


def _find_reason(job: Job, plan: Json) -> str:
    kept = f"what was recorded is kept{f' as Run {job.run_id}' if job.run_id else ''}"
    if not job.kind.measures:
        return f"it only computes; {kept}; begin a new job"
    if job.kind is JobKind.VERIFY:  # no other job holds a result against its Runs
        return ""
    stations = plan.get("stations", ())
    is_measured = job.stage in _MEASURED
    if stations:  # their checks are computed in a stage of the analysis
        is_measured = all(station.get("measured") for station in stations)
    if is_measured:
        kind = _name_analysis(job.kind)
        return f"all its rows are measured; {_VERBS[kind]} its Runs; {kept}"
    return ""


def _name_analysis(kind: JobKind) -> JobKind:
    return JobKind.DISCOVER if kind.discovers else JobKind.ANALYSE
