"""Missing effects of a model and a machine over time: `discovery.json`, `trend.json`.

Uncertainties are standard ones (k = 1).
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.machine_files import (
    ChangeOut,
    MachineFileOut,
    ParentOut,
)
from truepath.service.api.models.plan import Waypoint
from truepath.service.api.models.tables import (
    EffectKeys,
    EffectOut,
    TableColumn,
    TablesOut,
    VerdictOut,
)


class UnnamedOut(BaseModel, extra="allow"):
    """Structure that no effect of the catalogue explains, described by a free form.

    What no free form explains either has the first three keys only. Further keys are
    those of an effect.
    """

    depends_on: list[str] = Field(examples=[["t"]])
    description: str
    rms_um: float
    structure: str | None = None


class CannotTellOut(EffectKeys):
    """An effect that would be clear if all else were known, but is not in these Runs.

    One for a family and axis; further keys are those of its family.
    """

    signal_to_noise: float = Field(description="Alone, at the usual size.")
    taken_by: list[str] = Field(
        description="What absorbs it, the largest share first: `pose`, `timing`, "
        "`squareness`, `tracker-errors`, `model`, or an axis for its error motions.",
        examples=[["pose", "X"]],
    )
    indistinguishable_from: list[EffectKeys]
    would_tell: str = Field(
        examples=["both-directions"],
        description="Key of what to measure; `remedy` for the remedy of the effect.",
    )
    sentence: str = Field(description="All this in words.")


class GapOut(BaseModel):
    """Weighted RMS of measured minus simulated on lines that the fit did not see."""

    unit: Literal["um"]
    before: float
    after: float
    noise_floor: float
    expected: float
    on: str


class SegmentOut(BaseModel):
    """Where a line or point disagrees."""

    segment: int = Field(description="Row of the path or of the points.")
    axis: str
    direction: str
    region: str
    time_s: float
    feed_mm_min: float
    rms_um: float


class SegmentOfRunOut(SegmentOut):
    """The same, of several Runs."""

    run: int = Field(description="Of the Runs, from 0.")


class LineOut(BaseModel):
    """How far a line or point is off, before and after, in the order of time."""

    run: int = Field(description="Of the Runs, from 0.")
    segment: int = Field(description="Row of the path or of the points.")
    axis: str = Field(description="That moves most; empty where none does.")
    direction: str
    time_s: float
    feed_mm_min: float
    before_um: float = Field(description="Root mean square, with the model as it was.")
    after_um: float = Field(description="With the effects that were found.")
    temperature_degC: dict[str, float] = Field(  # noqa: N815
        description="Mean of each sensor; empty where none was recorded."
    )


class ExplanationOut(BaseModel):
    """Shares of the disagreement that go by line, axis, time and so on."""

    before: dict[str, float]
    after: dict[str, float]


class DiscoveryRunOut(BaseModel):
    """Where one Run disagrees."""

    name: str
    mode: Literal["otf", "standstill"]
    where: list[SegmentOut]
    explained_by: ExplanationOut


class DiscoveryProvenanceOut(BaseModel):
    """From what, by what and when."""

    run: str
    software: str
    created: str


class GrownModelOut(BaseModel):
    """The model with what was found in it; the whole of it is `model.json`."""

    version: int
    parent: ParentOut
    difference: list[ChangeOut]


class QuestionOut(BaseModel):
    """Two names that compete, or one whose evidence is thin."""

    between: tuple[str, str] = Field(description="The second is empty for thin.")
    expected_log_bayes: float


class AskOut(BaseModel):
    """A few extra lines that decide."""

    reason: str
    questions: list[QuestionOut]
    decides: bool
    path: str
    rows: list[Waypoint] = Field(description="As a measuring job takes them.")
    lines: int
    duration_s: float


class DiscoveryOut(BaseModel, extra="allow"):
    """Content of `discovery.json`, schema `discovery/1`. More keys may be there."""

    schema_: Literal["discovery/1"] = Field(alias="schema")
    effects: list[EffectOut] = Field(description="By evidence; empty if none lacks.")
    possible: list[EffectOut] = Field(
        description="Names that do not stand clear of others."
    )
    unnamed: list[UnnamedOut]
    cannot_tell: list[CannotTellOut] = Field(
        [], description="Clearest first; missing in answers of earlier versions."
    )
    gap: GapOut
    where: list[SegmentOfRunOut]
    lines: list[LineOut] = Field(
        [], description="Of all Runs; missing in answers of earlier versions."
    )
    explained_by: ExplanationOut
    runs: list[DiscoveryRunOut]
    compared: int = Field(description="Candidates that were compared.")
    provenance: DiscoveryProvenanceOut
    model: GrownModelOut
    verdict: VerdictOut
    ask: AskOut | None = Field(description="Null where nothing is open.")


class QuantilesOut(BaseModel):
    """Median of a number with its 95 % interval."""

    median: float
    low: float
    high: float


class TablesAtOut(TablesOut):
    """The machine at one time."""

    time_h: float = Field(description="Since the middle of the first Run.")
    change_um: QuantilesOut = Field(
        description="How far it is off the tables of the last Run, root mean square "
        "over the travel."
    )


class RunAtOut(TablesAtOut):
    """The machine at one of the Runs, from all of them."""

    name: str
    sha256: str
    temperature_degC: dict[str, tuple[float, float]]  # noqa: N815


class OutlookOut(BaseModel):
    """When to calibrate again; `time_h` with the median and 95 % of courses below."""

    state: Literal[
        "due", "not-within-horizon", "cannot-be-said", "already", "not-known"
    ]
    grade: Literal["certain", "likely", "possible"] | None = Field(
        description="Of due and not-within-horizon: by the chance at the horizon."
    )
    sentence: str
    limit_um: float | None
    chance: float = Field(description="Of exceeding the limit, at which it is due.")
    exceeded: float | None = Field(
        description="The chance that the limit is exceeded by the horizon."
    )
    due_h: float | None
    expected_h: float | None = Field(description="Where the chance is one half.")
    time_h: TableColumn
    median_um: TableColumn
    high_um: TableColumn


class TrendOut(BaseModel):
    """Content of `trend.json`, schema `trend/1`."""

    schema_: Literal["trend/1"] = Field(alias="schema")
    machine: MachineFileOut
    verdict: VerdictOut
    runs: list[RunAtOut]
    later: list[TablesAtOut]
    states: dict[str, QuantilesOut]
    sensors: list[str]
    outlook: OutlookOut
    not_told: list[str]
