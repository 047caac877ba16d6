"""Jobs as clients see them."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from app.api.failures import describe_failure
from app.api.models.base import JOB_ID, PREFIX
from app.api.models.monte_carlo import MonteCarloOut, monte_carlo_out
from app.api.models.problem import Problem
from app.jobs.job import EarlyEnd, Health, Job, Progress
from app.jobs.transitions import State


class JobProgress(BaseModel):
    """How far the stage is."""

    done: float
    total: float
    unit: str = Field(examples=["lines"])
    eta_s: float | None
    stage: str = Field(examples=["measuring"])
    elapsed_s: float
    position: list[float] = Field(description="Axis positions in mm and deg.")


class JobHealth(BaseModel):
    """What the tracker's link has seen."""

    samples: int
    lost_samples: int
    crc_errors: int


class ResultLinks(BaseModel):
    """Where the result is."""

    result: str
    error_tables_json: str
    error_tables_csv: str
    report_html: str


class DiscoveryLinks(BaseModel):
    """Where the answer of a discovery is."""

    discovery: str
    report_html: str
    model: str


class JobLinks(BaseModel):
    """Where else to look."""

    self: str
    events: str
    plan: str
    run: str | None


class EarlyEndOut(BaseModel):
    """Why the rest of the plan was left out."""

    reason: Literal["target-reached"]
    reached_um: float = Field(
        description="`volumetric_uncertainty_um` (k = 1) at that moment."
    )
    done: int = Field(description="Finished lines or points that told it.")
    total: int = Field(description="Lines or points of the plan.")


class JobOut(BaseModel):
    """A job. `version` counts its changes of state; send it as If-Match."""

    id: str = Field(examples=[JOB_ID])
    kind: str = Field(examples=["measure-otf"])
    state: str = Field(examples=["ready"], description="One of " + ", ".join(State))
    desired_state: str = Field(examples=["ready"])
    version: int = Field(examples=[3])
    stage: str = Field(examples=["measuring"])
    progress: JobProgress
    health: JobHealth
    perpendicular_only: bool
    monte_carlo: MonteCarloOut | None = Field(
        description="The trials that the uncertainty is held against."
    )
    target_um: float | None = Field(
        description="`volumetric_uncertainty_um` (k = 1) at which it may end early."
    )
    early_end: EarlyEndOut | None = Field(description="Null if it did not.")
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    started: str | None
    ended: str | None
    run_id: str | None
    run_ids: list[str] = Field(
        description="All its Runs, in order: `run_id` is the first, of extra lines "
        "the last."
    )
    result: ResultLinks | None
    discovery: DiscoveryLinks | None = Field(
        description="Of a job of kind discover or measure-extra that has succeeded."
    )
    error: Problem | None = Field(
        description="Why it ended badly; in an unfinished job, why it stands."
    )
    links: JobLinks


class JobPage(BaseModel):
    """Jobs, the newest first."""

    items: list[JobOut]
    next: str | None = Field(description="`after` of the next page.")


class Stopped(BaseModel):
    """The jobs that a blanket abort has reached."""

    jobs: list[JobOut]


def job_out(job: Job) -> JobOut:
    """Return a job as clients see it."""
    failure = job.failure
    return JobOut(
        id=job.id,
        kind=str(job.kind),
        state=str(job.state),
        desired_state=job.desired_state,
        version=job.version,
        stage=str(job.stage),
        progress=progress_out(str(job.stage), job.progress),
        health=health_out(job.health),
        perpendicular_only=job.perpendicular_only,
        monte_carlo=monte_carlo_out(job.monte_carlo),
        target_um=job.target_um,
        early_end=_early_end_out(job.early_end),
        created=job.created,
        started=job.started,
        ended=job.ended,
        run_id=job.run_id,
        run_ids=list(job.run_ids),
        result=_result_links(job.id) if job.has_result else None,
        discovery=_discovery_links(job.id) if job.has_discovery else None,
        error=Problem(**describe_failure(failure)) if failure else None,
        links=_job_links(job),
    )


def progress_out(stage: str, progress: Progress) -> JobProgress:
    """Return the progress as clients see it."""
    return JobProgress(
        done=progress.done,
        total=progress.total,
        unit=progress.unit,
        eta_s=progress.eta_s,
        stage=stage,
        elapsed_s=progress.elapsed_s,
        position=list(progress.position),
    )


def health_out(health: Health) -> JobHealth:
    """Return the health of the stream as clients see it."""
    return JobHealth(
        samples=health.samples,
        lost_samples=health.lost_samples,
        crc_errors=health.crc_errors,
    )


def _early_end_out(end: EarlyEnd | None) -> EarlyEndOut | None:
    if end is None:
        return None
    return EarlyEndOut(
        reason="target-reached",
        reached_um=end.reached_um,
        done=end.done,
        total=end.total,
    )


def _result_links(job_id: str) -> ResultLinks:
    at = f"{PREFIX}/jobs/{job_id}/result"
    return ResultLinks(
        result=at,
        error_tables_json=f"{at}/error-tables.json",
        error_tables_csv=f"{at}/error-tables.csv",
        report_html=f"{at}/report.html",
    )


def _discovery_links(job_id: str) -> DiscoveryLinks:
    at = f"{PREFIX}/jobs/{job_id}/discovery"
    return DiscoveryLinks(
        discovery=at,
        report_html=f"{at}/report.html",
        model=f"{PREFIX}/models/{job_id}",
    )


def _job_links(job: Job) -> JobLinks:
    at = f"{PREFIX}/jobs/{job.id}"
    return JobLinks(
        self=at,
        events=f"{at}/events",
        plan=f"{at}/plan",
        run=f"{PREFIX}/runs/{job.run_id}" if job.run_id else None,
    )
