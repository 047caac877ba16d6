"""A verification, as `verification.json` states it: uncertainties are standard ones."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from truepath.app.results.conformity import Conformity

Numbers = dict[str, float]


class AgreementOut(BaseModel):
    """Whether measurement and result agree within what both state."""

    consistent: bool
    chi_square: float
    freedom: int
    noise_freedom: float
    chance: float
    share_within_expanded: float
    chance_of_any_machine: float = Field(
        description="Small where no machine of this model explains the measurement."
    )


class ScaleOut(BaseModel):
    """How much of the map of the result the machine still has."""

    value: float = Field(description="1 as found, 0 compensated, 2 with a wrong sign.")
    uncertainty: float


class ConformityOut(BaseModel):
    """Lengths of the error at all places against a tolerance, by ISO 14253-1."""

    conformity: Conformity
    rule: str
    tolerance_um: float
    coverage_factor: float
    length_um: float = Field(description="Of the place that decides.")
    expanded_uncertainty_um: float
    row: int
    position: list[float]


class DifferenceOut(BaseModel):
    """Measured less predicted, µm."""

    value: float
    expanded_uncertainty: float
    within: bool


class LineOut(BaseModel):
    """An axis alone (ISO 230-2) or a diagonal (ISO 230-6), µm."""

    axes: str
    standard: str
    runs: int
    position_mm: list[float]
    forward_um: list[float]
    backward_um: list[float]
    figures_um: Numbers = Field(description="A, E, R, B and M.")
    uncertainty_um: Numbers
    by_the_noise_alone_um: Numbers
    predicted_um: Numbers


class CircleOut(BaseModel):
    """A circle at standstill (ISO 230-4), µm."""

    plane: str
    standard: str
    radius_mm: float
    angle_deg: list[float]
    radial_um: list[float]
    figures_um: Numbers = Field(description="G, F_max and F_min.")
    uncertainty_um: Numbers
    predicted_um: Numbers


class PlacesOut(BaseModel):
    """Errors at each place, µm."""

    row: list[int]
    position: list[list[float]]
    standstill: list[bool]
    measured_um: list[list[float]]
    measured_uncertainty_um: list[list[float]]
    predicted_um: list[list[float]]
    predicted_uncertainty_um: list[list[float]]
    deviation_um: list[list[float]]


class VerificationOut(BaseModel):
    """A result held against a measurement that it was not made from."""

    schema_: Literal["verification/1"] = Field(alias="schema")
    machine: str
    compensated: bool
    verdict: dict[str, Any] = Field(description="That of the result.")
    statements: list[str] = Field(description="What was found, in sentences.")
    asked: dict[str, Any] = Field(
        description="The request, with the seed that points were drawn from."
    )
    agreement: AgreementOut
    map_scale: ScaleOut | None
    conformity: dict[Literal["measured", "deviation"], ConformityOut]
    volumetric_error_um: dict[Literal["measured", "predicted", "deviation"], Numbers]
    difference_um: dict[Literal["mean", "p95", "largest"], DifferenceOut]
    directions: dict[str, Numbers]
    worst: dict[str, dict[str, Any]]
    lines: list[LineOut]
    circles: list[CircleOut]
    places: PlacesOut
    components: str
    gauge: str
    noise: dict[str, Any]
    run: dict[str, Any]
    provenance: dict[str, Any]
