"""What a job computes from its Runs: one method for each kind of answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.context import JobContext
from truepath.app.jobs.executor import Task
from truepath.app.jobs.job import Job, Stage
from truepath.app.jobs.notices import add_to_result
from truepath.app.jobs.reanalysis import Reanalysis, list_orders, write_summary
from truepath.app.jobs.transitions import State
from truepath.app.jobs.unchanged_runs import OfUnchangedRuns
from truepath.app.results.model_history import RESULT, find_model_file


@dataclass(frozen=True, slots=True)
class AnalysisSteps:
    """One job that computes.

    compute : lets the executor compute a task
    """

    job: Job
    active: ActiveJob
    context: JobContext
    compute: Callable[..., Any]

    def conclude(
        self, run_ids: Sequence[str], stage: Stage, task: Task, *how: object
    ) -> None:
        """Let a task write its files about Runs and, where one is named, a model.

        The state of the verdict that it returns is stored with the job.
        """
        files, task = self._name_files(run_ids), self._guard(task, run_ids)
        folder = str(self.context.results / self.job.id)
        model = find_model(self.job, self.context)
        verdict = self.compute(State.RUNNING, stage, task, files, folder, *how, *model)
        notices = self.context.store.get(self.job.id).notices
        add_to_result(Path(folder) / RESULT, notices)
        self.active.store_values(verdict=verdict)

    def follow(self) -> None:
        """Let a task write what the Runs say of the machine over time."""
        context, job = self.context, self.job
        files = self._name_files(job.run_ids)
        names = [context.runs.get(run_id).name for run_id in job.run_ids]
        asked = context.store.read_plan_request(job.id)
        told = files, names, str(context.results / job.id), asked
        follower = self._guard(context.follower, job.run_ids)
        verdict = self.compute(State.RUNNING, Stage.ESTIMATING, follower, *told)
        self.active.store_values(verdict=verdict)

    def reanalyse(self) -> None:
        """Analyse many Runs, each for itself, and write what has changed."""
        context, job = self.context, self.job
        folder = context.results / job.id
        orders = list_orders(
            context.store.read_plan_request(job.id)["run_ids"],
            folder,
            runs=context.runs,
            store=context.store,
            results=context.results,
        )
        reanalysis = Reanalysis(
            context.executor,
            context.reanalyser,
            orders,
            (job.perpendicular_only,),
            started=lambda: self.active.enter(State.RUNNING, Stage.ESTIMATING),
            report=self.active.report_progress,
        )
        outcomes = self.active.compute(reanalysis)
        self.active.checkpoint()
        # Where all was done before the service ended, no task has begun.
        self.active.enter(State.RUNNING, Stage.ESTIMATING)
        write_summary(folder, outcomes)

    def verify(self, run_ids: Sequence[str]) -> None:
        """Let a task hold the result that was named against the job's own Runs."""
        context, job = self.context, self.job
        asked = context.store.read_plan_request(job.id)
        result_id, files = asked["result_id"], asked.get("compensation_id")
        kept = context.results / result_id / "compensations"
        parts = (context.store.read_plan(job.id) or {}).get("parts", ())
        first_row = {part["run_id"]: part["first_row"] for part in parts}
        told = (
            self._name_files(run_ids),
            [first_row.get(run_id, 0) for run_id in run_ids],
            str(context.results / job.id),
            str(find_model_file(context.results, result_id)),
            None if files is None else str(kept / files),
            asked,
        )
        verifier = self._guard(context.verifier, run_ids)
        verdict = self.compute(State.RUNNING, Stage.ALIGNING, verifier, *told)
        self.active.store_values(verdict=verdict)

    def _name_files(self, run_ids: Sequence[str]) -> list[str]:
        return [str(self.context.runs.file(run_id)) for run_id in run_ids]

    def _guard(self, task: Task, run_ids: Sequence[str]) -> Task:
        """Return the task, which refuses files that have been changed."""
        digests = [self.context.runs.get(run_id).sha256 for run_id in run_ids]
        files = self._name_files(run_ids)
        return OfUnchangedRuns(task, dict(zip(files, digests, strict=True)))


def find_model(job: Job, context: JobContext) -> tuple[str | None, str | None]:
    """Return file and identifier of the model that a job builds on, if any."""
    model_id = context.store.read_plan_request(job.id).get("model_id")
    if model_id is None:
        return None, None
    return str(find_model_file(context.results, model_id)), model_id
