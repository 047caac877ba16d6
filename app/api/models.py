"""Bodies of requests and answers. Keys name their unit; readers take further keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, model_validator

from app.api.failures import problem_of_failure
from app.jobs.dispatcher import Wish
from app.jobs.job import Health, Job, Kind, Progress
from app.jobs.plans import MAX_ROWS
from app.jobs.runs import RunRecord
from app.jobs.transitions import State

PREFIX = "/api/v1"
JOB_ID = "019a3f5e-7a11-7c3e-9d64-2b1f0c5e8a90"

_Mm = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
_Deg = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
_Feed = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
_TargetUm = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_Dwell = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]
_Identifier = Annotated[
    str, StringConstraints(pattern=r"^[0-9a-zA-Z-]+$", max_length=36)
]


class _Taken(BaseModel):
    """What clients send: nothing else is in it."""

    model_config = ConfigDict(extra="forbid", str_max_length=200)


class Point(_Taken):
    """Axis positions to stand at: a row of `points.csv`."""

    x_mm: _Mm | None = None
    y_mm: _Mm | None = None
    z_mm: _Mm | None = None
    a_deg: _Deg | None = None
    b_deg: _Deg | None = None
    c_deg: _Deg | None = None
    dwell_s: _Dwell | None = None
    target: str | None = None


class Waypoint(Point):
    """Axis positions to drive to in a straight line: a row of `path.csv`."""

    feed_mm_min: _Feed | None = None


class JobRequest(_Taken):
    """What is to be done."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"kind": "measure-otf"},
                {"kind": "analyse", "run_id": JOB_ID, "perpendicular_only": False},
                {
                    "kind": "measure-otf",
                    "feed_mm_min": 2500,
                    "path": [
                        {"x_mm": 0, "y_mm": 0, "z_mm": 0, "dwell_s": 1},
                        {"x_mm": 400, "y_mm": 300, "z_mm": 200, "dwell_s": 1},
                    ],
                },
            ]
        },
    )

    kind: Literal["measure-otf", "measure-standstill", "analyse"]
    run_id: _Identifier | None = Field(None, description="The Run to analyse.")
    path: list[Waypoint] | None = Field(
        None,
        min_length=2,
        max_length=MAX_ROWS,
        description="On the fly: lines in order; without it the default path.",
    )
    points: list[Point] | None = Field(
        None,
        min_length=1,
        max_length=MAX_ROWS,
        description="Standstill: points in order; without it the default points.",
    )
    feed_mm_min: _Feed | None = Field(
        None, description="Feed of the default path, and of rows that state none."
    )
    perpendicular_only: bool = Field(
        False, description="Leave out what is seen along each line."
    )
    target_um: _TargetUm | None = Field(
        None, description="End early, in order, at this volumetric_uncertainty_um."
    )

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        allowed = {
            "measure-otf": {"path", "feed_mm_min", "target_um"},
            "measure-standstill": {"points", "target_um"},
            "analyse": {"run_id"},
        }[self.kind]
        for name in ("run_id", "path", "points", "feed_mm_min", "target_um"):
            if getattr(self, name) is not None and name not in allowed:
                raise ValueError(f"{name} is not for a job of kind {self.kind}")
        if self.kind == "analyse" and self.run_id is None:
            raise ValueError("a job of kind analyse needs a run_id")
        return self

    def wish(self) -> Wish:
        """Return the request as the dispatcher takes it."""
        rows = self.path if self.path is not None else self.points
        return Wish(
            kind=Kind(self.kind),
            run_id=self.run_id,
            rows=None
            if rows is None
            else [r.model_dump(exclude_none=True) for r in rows],
            feed_mm_min=self.feed_mm_min,
            perpendicular_only=self.perpendicular_only,
            target_um=self.target_um,
        )


class Problem(BaseModel):
    """What went wrong and the way out (RFC 9457)."""

    model_config = ConfigDict(extra="allow")

    type: str = Field(examples=["/problems/busy"])
    title: str = Field(examples=["Another job holds the machine"])
    status: int | None = Field(None, examples=[409])
    detail: str = Field(examples=[f"job {JOB_ID} (running) holds the machine"])
    code: str = Field(examples=["busy"])
    action: str = Field(examples=["Wait until current_job has ended, or abort it."])
    instance: str | None = Field(None, examples=["/api/v1/jobs"])
    request_id: str | None = Field(None, examples=["6f0e4c1b9a7d4e52"])


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


class JobLinks(BaseModel):
    """Where else to look."""

    self: str
    events: str
    plan: str
    run: str | None


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
    created: str = Field(examples=["2026-05-04T09:30:00.000Z"])
    started: str | None
    ended: str | None
    run_id: str | None
    result: ResultLinks | None
    error: Problem | None = Field(
        description="Why it ended badly; in an unfinished job, why it stands."
    )
    links: JobLinks


class JobPage(BaseModel):
    """Jobs, the newest first."""

    items: list[JobOut]
    next: str | None = Field(description="`after` of the next page.")


class PlanOut(BaseModel):
    """What is or was commanded, a row of `position` for each waypoint or point."""

    kind: str = Field(examples=["path"])
    axes: list[str] = Field(examples=[["X", "Y", "Z"]])
    position: list[list[float]] = Field(
        examples=[[[0.0, 0.0, 0.0], [400.0, 300.0, 200.0]]],
        description="mm for linear axes, deg for rotary axes.",
    )
    feed_mm_min: list[float] = Field(
        examples=[[2500.0, 2500.0]],
        description="Feed towards each row; empty for points.",
    )
    dwell_s: list[float]
    target: list[str]
    target_um: float | None = Field(
        None, description="The volumetric uncertainty at which it may end early."
    )


class RunLinks(BaseModel):
    """Where the Run can be had."""

    self: str
    bundle: str


class RunOut(BaseModel):
    """A Run: what was commanded and recorded."""

    id: str
    name: str = Field(examples=["mill-3 2026-05-04T09:30:00.000Z"])
    origin: str = Field(examples=["measured"])
    mode: str = Field(examples=["otf"])
    machine: str = Field(examples=["mill-3"])
    samples: int = Field(examples=[60000])
    lost_samples: int = Field(examples=[0])
    complete: bool = Field(description="Whether it was driven to its end.")
    bytes: int
    sha256: str
    created: str
    links: RunLinks


class RunPage(BaseModel):
    """Runs, the newest first."""

    items: list[RunOut]
    next: str | None = Field(description="`after` of the next page.")


class DeviceIdentity(BaseModel):
    """Who answers on a port."""

    maker: str
    model: str
    serial_number: str
    firmware: str


class Connection(BaseModel):
    """The devices, once they have answered."""

    connected: bool
    tracker: DeviceIdentity | None
    motion: DeviceIdentity | None


class MachineOut(Connection):
    """The machine file, and whether its devices have answered."""

    model_config = ConfigDict(extra="allow")

    name: str = Field(examples=["mill-3"])
    kinematic_chain: str = Field(examples=["w-X-b-Y-Z-t"])
    axes: dict[str, Any]
    tracker_noise: dict[str, Any] = Field(
        description="What the machine file says of the tracker."
    )


class MachineSummary(BaseModel):
    """The machine in short."""

    name: str
    kinematic_chain: str
    axes: list[str]


class CellOut(BaseModel):
    """The cell process, which holds the devices."""

    state: str = Field(
        examples=["ready"], description="none, starting, down, disconnected, ready, …"
    )
    text: str
    connected: bool
    restarts: int


class SystemOut(BaseModel):
    """The service."""

    version: str
    simulated: bool
    machine: MachineSummary | None
    cell: CellOut
    current_job: str | None = Field(description="The job that holds the machine.")
    time: str


class Stopped(BaseModel):
    """The jobs that a blanket abort has reached."""

    jobs: list[JobOut]


class Alive(BaseModel):
    """The process answers."""

    status: str = "ok"


class Ready(BaseModel):
    """What the service needs is there."""

    status: str = Field(examples=["ready"])
    checks: dict[str, bool]


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
        created=job.created,
        started=job.started,
        ended=job.ended,
        run_id=job.run_id,
        result=_result_links(job.id) if job.has_result else None,
        error=Problem(**problem_of_failure(failure)) if failure else None,
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


def run_out(run: RunRecord) -> RunOut:
    """Return a Run as clients see it."""
    at = f"{PREFIX}/runs/{run.id}"
    return RunOut(
        id=run.id,
        name=run.name,
        origin=run.origin,
        mode=run.mode,
        machine=run.machine,
        samples=run.samples,
        lost_samples=run.lost_samples,
        complete=run.complete,
        bytes=run.bytes,
        sha256=run.sha256,
        created=run.created,
        links=RunLinks(self=at, bundle=f"{at}/bundle"),
    )


def connection_out(devices: Mapping[str, Mapping[str, str]]) -> Connection:
    """Return who answers, as clients see it."""
    known = {
        name: DeviceIdentity(**devices[name])
        for name in ("tracker", "motion")
        if name in devices
    }
    return Connection(
        connected=bool(devices),
        tracker=known.get("tracker"),
        motion=known.get("motion"),
    )


def _result_links(job_id: str) -> ResultLinks:
    at = f"{PREFIX}/jobs/{job_id}/result"
    return ResultLinks(
        result=at,
        error_tables_json=f"{at}/error-tables.json",
        error_tables_csv=f"{at}/error-tables.csv",
        report_html=f"{at}/report.html",
    )


def _job_links(job: Job) -> JobLinks:
    at = f"{PREFIX}/jobs/{job.id}"
    return JobLinks(
        self=at,
        events=f"{at}/events",
        plan=f"{at}/plan",
        run=f"{PREFIX}/runs/{job.run_id}" if job.run_id else None,
    )
