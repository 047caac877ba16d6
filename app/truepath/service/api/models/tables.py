"""Error tables and their verdict, common to all documents."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.files.earlier.verdict import State as VerdictState

TableColumn = list[float]
Vector3 = tuple[float, float, float]


class LiveTableOut(BaseModel):
    """One error motion: positions in mm or deg, values in µm or µrad (k = 1)."""

    position_mm: TableColumn | None = Field(None, description="Of a linear axis.")
    position_deg: TableColumn | None = Field(None, description="Of a rotary axis.")
    value_um: TableColumn | None = Field(None, description="Of a displacement.")
    value_urad: TableColumn | None = Field(None, description="Of a turn.")
    uncertainty_um: TableColumn | None = None
    uncertainty_urad: TableColumn | None = None


class ErrorTableOut(LiveTableOut):
    """One error motion, with what lies beyond the measured range of its axis."""

    extrapolated: list[bool]


class SquarenessOut(BaseModel):
    """One squareness in µrad."""

    value: float
    uncertainty: float = Field(description="Standard uncertainty (k = 1).")


class AxisLocationOut(BaseModel):
    """Where a rotary axis is: a displacement in µm or a turn in µrad (k = 1)."""

    value_um: float | None = None
    value_urad: float | None = None
    uncertainty_um: float | None = None
    uncertainty_urad: float | None = None


class ReasonOut(BaseModel):
    """One reason of a verdict, for programs: its kind and the values it names."""

    kind: str = Field(examples=["other-feed"])
    state: VerdictState
    run: str = Field(description="Of several; empty else.")
    values: dict[str, int | float | str] = Field(
        description="By name; the unit stands in the name."
    )
    remedy: str


class VerdictOut(BaseModel):
    """What a document says of itself: whether it may be used."""

    state: VerdictState
    reasons: list[str] = Field(description="In words; empty where it is usable.")
    details: list[ReasonOut] = Field(description="The same for programs.")


class TablesOut(BaseModel):
    """Every error of a machine: by ISO 230-1 symbol."""

    error_tables: dict[str, ErrorTableOut]
    squareness_urad: dict[str, SquarenessOut]
    axis_location: dict[str, AxisLocationOut] | None = Field(
        None, description="Of machines with rotary axes."
    )


class DirectionOut(BaseModel):
    """How tables depend on the direction of approach."""

    model: str = Field(examples=["none"], description="none, constant or by-position")
    half_difference: dict[str, LiveTableOut] = Field(
        description="By symbol: half of + direction minus - direction."
    )


class RangeOut(BaseModel):
    """The range of an axis that was measured."""

    from_mm: float | None = None
    to_mm: float | None = None
    from_deg: float | None = None
    to_deg: float | None = None


class MeasuredTablesOut(TablesOut):
    """The same, with direction and measured ranges."""

    direction: DirectionOut
    measured_range: dict[str, RangeOut] = Field(
        description="By axis; tables are extrapolated beyond it."
    )


class ObservabilityOut(BaseModel):
    """What the data tell and what they do not."""

    rank: int
    parameters: int
    unobservable: list[str] = Field(examples=[["ECZ …"]])
    weak: list[str]


class NumberOut(BaseModel):
    """A number of an effect with its standard uncertainty; three where it is a vector.

    The unit stands in its name.
    """

    value: float | list[float]
    uncertainty: float | list[float]


class EffectKeys(BaseModel, extra="allow"):
    """What tells an effect from others. Families that plug in may have further keys."""

    name: str = Field(
        examples=["backlash"], description="Of the catalogue of effects; it may grow."
    )
    axis: str | None = Field(None, examples=["Y"])
    motion: str | None = Field(None, examples=["EYX"])
    by: str | None = Field(None, description="Axis whose carriage bends a guide.")
    direction: str | None = None
    circle: str | None = None
    unit: str | None = Field(None, description="Of the numbers of a motion.")


class EvidenceOut(BaseModel):
    """Why it is believed, on lines that the fit did not see."""

    log_bayes_factor: float
    held_out_log_score: float
    share_of_gap: float


class EffectStatementOut(BaseModel):
    """How sure it is, how large, and what it means in words."""

    grade: Literal["certain", "likely", "possible"]
    parameters: dict[str, NumberOut] = Field(description="The unit is in the name.")
    evidence: EvidenceOut
    indistinguishable_from: list[EffectKeys]
    largest_um: float | None = Field(
        None, description="By which it moves the target in all that was measured."
    )
    is_small: bool = Field(
        default=False, description="Less than a control corrects: nothing to be done."
    )
    cause: str
    looks_like: str
    remedy: str


class EffectOut(EffectKeys, EffectStatementOut):
    """An effect that the model lacked. Further keys are those of its family."""


class UpdatedEffectOut(EffectKeys):
    """An effect of the model in use, with what this measurement makes of it.

    Further keys are those of its family.
    """

    parameters: dict[str, NumberOut]
    known_before: dict[str, NumberOut] | None = Field(
        description="Null where the model was made from the same Run."
    )
    agrees: bool | None = Field(
        None, description="Of this Run with what was known; null where it cannot tell."
    )
