"""Jobs as clients see them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal

from pydantic import BaseModel, Field

from app.api.models.base import JOB_ID, PREFIX, Problem
from app.api.problems import describe_failure
from app.jobs.job import Job
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
    done: int = Field(description="Finished lines or points behind that number.")
    total: int = Field(description="Lines or points of the plan.")


class MonteCarloOut(BaseModel):
    """The trials that were asked for."""

    seed: int
    interval: str = Field(examples=["symmetric"])


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


def describe_job(job: Job) -> JobOut:
    """Return a job as clients see it."""
    at, failure = f"{PREFIX}/jobs/{job.id}", job.failure
    end, trials = job.early_end, job.monte_carlo
    more = {
        "progress": JobProgress(stage=str(job.stage), **asdict(job.progress)),
        "health": JobHealth(**asdict(job.health)),
        "monte_carlo": MonteCarloOut(**asdict(trials)) if trials else None,
        "early_end": EarlyEndOut(reason="target-reached", **asdict(end))
        if end
        else None,
        "run_ids": list(job.run_ids),
        "result": _link_result(at) if job.has_result else None,
        "discovery": _link_discovery(at, job.id) if job.has_discovery else None,
        "error": Problem(**describe_failure(failure)) if failure else None,
        "links": JobLinks(
            self=at,
            events=f"{at}/events",
            plan=f"{at}/plan",
            run=f"{PREFIX}/runs/{job.run_id}" if job.run_id else None,
        ),
    }
    return JobOut(**{**asdict(job), **more})


def _link_result(at: str) -> ResultLinks:
    tables = f"{at}/result/error-tables"
    return ResultLinks(
        result=f"{at}/result",
        error_tables_json=f"{tables}.json",
        error_tables_csv=f"{tables}.csv",
        report_html=f"{at}/result/report.html",
    )


def _link_discovery(at: str, job_id: str) -> DiscoveryLinks:
    return DiscoveryLinks(
        discovery=f"{at}/discovery",
        report_html=f"{at}/discovery/report.html",
        model=f"{PREFIX}/models/{job_id}",
    )
