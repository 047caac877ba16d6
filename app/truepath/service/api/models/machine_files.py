"""A machine, as in `machine.json`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.tables import (
    EffectOut,
    MeasuredTablesOut,
    ObservabilityOut,
    TableColumn,
    Vector3,
    VerdictOut,
)


class LinearAxisOut(BaseModel):
    """The travel of a linear axis."""

    type: Literal["linear"]
    min_mm: float
    max_mm: float


class RotaryAxisOut(BaseModel):
    """The travel of a rotary axis, and the line that it turns about."""

    type: Literal["rotary"]
    min_deg: float
    max_deg: float
    origin_mm: Vector3
    direction: Vector3


AxisOut = Annotated[LinearAxisOut | RotaryAxisOut, Field(discriminator="type")]


class TargetOut(BaseModel):
    """Where a reflector sits."""

    on: Literal["tool", "workpiece"]
    offset_mm: Vector3
    seat_sigma_mm: float | None = Field(
        None, description="How well that is known; 1 mm where it is left out."
    )


class TrackerNoiseOut(BaseModel):
    """Noise of one sample of the tracker, 1 σ, where it stands, how far it is off."""

    range_sigma_um: float
    range_ppm: float
    angle_sigma_urad: float
    transverse_sigma_um: float
    rate_hz: float
    stands_on: Literal["workpiece", "base"]
    specification: dict[str, float] | None = Field(
        None, description="By its key; that of a typical tracker where left out."
    )
    face: Literal[1, 2] | None = Field(
        None, description="In which it measures; left out where it has not two."
    )


class MotionLimitsOut(BaseModel):
    """What the machine can, as far as its file says so."""

    max_feed_mm_min: float | None = None
    acceleration_mm_s2: float | None = None
    jerk_mm_s3: float | None = None


class ApproachOut(BaseModel):
    """How an NC program goes to its first row, one axis after another."""

    clearance_mm: dict[str, float] | None = Field(
        None, description="Axes that go first, and where to."
    )
    order: list[str] = Field(description="Then all axes, to the row; empty: as usual.")
    feed_mm_min: float


class MachineCoreOut(BaseModel):
    """Name, chain, axes and targets of a machine."""

    name: str = Field(examples=["mill-3"])
    kinematic_chain: str = Field(
        examples=["w-X-b-Y-Z-t"], description="From workpiece to tool (ISO 10791-6)."
    )
    axes: dict[str, AxisOut] = Field(description="By name: X, Y, Z, A, B, C.")
    tool_offset_mm: Vector3 | None = Field(
        None, description="Of the one target in the tool; else there are `targets`."
    )
    targets: dict[str, TargetOut] | None = Field(None, description="By name.")
    site: dict[str, float] | None = Field(
        None, examples=[{"altitude_m": 120.0}], description="Where its file states it."
    )


class MachineFileOut(MachineCoreOut):
    """Content of `machine.json`, schema `machine/1`."""

    schema_: Literal["machine/1"] = Field(alias="schema")
    tracker: TrackerNoiseOut
    motion: MotionLimitsOut | None = None
    approach: ApproachOut | None = Field(
        None, description="Of NC programs to their first row, where its file says it."
    )


class ParentOut(BaseModel):
    """What a model came from."""

    version: int
    source: str = Field(description="Identifier of a model or job here, or in words.")
    sha256: str | None = Field(description="Of its file; null where it had none.")


class ChangeOut(BaseModel):
    """One difference of two models."""

    kind: Literal["added", "removed", "changed"]
    what: str = Field(examples=["backlash Y"])
    text: str = Field(examples=["backlash Y: width 6.39 ± 0.15 µm"])


class ErrorMotionNumbersOut(BaseModel):
    """An error motion: values of its spline at knots along its axis."""

    effect: Literal["error-motion"]
    symbol: str
    knots_mm: TableColumn | None = None
    knots_deg: TableColumn | None = None
    values_um: TableColumn | None = None
    values_urad: TableColumn | None = None


class NumberOfModelOut(BaseModel):
    """A squareness, or a location error of a rotary axis."""

    effect: Literal["squareness", "axis-location"]
    symbol: str
    value_um: float | None = None
    value_urad: float | None = None


class CataloguedNumbersOut(BaseModel, extra="allow"):
    """An effect of the catalogue. Further keys are those of its family."""

    effect: Literal["catalogued"]
    name: str
    numbers: dict[str, float]
    values: list[float]
    units: list[str]


NumbersOut = Annotated[
    ErrorMotionNumbersOut | NumberOfModelOut | CataloguedNumbersOut,
    Field(discriminator="effect"),
]


class CovarianceOut(BaseModel):
    """Covariance of all numbers, packed."""

    of: str
    size: int
    encoding: str
    data: str


class ModelNumbersOut(BaseModel):
    """Every number of a model with their covariance, schema `model/1`."""

    schema_: Literal["model/1"] = Field(alias="schema")
    effects: list[NumbersOut]
    confounded: list[str] = Field(description="Symbols that one target cannot part.")
    covariance: CovarianceOut


class LinearNumbersOut(BaseModel):
    """Linear parameters of an effect with their covariance."""

    names: list[str]
    units: list[str]
    values: list[float]
    covariance: list[list[float]]


class EffectOfModelOut(EffectOut):
    """An effect that was found. Further keys are those of its family."""

    part_of: Literal["machine", "measurement"]
    linear: LinearNumbersOut


class RunDigestOut(BaseModel):
    """A Run behind the numbers."""

    name: str
    input_sha256: str
    sketch: str = Field(
        "",
        description="Smallest hashes of its samples, by which a part of it is known. "
        "Empty in files of earlier versions.",
    )


class UsedModelOut(ParentOut):
    """The model that a result or a plan was made with."""

    taken: str | None = Field(None, description="What of it, in words.")


class ModelProvenanceOut(BaseModel):
    """From what, by what and when it was made."""

    software: str
    software_version: str
    created: str
    run: str
    input_sha256: str
    runs: list[RunDigestOut]


class ModelFileOut(MeasuredTablesOut, extra="allow"):
    """Content of `model.json`, schema `extended-model/1`. More keys may be there."""

    schema_: Literal["extended-model/1"] = Field(alias="schema")
    version: int
    parent: ParentOut
    difference: list[ChangeOut]
    machine: MachineFileOut
    mode: Literal["otf", "standstill"]
    verdict: VerdictOut
    effects: list[EffectOfModelOut]
    observability: ObservabilityOut
    provenance: ModelProvenanceOut
    model: ModelNumbersOut
