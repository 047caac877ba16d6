"""Measurements that follow an answer: extra lines of a discovery, a verification."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path as FilePath
from typing import Any

from truepath.answers.machine_history import DISCOVERY, find_model_file
from truepath.catalogue.job import Job, JobKind, Json, Stage
from truepath.errors import (
    BadInput,
    BundleError,
    NotFound,
    PlanningError,
)
from truepath.files.bundle.commanded_file import (
    decode_commanded_json,
    encode_commanded_json,
)
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.one_machine import one_machine
from truepath.files.bundle.workspace_file import workspace_from_json
from truepath.jobs.kinds.job_steps import RequestedJob
from truepath.jobs.kinds.measuring import Measurement
from truepath.jobs.running.context import JobContext
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.motion.paths.commanded_rows import command_rows
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.paths.verification_points import make_verification_rows
from truepath.motion.workspace import check_travel
from truepath_drivers.interfaces.records import Path

_KEEP_OUT_REMEDY = (
    "ask for other lines or points, or, where a box is gone, state those that hold now "
    "as keep_out with keep_out_replaces"
)
_KEEP_OUT_KEYS = ("keep_out", "keep_out_replaces")


class MeasureExtra(Measurement):
    """The lines that a discovery asks for, to a discovery in all their Runs."""

    kind = JobKind.MEASURE_EXTRA

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """The lines are free of the boxes of the discovery's Runs."""
        machine = context.require_machine()
        job = context.store.get(request.discovery_id or "")
        if job.answer != "discovery":
            raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no discovery")
        model_id = context.store.read_plan_request(job.id).get("model_id")
        rows = _plan_extra_lines(machine, context.results / job.id, job.id)
        order = {**(request.plan_request or {}), "model_id": model_id}
        order = _add_workspace(order, job, context)
        workspace = workspace_from_json(order.get("workspace") or {})
        workspace.require_allowed(
            machine, decode_commanded_json(rows), _KEEP_OUT_REMEDY
        )
        return Job(cls.kind, further_run_ids=job.run_ids), {**rows, "request": order}

    def conclude(self, run_ids: Sequence[str]) -> None:
        """Discover."""
        self.discover(run_ids)


class Verify(Measurement):
    """Points that a result was not made from, compared with it."""

    kind = JobKind.VERIFY

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """The result exists and is of this machine."""
        machine, order = context.require_machine(), dict(request.plan_request or {})
        job = context.store.get(order["result_id"])
        find_model_file(context.results, job.id)
        if job.answer not in ("result", "discovery"):
            raise NotFound(f"job {job.id} ({job.kind}, {job.state}) has no result")
        _require_machine_of_result(job, machine, context)
        if order.get("compensation_id") is not None:
            wanted = request.control_compensation
            _require_compensation(order["compensation_id"], job, wanted, context)
        kinds = [VerificationKind(kind) for kind in order["what"]]
        order = _add_workspace(order, job, context)
        workspace = workspace_from_json(order.get("workspace") or {})
        rows = make_verification_rows(machine, kinds, order["seed"], workspace)
        check_travel(machine, rows)
        workspace.require_allowed(machine, rows, _KEEP_OUT_REMEDY)
        _require_arcs(rows, context)
        return Job(cls.kind), {**encode_commanded_json(rows), "request": order}

    def conclude(self, run_ids: Sequence[str]) -> None:
        """Compare the result with the Runs."""
        context = self.context
        asked = context.store.read_plan_request(self.job.id)
        result_id, files = asked["result_id"], asked.get("compensation_id")
        kept = context.results / result_id / "compensations"
        parts = self.read_plan().get("parts", ())
        first_row = {part["run_id"]: part["first_row"] for part in parts}
        inputs = (
            [first_row.get(run_id, 0) for run_id in run_ids],
            self.folder,
            str(find_model_file(context.results, result_id)),
            None if files is None else str(kept / files),
            asked,
        )
        self.answer(run_ids, Stage.ALIGNING, context.verifier, *inputs)


def _require_compensation(
    name: str, job: Job, wanted: str | None, context: JobContext
) -> None:
    """Only a simulated control reports which files it applies.

    wanted : `on` or `off`, required of the control; None for either
    """
    folder = context.results / job.id / "compensations"
    if not (folder / name / "compensation.json").is_file():
        raise NotFound(f"job {job.id} keeps no compensation {name}")
    if wanted == "off":
        raise BadInput(
            f"compensation_id {name} asks for a control that corrects by these files, "
            "and control_compensation is off; leave one of the two out"
        )
    machine = context.require_machine_cell()
    loaded = context.read_loaded_files(machine.id)
    if loaded.compensation_id is None:  # reported by the control itself
        return
    if (loaded.job_id, loaded.compensation_id) != (job.id, name):
        raise BadInput(
            f"the simulated control of machine {machine.id} has the files "
            f"{loaded.compensation_id} of job {loaded.job_id}, not {name} of job "
            f"{job.id}; load those first, or name the ones that it has"
        )


def _require_arcs(rows: Commanded, context: JobContext) -> None:
    """A control that has not connected yet rejects arcs itself, before it moves."""
    motion = context.require_cell().status.devices.get("motion")
    has_arcs = isinstance(rows, Path) and any(rows.arc)
    if has_arcs and motion is not None and not motion.get("drives_arcs"):
        raise BadInput(
            "this control does not drive arcs, which circles-in-motion are; ask for "
            "circles, which are measured at standstills"
        )


def _require_machine_of_result(job: Job, machine: Machine, context: JobContext) -> None:
    # Imported where it is needed: the service itself carries no science.
    from truepath.files.earlier.result_file import read_result_machine

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


def _add_workspace(order: Json, based_on: Job, context: JobContext) -> Json:
    """Boxes of both jobs: one that is not repeated still exists, unless
    `keep_out_replaces`. Boxes of an uploaded Run, or of a rebuilt catalogue, are
    unknown.
    """
    rest = {key: value for key, value in order.items() if key not in _KEEP_OUT_KEYS}
    known = () if order.get("keep_out_replaces") else _find_boxes(based_on, context)
    boxes: list[Json] = []
    for box in (*known, *(order.get("keep_out") or ())):
        stated = {key: value for key, value in box.items() if value is not None}
        if stated not in boxes:
            boxes.append(stated)
    return {**rest, "workspace": {"keep_out": boxes}} if boxes else rest


def _find_boxes(based_on: Job, context: JobContext) -> Iterator[Json]:
    for job_id in _list_jobs(based_on, context):
        with suppress(NotFound):
            workspace = context.store.read_plan_request(job_id).get("workspace") or {}
            yield from workspace.get("keep_out") or ()


def _list_jobs(based_on: Job, context: JobContext) -> Iterator[str]:
    yield based_on.id
    for run_id in based_on.run_ids:
        yield context.runs.read_job_id(run_id)


def _plan_extra_lines(
    machine: Machine, folder: FilePath, job_id: str
) -> dict[str, Any]:
    """Rows of the extra lines that a discovery proposes, with `discovery_id`.

    In the form of `encode_commanded_json`.

    folder, job_id : of the discovery

    Raises PlanningError if the discovery proposes none, if its Runs are of another
    machine, or if the lines leave the travel; NotFound if its model is gone.
    """
    ask = json.loads((folder / DISCOVERY).read_text(encoding="utf-8")).get("ask")
    if ask is None:
        raise PlanningError(
            f"discovery {job_id} asks for no extra lines: no names compete, and no "
            "evidence is thin"
        )
    model = find_model_file(folder.parent, job_id).read_text(encoding="utf-8")
    name = f"model {job_id}"
    try:
        measured = machine_from_json(json.loads(model)["machine"], file=name)
        one_machine([measured, machine], [name, "this service"])
    except BundleError as error:
        raise PlanningError(
            f"the extra lines are for another machine: {error}"
        ) from error
    path = command_rows(machine, ask["rows"], is_path=True)
    return {**encode_commanded_json(path), "discovery_id": job_id}
