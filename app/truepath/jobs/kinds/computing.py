"""Jobs that only compute: analysis, discovery, trend and reanalysis of Runs."""

from __future__ import annotations

from pathlib import Path

from truepath.catalogue.job import Job, JobKind, Json, Stage
from truepath.catalogue.transitions import State
from truepath.errors import NotFound
from truepath.files.bundle.one_machine import order_in_time
from truepath.jobs.kinds.job_steps import JobSteps, RequestedJob, make_plan_request
from truepath.jobs.running.context import JobContext
from truepath.jobs.workers.reanalysis import Reanalysis, list_orders, write_summary


class Analyse(JobSteps):
    """Error tables of Runs together."""

    kind = JobKind.ANALYSE

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """The Runs exist; they are of one machine of the catalogue, or of none."""
        records = [context.runs.get(run_id) for run_id in request.run_ids]
        by_name = {one.machine.name: one.id for one in context.machines.list_all()}
        known = {by_name.get(record.machine) for record in records}
        job = Job(
            request.kind,
            run_id=records[0].id,
            further_run_ids=tuple(record.id for record in records[1:]),
            perpendicular_only=request.perpendicular_only,
            monte_carlo=request.monte_carlo,
            machine=known.pop() if len(known) == 1 else None,
        )
        return job, {"request": make_plan_request(request, context)}

    def run(self) -> None:
        """Analyse."""
        self.analyse(self.job.run_ids)


class Discover(Analyse):
    """What the model of Runs lacks."""

    kind = JobKind.DISCOVER

    def run(self) -> None:
        """Discover."""
        self.discover(self.job.run_ids)


class Trend(Analyse):
    """A machine followed over Runs."""

    kind = JobKind.TREND

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """As an analysis, of Runs that can be put in order of time."""
        job, plan = super().prepare(request, context)
        at_h = (request.plan_request or {}).get("at_h")
        order_in_time([context.runs.read_times(i) for i in job.run_ids], at_h)
        return job, plan

    def run(self) -> None:
        """Follow the machine."""
        context, run_ids = self.context, self.job.run_ids
        names = [context.runs.get(run_id).name for run_id in run_ids]
        asked = context.store.read_plan_request(self.job.id)
        inputs = names, self.folder, asked
        self.answer(run_ids, Stage.ESTIMATING, context.follower, *inputs)


class Reanalyse(JobSteps):
    """Many Runs analysed again, each for itself."""

    kind = JobKind.REANALYSE

    @classmethod
    def prepare(cls, request: RequestedJob, context: JobContext) -> tuple[Job, Json]:
        """The Runs that are named, or those of a machine since a time."""
        job = Job(request.kind, perpendicular_only=request.perpendicular_only)
        return job, {"request": {"run_ids": _choose_runs(request, context)}}

    def run(self) -> None:
        """Analyse the Runs that are not done yet, then write the summary of all."""
        context, job = self.context, self.job
        folder = Path(self.folder)
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


def _choose_runs(request: RequestedJob, context: JobContext) -> list[str]:
    if request.run_ids:
        found = context.runs.find(request.run_ids)
        missing = [run_id for run_id in request.run_ids if run_id not in set(found)]
        if missing:
            raise NotFound(f"there is no run {missing[0]}")
        return found
    since, name = (request.plan_request or {}).get("since"), None
    if request.machine is not None:
        name = context.machines.get(request.machine).machine.name
    found = context.runs.list_of_machine(name, since)
    if not found:
        raise NotFound(
            f"there is no Run of {name or 'any machine'}"
            f"{f' since {since}' if since else ''}"
        )
    return found
