"""A job as clients see it: body, links, failure as a problem, permitted verbs."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from truepath.catalogue.job import Job, JobKind, OnNotice, Stage
from truepath.catalogue.transitions import State, Verb
from truepath.files.earlier.verdict import State as VerdictState
from truepath.jobs.running.resumption import find_way_to_result, may_be_acknowledged
from truepath.service.api.models.base import JOB_ID, PREFIX, Links, Problem, address
from truepath.service.api.problems import describe_failure
from truepath.service.api.route_roles import LEAST_ROLES


class JobProgress(BaseModel):
    """How far the stage is."""

    done: float
    total: float
    unit: str = Field(examples=["lines"])
    eta_s: float | None
    stage: Stage = Field(examples=["measuring"])
    elapsed_s: float
    position: list[float] = Field(description="Axis positions in mm and deg.")


class JobHealth(BaseModel):
    """What the tracker's link has seen."""

    samples: int
    lost_samples: int
    crc_errors: int
    gaps: int = Field(description="Places where samples are missing.")
    repeats: int = Field(
        description="Times that lines were driven again, because samples of them were "
        "damaged or lost."
    )


class ResultLinks(Links):
    """Where the result is."""

    result: Annotated[str, "/jobs/{id}/result"]
    error_tables_json: Annotated[str, "/jobs/{id}/result/error-tables.json"]
    error_tables_csv: Annotated[str, "/jobs/{id}/result/error-tables.csv"]
    report_html: Annotated[str, "/jobs/{id}/result/report.html"]


class DiscoveryLinks(Links):
    """Where the answer of a discovery is."""

    discovery: Annotated[str, "/jobs/{id}/discovery"]
    report_html: Annotated[str, "/jobs/{id}/discovery/report.html"]
    model: Annotated[str, "/models/{id}"]


class TrendLinks(Links):
    """Where the machine over time is."""

    trend: Annotated[str, "/jobs/{id}/trend"]
    report_html: Annotated[str, "/jobs/{id}/trend/report.html"]


class ReanalysisLinks(Links):
    """Where the summary of many Runs is."""

    reanalysis: Annotated[str, "/jobs/{id}/reanalysis"]


class VerificationLinks(Links):
    """Where a verification is."""

    verification: Annotated[str, "/jobs/{id}/verification"]
    report_html: Annotated[str, "/jobs/{id}/verification/report.html"]


class JobLinks(Links):
    """Where else to look."""

    self: Annotated[str, "/jobs/{id}"]
    events: Annotated[str, "/jobs/{id}/events"]
    plan: Annotated[str, "/jobs/{id}/plan"]
    run: Annotated[str | None, "/runs/{run_id}"]
    verbs: dict[Verb, str] = Field(
        {},
        description="What may be asked of the job in its present state: POST to the "
        "address. `arm` and `resume` need If-Match.",
        examples=[{"abort": f"{PREFIX}/jobs/{JOB_ID}/abort"}],
    )


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
    interval: Literal["symmetric", "shortest"]


class StationCheckOut(BaseModel):
    """How a station agrees with the one before, by the known points."""

    station: int
    place_mm: list[float] | None = Field(
        description="Where the tracker was found, in the frame that it stands on."
    )
    moved_mm: float | None
    residual_um: float | None = Field(
        description="Root mean square distance of the known points from where the "
        "last station saw them."
    )
    allowed_um: float | None
    problem: Literal["", "not-seen", "not-moved", "moved", "residual"] = Field(
        examples=["not-moved"], description="Empty if the station is good."
    )
    text: str


class StationOut(BaseModel):
    """The station that is measured, or asked for, of several."""

    number: int = Field(examples=[2])
    total: int = Field(examples=[3])
    position_mm: list[float] = Field(
        description="Where the tracker is to stand, in the frame that it stands on."
    )
    checks: list[StationCheckOut]


class NoticeOut(BaseModel):
    """What the live estimate has noticed to change during the measurement."""

    number: int
    kind: str = Field(
        examples=["set-up-moved"],
        description="set-up-moved, set-up-drifts, axes-grow, lost-motion-changed, "
        "range-offset-changed, line-off; something-changed where no name holds.",
    )
    grade: Literal["certain", "likely", "possible"]
    axis: str = Field(description="Of a lost motion; empty else.")
    since_row: int = Field(description="First line or point that it shows on.")
    noticed_row: int = Field(description="The newest one when it was noticed.")
    noticed_s: float = Field(description="Then, since the stream began.")
    size_um: float = Field(description="What it moves the measured points by.")
    uncertainty_um: float
    is_over: bool = Field(description="The newest lines show nothing of it any more.")
    action: OnNotice = Field(description="What was done about it.")


class JobOut(BaseModel):
    """A job. `version` counts its changes of state; send it as If-Match."""

    id: str = Field(examples=[JOB_ID])
    name: str = Field(
        examples=["As found"], description="What people call it; often nothing."
    )
    note: str = Field(description="What people remark on it; often nothing.")
    kind: JobKind = Field(examples=["measure-otf"])
    machine: str | None = Field(
        examples=["default"],
        description="The machine that it is about, as GET /machines has it; null where "
        "its Runs are of none that the service knows.",
    )
    machine_version: int | None = Field(
        examples=[1], description="Of the configuration that was measured."
    )
    state: State = Field(examples=["ready"])
    desired_state: State = Field(
        examples=["ready"],
        description="What was asked; `state` is what the machine has confirmed.",
    )
    version: int = Field(examples=[3])
    stage: Stage = Field(examples=["measuring"])
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
    verdict: VerdictState | None = Field(
        description="What the result says of itself; the reasons are in it. Null "
        "where there is none."
    )
    station: StationOut | None = Field(
        description="Of a plan of several stations. In the state awaiting-move the "
        "tracker is to be set down at position_mm; then arm the job again."
    )
    on_notice: OnNotice = Field(
        description="What is done where the live estimate notices a change."
    )
    notices: list[NoticeOut] = Field(
        description="What its live estimate has noticed, by number."
    )
    owner: str | None = Field(
        examples=["anna"],
        description="Who asked for it; null where nobody logs in.",
    )
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
    trend: TrendLinks | None = Field(
        description="Of a job of kind trend that has succeeded."
    )
    reanalysis: ReanalysisLinks | None = Field(
        None, description="Of a job of kind reanalyse that has succeeded."
    )
    verification: VerificationLinks | None = Field(
        None, description="Of a job of kind verify that has succeeded."
    )
    error: Problem | None = Field(
        description="Why it ended badly; in an unfinished job, why it stands."
    )
    links: JobLinks


class JobPage(BaseModel):
    """Jobs, the newest first."""

    items: list[JobOut]
    next: str | None = Field(description="`after` of the next page.")


_ROUTED = frozenset(
    verb for verb in Verb if f"POST {PREFIX}/jobs/{{job_id}}/{verb}" in LEAST_ROLES
)

_ANSWER_LINKS = {
    "result": ResultLinks,
    "discovery": DiscoveryLinks,
    "trend": TrendLinks,
    "reanalysis": ReanalysisLinks,
    "verification": VerificationLinks,
}


def describe_job(job: Job) -> JobOut:
    """A job with links, failure as a problem, and permitted verbs."""
    content, failure = asdict(job), job.failure
    at = address(f"/jobs/{job.id}")
    links = JobLinks.of(id=job.id, run_id=job.run_id)
    links.verbs = {v: f"{at}/{v}" for v in job.allowed_verbs if v in _ROUTED}
    if not may_be_acknowledged(job):
        links.verbs.pop(Verb.ACKNOWLEDGE, None)
    if failure and (way := find_way_to_result(job)):
        failure = replace(failure, action=way)
    content["progress"]["stage"] = job.stage
    if job.early_end:
        content["early_end"]["reason"] = "target-reached"
    content |= {
        answer: links_of.of(id=job.id) if answer == job.answer else None
        for answer, links_of in _ANSWER_LINKS.items()
    }
    return JobOut(
        **content,
        run_ids=list(job.run_ids),
        error=Problem(**describe_failure(failure)) if failure else None,
        links=links,
    )
