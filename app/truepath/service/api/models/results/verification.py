"""A verification, as in `verification.json`; standard uncertainties (k = 1)."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.answers.verification.conformity import Conformity
from truepath.service.api.models.results.result import EnvironmentOut, ProvenanceOut
from truepath.service.api.models.tables import VerdictOut

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
    expected: float | None = Field(
        None,
        description="1 as found, else what the named files leave of it. Verifications "
        "of earlier versions do not have it.",
    )
    cause: Literal["wrong-sign", "not-active", "active"] | None = Field(
        None,
        description="Why it is not what is expected, of the control's compensation; "
        "null where it is. Verifications of earlier versions do not have it.",
    )


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
    from_: list[float] = Field(alias="from", description="Positions of the axes.")
    to: list[float]
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
    centre: list[float] = Field(description="Positions of the axes.")
    radius_mm: float
    angle_deg: list[float]
    radial_um: list[float]
    figures_um: Numbers = Field(
        description="G, F_max and F_min, each the middle of the interval that noise "
        "leaves for it."
    )
    uncertainty_um: Numbers
    by_the_noise_alone_um: Numbers = Field(
        default_factory=dict[str, float],
        description="Verifications of earlier versions do not have it.",
    )
    predicted_um: Numbers
    driven: str = Field(description="How it was, in words.")


class CircleInMotionOut(BaseModel):
    """A circle driven on the fly (ISO 230-4), µm, by its senses."""

    plane: str
    standard: str
    diameter_mm: float
    feed_mm_min: float = Field(description="As commanded.")
    driven_feed_mm_min: Numbers = Field(description="As measured.")
    row: dict[str, int]
    samples: dict[str, int]
    sector_deg: float = Field(description="Over which the radius is averaged.")
    angle_deg: list[float]
    radial_um: dict[str, list[float]] = Field(
        description="Radius less the commanded one, about the commanded centre."
    )
    predicted_radial_um: dict[str, list[float]]
    centre_um: dict[Literal["measured", "predicted"], tuple[float, float]] | None = (
        Field(
            None,
            description="Of the circle of least squares of both senses, from the "
            "commanded centre, along the axes of the plane. The figures are about it, "
            "and so is what a chart shows: the radius less cos(angle) and sin(angle) "
            "times it. Verifications of earlier versions do not have it.",
        )
    )
    figures_um: Numbers = Field(
        description="H, G of both senses and of each, F_max and F_min, less what the "
        "noise adds to them. H where both senses were driven."
    )
    uncertainty_um: Numbers
    by_the_noise_alone_um: Numbers
    predicted_um: Numbers
    predicted_uncertainty_um: Numbers
    difference_um: dict[str, DifferenceOut]


class PlacesOut(BaseModel):
    """Errors at each place, µm."""

    row: list[int]
    run: list[int] | None = Field(
        None,
        description="Which of `runs` measured it, from 0: each has a rigid motion of "
        "its own taken out. Earlier versions do not say.",
    )
    position: list[list[float]]
    standstill: list[bool]
    conformity: list[Conformity] | None = Field(
        None,
        description="Of each place as measured; null without a tolerance, and of "
        "earlier versions.",
    )
    measured_um: list[list[float]]
    measured_uncertainty_um: list[list[float]]
    predicted_um: list[list[float]]
    predicted_uncertainty_um: list[list[float]]
    deviation_um: list[list[float]]


class WorstPlaceOut(BaseModel):
    """Where the error, or what the result does not predict, is largest."""

    row: int
    position: list[float]
    length_um: float
    expanded_uncertainty_um: float


class VerificationAskedOut(BaseModel, extra="allow"):
    """The request. Further keys may be there."""

    result_id: str | None = None
    what: list[str] | None = None
    seed: int | None = Field(None, description="That points were drawn from.")
    tolerance_um: float | None = None
    compensation_id: str | None = None


class NoiseOfStatedOut(BaseModel):
    """Noise of the tracker in parts of what is stated: along the beam and across."""

    white_of_stated: tuple[float, float]
    correlated_of_stated: tuple[float, float]
    correlation_time_s: float


class LeftOutOfRunOut(BaseModel):
    """Samples that were not used."""

    cause: str
    row: int | None
    from_s: float | None
    to_s: float | None
    samples: int


class VerifyingRunOut(BaseModel):
    """The measurement that the result is held against."""

    name: str
    mode: Literal["otf", "standstill"]
    input_sha256: str
    samples_used: int
    samples_offered: int
    left_out: list[LeftOutOfRunOut]
    length_scale_ppm: float | None = Field(
        None,
        description="Standard uncertainty of all its lengths in common, of air and "
        "tracker, which is in the uncertainties. Earlier versions do not have it.",
    )
    environment: EnvironmentOut | None = Field(
        None, description="As of a calibration. Earlier versions do not have it."
    )


class VerifyingPartOut(VerifyingRunOut):
    """A Run of a verification: there are several where it was cut short and went on."""

    noise: NoiseOfStatedOut


class VerificationProvenanceOut(BaseModel):
    """By what and when it was made, and from which result."""

    software: str
    software_version: str
    created: str
    result: ProvenanceOut


class ActiveFilesOut(BaseModel):
    """Compensation files that were active while it was measured."""

    format: str = Field(examples=["linuxcnc"])
    files_sha256: dict[str, str] = Field(description="SHA-256 by name.")


class VerificationOut(BaseModel):
    """A result held against a measurement that it was not made from."""

    schema_: Literal["verification/1"] = Field(alias="schema")
    machine: str
    compensated: bool
    compensation: ActiveFilesOut | None = Field(
        None, description="Null where no files were named."
    )
    verdict: VerdictOut = Field(description="That of the result.")
    run_verdict: VerdictOut | None = Field(
        None,
        description="What is wrong with the verifying measurement itself: ranges that "
        "are not corrected for the air. Earlier versions do not have it.",
    )
    statements: list[str] = Field(description="What was found, in sentences.")
    asked: VerificationAskedOut
    agreement: AgreementOut
    map_scale: ScaleOut | None
    conformity: dict[Literal["measured", "deviation"], ConformityOut]
    volumetric_error_um: dict[Literal["measured", "predicted", "deviation"], Numbers]
    difference_um: dict[Literal["mean", "p95", "largest"], DifferenceOut]
    directions: dict[str, Numbers]
    worst: dict[Literal["measured", "deviation"], WorstPlaceOut]
    lines: list[LineOut]
    circles: list[CircleOut]
    circles_in_motion: list[CircleInMotionOut] = Field(
        [], description="Circles driven on the fly. Earlier versions have none."
    )
    circles_missing: list[int] = Field(
        [], description="Rows of circles that were not driven whole."
    )
    places: PlacesOut
    components: str
    unseen_directions: list[str] = Field(
        [],
        description="Directions along which nothing was measured: no tolerance is kept "
        "there for certain.",
    )
    axes_at_rest: list[str] = Field(
        [],
        description="Axes that were not driven: nothing is said of them, and where a "
        "linear one is among them no tolerance is kept for certain.",
    )
    gauge: str
    noise: NoiseOfStatedOut
    run: VerifyingRunOut = Field(description="The first of `runs`.")
    runs: list[VerifyingPartOut] = Field(
        default_factory=list[VerifyingPartOut],
        description="All Runs, in the order of driving; not in files of before.",
    )
    provenance: VerificationProvenanceOut
