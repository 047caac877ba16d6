"""Models of a machine: their numbers, and `model.json` of a discovery."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from truepath.service.api.models.effects import EffectOut
from truepath.service.api.models.machines.machine_file import MachineFileOut
from truepath.service.api.models.tables import (
    MeasuredTablesOut,
    ObservabilityOut,
    TableColumn,
    VerdictOut,
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


class CataloguedNumbersOut(BaseModel):
    """An effect of the catalogue. Further keys are those of its family."""

    model_config = ConfigDict(extra="allow")

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


class ModelFileOut(MeasuredTablesOut):
    """Content of `model.json`, schema `extended-model/1`. More keys may be there."""

    model_config = ConfigDict(extra="allow")

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
