"""What a verification needs: the machine of its result, and the files it names."""

from __future__ import annotations

from truepath.app.errors import BadInput, BundleError, NotFound
from truepath.app.files.one_machine import one_machine
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.job import Job
from truepath.app.kinematics.machine import Machine
from truepath.app.motion.configurations import Commanded
from truepath.app.results.model_history import find_model_file
from truepath.drivers.interfaces.records import Path


def require_compensation(
    name: str, job: Job, wish: str | None, context: JobContext
) -> None:
    """Raise NotFound or BadInput where the control cannot apply these files.

    wish : what the control has to say, `on` or `off`; None for either

    Which files a control applies is known of a simulated one alone.
    """
    folder = context.results / job.id / "compensations"
    if not (folder / name / "compensation.json").is_file():
        raise NotFound(f"job {job.id} keeps no compensation {name}")
    if wish == "off":
        raise BadInput(
            f"compensation_id {name} asks for a control that corrects by these files, "
            "and control_compensation is off; leave one of the two out"
        )
    machine = context.driven or context.machines.choose(None)
    loaded = context.read_loaded_files(machine.id)
    if loaded.compensation_id is None:  # that the control says itself
        return
    if (loaded.job_id, loaded.compensation_id) != (job.id, name):
        raise BadInput(
            f"the simulated control of machine {machine.id} has the files "
            f"{loaded.compensation_id} of job {loaded.job_id}, not {name} of job "
            f"{job.id}; load those first, or name the ones that it has"
        )


def require_arcs(rows: Commanded, context: JobContext) -> None:
    """Raise BadInput for arcs where the control that answers does not drive them.

    One that has not answered yet refuses them itself, before it moves along the path.
    """
    motion = context.require_cell().status.devices.get("motion")
    has_arcs = isinstance(rows, Path) and any(rows.arc)
    if has_arcs and motion is not None and not motion.get("drives_arcs"):
        raise BadInput(
            "this control does not drive arcs, which circles-in-motion are; ask for "
            "circles, which are measured at standstills"
        )


def require_machine_of_result(job: Job, machine: Machine, context: JobContext) -> None:
    """Raise BadInput where a result is of another machine than the one to drive."""
    # Imported where it is needed: the service itself carries no science.
    from truepath.app.files.result_file import read_result_machine

    file = find_model_file(context.results, job.id)
    try:
        one_machine(
            [read_result_machine(file), machine], ["the result", "the machine now"]
        )
    except BundleError as error:
        raise BadInput(
            f"the result of job {job.id} cannot be verified on {machine.name}: "
            f"{error.problem}; name its own machine, described "
            "as it was measured, or another result"
        ) from error
