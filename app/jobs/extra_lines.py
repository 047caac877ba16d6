"""The extra lines that a discovery asks for, as a job is to drive them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from app.errors import BundleError, PlanningError
from app.files.machine_file import machine_from_json
from app.files.one_machine import one_machine
from app.jobs.job import JobKind
from app.jobs.plans import plan_json, plan_motion
from app.kinematics.machine import Machine
from app.results.model_history import DISCOVERY, find_model_file


def extra_lines(machine: Machine, folder: Path, job_id: str) -> dict[str, Any]:
    """Return the lines as `plans.plan_json` states them, with `discovery_id`.

    machine : that is to drive them
    folder, job_id : of the discovery

    Raises PlanningError if the discovery asks for none, if its Runs are of another
    machine, or if the lines leave the travel; NotFound if its model is gone.
    """
    found = json.loads((folder / DISCOVERY).read_text(encoding="utf-8"))
    if found.get("ask") is None:
        raise PlanningError(
            f"discovery {job_id} asks for no extra lines: no names compete, and no "
            "evidence is thin"
        )
    model = json.loads(
        find_model_file(folder.parent, job_id).read_text(encoding="utf-8")
    )
    try:
        measured = machine_from_json(model["machine"], file=f"model {job_id}")
        one_machine([measured, machine], [f"model {job_id}", "this service"])
    except BundleError as error:
        raise PlanningError(
            f"the extra lines are for another machine: {error}"
        ) from error
    path = plan_motion(machine, JobKind.MEASURE_OTF, found["ask"]["rows"])
    return {**plan_json(path), "discovery_id": job_id}
