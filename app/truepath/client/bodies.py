"""Answers of the interface, in its own keys; `docs/openapi.json` describes them.

Keys name their units. Further states, kinds and verdicts may be added: handle those
that you know.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NotRequired, TypedDict

Json = dict[str, Any]

FINAL_STATES = frozenset(
    {"succeeded", "cancelled", "aborted", "failed", "faulted", "interrupted"}
)


class Problem(TypedDict):
    """Problem and remedy (RFC 9457)."""

    type: str
    title: str
    detail: str
    code: str
    action: str
    status: NotRequired[int | None]
    instance: NotRequired[str | None]
    request_id: NotRequired[str | None]


class Progress(TypedDict):
    """Progress of the stage; positions in mm and deg."""

    done: float
    total: float
    unit: str
    eta_s: float | None
    stage: str
    elapsed_s: float
    position: list[float]


class Health(TypedDict):
    """Counts of the tracker's link."""

    samples: int
    lost_samples: int
    crc_errors: int
    gaps: int
    repeats: int


class JobLinks(TypedDict):
    """Addresses; `verbs` are those permitted in the present state."""

    self: str
    events: str
    plan: str
    run: str | None
    verbs: dict[str, str]


class ResultLinks(TypedDict):
    """Addresses of a result."""

    result: str
    error_tables_json: str
    error_tables_csv: str
    report_html: str


class Job(TypedDict):
    """A job. It has further keys; these are what most programs need."""

    id: str
    name: str
    note: str
    kind: str
    state: str
    desired_state: str
    version: int
    stage: str
    progress: Progress
    health: Health
    verdict: str | None
    notices: list[Json]
    station: Json | None
    owner: str | None
    created: str
    started: str | None
    ended: str | None
    run_id: str | None
    run_ids: list[str]
    result: ResultLinks | None
    error: Problem | None
    links: JobLinks


class Run(TypedDict):
    """A recorded measurement."""

    id: str
    name: str
    note: str
    origin: str
    mode: str
    machine: str
    samples: int
    lost_samples: int
    complete: bool
    bytes: int
    sha256: str
    created: str


class Plan(TypedDict):
    """A plan; `commanded` and `document` are None until it has succeeded."""

    id: str
    state: str
    created: str
    progress: float
    request: Json
    commanded: Json | None
    document: Json | None
    error: Problem | None


class ErrorTable(TypedDict, total=False):
    """One error motion; standard uncertainties (k = 1)."""

    position_mm: list[float]
    position_deg: list[float]
    value_um: list[float]
    value_urad: list[float]
    uncertainty_um: list[float]
    uncertainty_urad: list[float]
    extrapolated: list[bool]


class Squareness(TypedDict):
    """One squareness in µrad (k = 1)."""

    value: float
    uncertainty: float


class Verdict(TypedDict):
    """Whether a document may be used, and reasons if not."""

    state: str
    reasons: list[str]
    details: list[Json]


class ErrorTables(TypedDict):
    """Error tables by ISO 230-1 symbol, with their verdict."""

    machine: Json
    verdict: Verdict
    error_tables: dict[str, ErrorTable]
    squareness_urad: dict[str, Squareness]
    axis_location: NotRequired[dict[str, Mapping[str, float]]]


class Estimate(TypedDict):
    """The newest estimate of an active measurement.

    commanded : of straight lines to one target: `first_row`, and in `tracker_mm` the
        predicted positions of the rows from it on
    """

    job_id: str
    verdict: Verdict
    volumetric_uncertainty_um: float
    done: int
    total: int
    elapsed_s: float
    is_last: bool
    error_tables: dict[str, ErrorTable]
    squareness_urad: dict[str, Squareness]
    commanded: NotRequired[Json]


class Condition(TypedDict):
    """A requirement for a motion of the machine.

    temperatures : of `temperature-steady`: of each thermometer `channel`, `value_degC`,
        `change_degC`, `over_s`
    """

    type: str
    level: str
    reason: str
    message: str
    is_required: bool
    since: str
    temperatures: list[Json]


class Arming(TypedDict):
    """Motion of a job once it is armed. Further keys exist.

    envelope : of each axis `axis`, `unit`, `low`, `high`; obstacles : types of the
        unmet conditions
    """

    job: str
    version: int
    machine: str
    targets: list[Json]
    envelope: list[Json]
    max_feed_mm_min: float
    duration_s: float
    rows: int
    grows: bool
    conditions: list[Condition]
    obstacles: list[str]
    token: str
    expires: str
    expires_in_s: float


class System(TypedDict):
    """The service."""

    version: str
    simulated: bool
    machine: Json | None
    cell: Json
    current_job: str | None
    time: str


class Machine(TypedDict):
    """A machine of the registry: its identity, and the job that holds it."""

    id: str
    origin: str
    name: str
    maker: str
    model: str
    serial_number: str
    control: str
    customer: str
    place: str
    tolerance_um: float | None
    reference_job: str | None
    created: str
    cell: str
    connected: bool
    current_job: str | None
    version: int | None


class MachineRecord(Machine):
    """A machine with its present and earlier configurations."""

    machine_file: Json
    devices: Json
    versions: list[Json]
