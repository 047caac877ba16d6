"""A request, and the steps that all kinds of jobs share.

Each kind is a class: `prepare` makes a job of a valid request, `run` does it. The job's
thread runs it; at the checkpoints of its `ActiveJob` it ends early.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from truepath.answers.machine_history import RESULT, find_model_file
from truepath.catalogue.job import Job, JobKind, Json, OnNotice, Progress, Stage
from truepath.catalogue.transitions import State
from truepath.errors import NotUsable
from truepath.jobs.running.active_job import ActiveJob
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.live_estimation import add_to_result
from truepath.jobs.workers.executor import OfUnchangedRuns, Task
from truepath.motion.paths.commanded_rows import Row
from truepath.numerics.adaptive_trials import TrialPlan


@dataclass(frozen=True, slots=True)
class RequestedJob:
    """A job as requested.

    run_ids : the Runs to analyse together
    rows : path or points in the columns of the bundle
    target_um : volumetric uncertainty (k = 1) at which the measurement may end
    plan_id : of a plan to execute; plan_rows : how many rows from its first on
    model_id : of the job whose model or result is the basis of comparison, analysis or
        planning
    discovery_id : of the job whose discovery proposes the extra lines
    continues : job whose unmeasured stations are measured
    plan_request : of a plan or an adaptive measurement, as in `plan_requests`; of a
        trend, as `TrendRequest.of` reads it; of a reanalysis `since`, where it names no
        Runs; of a verification `result_id`, `what`, `seed`, `tolerance_um`,
        `compensation_id`; of that and of extra lines `keep_out`, in addition to those
        of the underlying Runs or, with `keep_out_replaces`, alone
    on_notice : action when the live estimate detects a change
    control_compensation : `on` or `off`, required of the control; None for either
    machine : None for the only one, or that of the plan, job, discovery or result that
        is named
    """

    kind: JobKind
    run_ids: Sequence[str] = ()
    rows: Sequence[Row] | None = None
    feed_mm_min: float | None = None
    perpendicular_only: bool = False
    target_um: float | None = None
    monte_carlo: TrialPlan | None = None
    plan_id: str | None = None
    plan_rows: int | None = None
    model_id: str | None = None
    discovery_id: str | None = None
    continues: str | None = None
    plan_request: Json | None = None
    on_notice: OnNotice = OnNotice.NOTE
    machine: str | None = None
    control_compensation: str | None = None


class JobSteps(ABC):
    """One kind of job."""

    kind: ClassVar[JobKind]

    def __init__(self, job: Job, active: ActiveJob, context: JobContext) -> None:
        self.job, self.active, self.context = job, active, context

    @classmethod
    @abstractmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """The job of a request, and its plan as the store keeps it.

        Raises BadInput (NotUsable of a model), NotFound.
        """

    @abstractmethod
    def run(self) -> None:
        """Do the job, step by step."""

    def compute(
        self, state: State, stage: Stage, task: Task, *arguments: object
    ) -> Any:
        """Run a task in the executor, in this state and stage of the job."""
        computation = self.context.executor.submit(
            task,
            *arguments,
            on_progress=self._report_progress,
            started=lambda: self.active.enter(state, stage),
        )
        found = self.active.compute(computation)
        self.active.checkpoint()
        return found

    def _report_progress(self, share: float, name: str) -> None:
        stage = Stage(name) if name in set(Stage) else None
        self.active.report_progress(Progress(share, 1.0), stage=stage)

    def analyse(self, run_ids: Sequence[str]) -> None:
        """Write the result of these Runs together."""
        job, context = self.job, self.context
        how = job.perpendicular_only, job.monte_carlo, context.workers
        inputs = self.folder, *how, *self.find_model()
        self.answer(run_ids, Stage.ALIGNING, context.science, *inputs)

    def discover(self, run_ids: Sequence[str]) -> None:
        """Write the discovery in these Runs together."""
        inputs = self.folder, *self.find_model()
        self.answer(run_ids, Stage.DISCOVERING, self.context.discoverer, *inputs)

    def answer(
        self, run_ids: Sequence[str], stage: Stage, task: Task, *inputs: object
    ) -> None:
        """Compute the answer from Runs that are as catalogued; store its verdict."""
        runs = self.context.runs
        files = [str(runs.file(run_id)) for run_id in run_ids]
        digests = [runs.get(run_id).sha256 for run_id in run_ids]
        guarded = OfUnchangedRuns(task, dict(zip(files, digests, strict=True)))
        verdict = self.compute(State.RUNNING, stage, guarded, files, *inputs)
        notices = self.context.store.get(self.job.id).notices
        add_to_result(Path(self.folder) / RESULT, notices)
        self.active.store_values(verdict=verdict)

    @property
    def folder(self) -> str:
        """Of the answer."""
        return str(self.context.results / self.job.id)

    def read_plan(self) -> Json:
        """Empty where there is none yet."""
        return self.context.store.read_plan(self.job.id) or {}

    def find_model(self) -> tuple[str | None, str | None]:
        """File and job of the model that was named; None without one."""
        model_id = self.context.store.read_plan_request(self.job.id).get("model_id")
        if model_id is None:
            return None, None
        return str(find_model_file(self.context.results, model_id)), model_id


class MachineSteps(JobSteps):
    """A job for one machine, which it moves or plans for."""

    def plan(self, state: State) -> None:
        """Have the rows chosen, and store them."""
        machine = self.context.require_machine()
        task, order = self.context.planner, self.request_plan()
        plan = self.compute(state, Stage.PLANNING, task, machine, order)
        self.context.store.store_plan(self.job.id, plan)

    def request_plan(self) -> Json:
        """Request of the job, as in `plan_requests`."""
        file, _ = self.find_model()
        request = self.context.store.read_plan_request(self.job.id)
        return {**request, "model_file": file}


def make_plan_request(request: RequestedJob, context: JobContext) -> Json:
    """The request as the plan of the job keeps it.

    A model that is named has to be usable, except in an analysis: it takes no numbers
    from a model of its own Runs.
    """
    order = dict(request.plan_request or {})
    if request.plan_id is not None:  # what the plan avoids is avoided on the way to it
        planned = context.store.read_plan_request(request.plan_id)
        order |= {key: planned[key] for key in ("workspace",) if key in planned}
    if request.feed_mm_min is not None:
        order["feeds_mm_min"] = [request.feed_mm_min]
    if request.model_id is not None:
        job = context.store.get(request.model_id)
        find_model_file(context.results, job.id)
        if job.verdict == "not-usable" and request.kind is not JobKind.ANALYSE:
            raise NotUsable(f"the model {job.id} is not to be used; see its reasons")
        order["model_id"] = job.id
    return order
