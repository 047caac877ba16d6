"""Whether an interrupted measurement can be resumed, and the remedy if not."""

from __future__ import annotations

import json
from collections.abc import Mapping

from truepath.catalogue.errors import MachineFileChanged, NotResumable
from truepath.catalogue.job import Job, JobKind, Json, Stage
from truepath.catalogue.machine_registry import MachineRegistry
from truepath.catalogue.transitions import LEFT_BY_ACKNOWLEDGE
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.one_machine import list_differences
from truepath.kinematics.machine.machine import Machine
from truepath.machines.machine_cells import MachineCell

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
