"""Part of a result about one Run."""

from __future__ import annotations

from typing import Generic, Literal, TypeVar

from pydantic import BaseModel, Field

from truepath.service.api.models.machine_files import (
    MachineFileOut,
    ModelNumbersOut,
    RunDigestOut,
    UsedModelOut,
)
from truepath.service.api.models.plan_document import GradeOut
from truepath.service.api.models.tables import (
    MeasuredTablesOut,
    ObservabilityOut,
    TableColumn,
    TablesOut,
    UpdatedEffectOut,
    Vector3,
    VerdictOut,
)


class PoseOut(BaseModel):
    """Where the tracker stood: p_tracker = rotation · p_workpiece + shift_mm."""

    from_: Literal["workpiece"] = Field(alias="from")
    to: Literal["tracker"]
    rotation: tuple[Vector3, Vector3, Vector3]
    shift_mm: Vector3


class PoseUncertaintyOut(BaseModel):
    """Standard uncertainties of the pose about a point."""

    about_mm: Vector3
    shift_um: Vector3
    turn_urad: Vector3


class AlignmentOut(BaseModel):
    """Where the tracker stood, and what of the commanded rows was found."""

    pose: PoseOut
    pose_uncertainty: PoseUncertaintyOut
    lines: int
    matched_lines: int
    rows_without_data: list[int]
    cells: int
    samples: int
    used_samples: int


class ByDirectionOut(BaseModel):
    """In the frame of the beam, root mean square."""

    beam: float
    azimuth: float
    elevation: float


class LineFitOut(BaseModel):
    """How a line or point fits."""

    row: int
    cells: int
    rms_um: float


class ResidualsOut(BaseModel):
    """What the estimate leaves of the measurement."""

    rms_um: float
    noise_floor_um: float
    by_direction_um: ByDirectionOut


class AlongLineOut(BaseModel):
    """Residual of every cell of a line, in the frame of the beam."""

    row: int
    along_mm: list[float] = Field(description="From the first cell of the line.")
    beam_um: list[float]
    azimuth_um: list[float]
    elevation_um: list[float]


class RunResidualsOut(ResidualsOut):
    """What the estimate leaves of one Run."""

    by_line: list[LineFitOut]
    along_lines: list[AlongLineOut] | None = Field(
        None, description="Not in results of earlier versions."
    )


class CommandedOut(BaseModel):
    """What was commanded."""

    sha256: str
    rows: int
    shown_mm: list[list[float]] = Field(
        description="Linear axes at every row, or at every so many of a long path."
    )


class BeamNoiseOut(BaseModel):
    """Along and across the beam, 1 σ."""

    along_beam: float
    across_beam: float


class PlaceNoiseOut(BaseModel):
    """By direction of the tracker, 1 σ; 0 on the fly."""

    beam: float
    azimuth: float
    elevation: float


class NoiseFoundOut(BaseModel):
    """Noise of the tracker: stated by the machine file, and as it was found."""

    distance_mm: float
    stated_um: BeamNoiseOut
    white_um: BeamNoiseOut
    slow_um: BeamNoiseOut
    slow_time_s: float
    between_places_um: PlaceNoiseOut | None = Field(
        default=None, description="What one standstill differs from the next by."
    )
    along_travel_um: float | None = Field(description="Null at standstill.")


class SensorOut(BaseModel):
    """What a sensor showed; null where it showed nothing."""

    name: str
    mean: float | None
    low: float | None
    high: float | None
    change: float | None
    readings: int
    rows: int
    longest_without_s: float
    used: bool


class LightOut(BaseModel):
    """Light of a tracker that does not correct for the air."""

    wavelength_nm: float
    is_group: bool


class RefractionOut(BaseModel):
    """Who has corrected the ranges for the air."""

    by: str = Field(
        examples=["instrument"], description="instrument, truepath, nobody or unknown"
    )
    light: LightOut | None
    index: float | None
    air: Vector3 | None = Field(description="Mean in °C, hPa and %.")
    why: str
    assumed: list[str] = Field(
        [],
        examples=[["humidity_percent"]],
        description="What of the air was not measured, but taken as usual; "
        "`altitude_m` where the site's is not known and its pressure was taken.",
    )


class RangeScaleOut(BaseModel):
    """What the air leaves of the scale of all ranges."""

    uncertainty_ppm: float | None
    per_K_ppm: float  # noqa: N815
    per_hPa_ppm: float  # noqa: N815
    in_tables: bool = Field(
        description="Whether the tables' uncertainties contain it; earlier: no."
    )


class EnvironmentOut(BaseModel):
    """Sensors of the Run, and the air."""

    sensors: list[SensorOut]
    told: list[str]
    refraction: RefractionOut
    range_scale: RangeScaleOut


class InterruptionsOut(BaseModel):
    """How often the stream was not usable, and for how long."""

    breaks: int
    broken_s: float
    gaps: int
    lost_samples: int
    searches: int
    found: int
    driven_again: list[str] = Field(
        description="What, each time.", examples=[["from row 4 on"]]
    )


class SampleQualityOut(BaseModel):
    """Quality of the valid samples by the instrument, 1 is best."""

    mean: float
    low: float
    told: float


class SeatOut(BaseModel):
    """How far a target sits beside where it is stated."""

    target: str
    on: Literal["tool", "workpiece"]
    shift_um: Vector3
    uncertainty_um: Vector3


class ResultRunOut(BaseModel):
    """What is said of one Run."""

    name: str
    part: int | None = Field(description="From 1, where it was split at a knock.")
    mode: Literal["otf", "standstill"]
    samples: int
    used_samples: int
    measured_s: float
    feed_mm_min: list[float] | None
    input_sha256: str
    source: dict[str, str] = Field(description="Where it came from, and digests.")
    tracker_told: list[str]
    commanded: CommandedOut | None = Field(
        None, description="Not in results of earlier versions."
    )
    environment: EnvironmentOut
    interruptions: InterruptionsOut
    sample_quality: SampleQualityOut | None
    tracker_mm: Vector3
    without_it_um: float | None = Field(
        description="Volumetric uncertainty of the other Runs alone."
    )
    alignment: AlignmentOut
    residuals: RunResidualsOut
    noise: NoiseFoundOut
    seats: list[SeatOut]


T = TypeVar("T")


class TrialBothUnits(BaseModel, Generic[T]):
    """What the linear law states beside the trials, µm or µrad.

    `tolerance` is δ of clause 8, by which `agrees` is decided.
    """

    value_um: T | None = None
    linear_uncertainty_um: T | None = None
    mean_um: T | None = None
    uncertainty_um: T | None = None
    interval_95_low_um: T | None = None
    interval_95_high_um: T | None = None
    tolerance_um: T | None = None
    value_urad: T | None = None
    linear_uncertainty_urad: T | None = None
    mean_urad: T | None = None
    uncertainty_urad: T | None = None
    interval_95_low_urad: T | None = None
    interval_95_high_urad: T | None = None
    tolerance_urad: T | None = None


class TrialTableOut(TrialBothUnits[TableColumn]):
    """Numbers along an axis, one a position."""

    position_mm: TableColumn | None = None
    position_deg: TableColumn | None = None
    agrees: list[bool]


class TrialNumberOut(TrialBothUnits[float]):
    """One number."""

    agrees: bool


class TrialMapOut(BaseModel):
    """The volumetric error at a few positions: x, y and z of one after another."""

    of: str
    position: list[list[float]]
    value_um: TableColumn
    linear_uncertainty_um: TableColumn
    mean_um: TableColumn
    uncertainty_um: TableColumn
    interval_95_low_um: TableColumn
    interval_95_high_um: TableColumn
    tolerance_um: TableColumn
    agrees: list[bool]


class TrialsOut(BaseModel):
    """The uncertainties held against trials."""

    method: str
    seed: int
    trials: int
    block: int
    significant_digits: int
    coverage: float
    interval: Literal["symmetric", "shortest"]
    settled: bool
    agrees: bool
    numbers: int
    agreeing: int
    largest_disagreement: float
    error_tables: dict[str, TrialTableOut]
    squareness_urad: dict[str, TrialNumberOut]
    axis_location: dict[str, TrialNumberOut]
    volumetric_error: TrialMapOut


class LeftOutOut(BaseModel):
    """Samples that were not used."""

    run: int = Field(description="Of the Runs given, from 0.")
    cause: str
    row: int | None
    from_s: float | None
    to_s: float | None
    samples: int
    distance_um: float | None


class SetupStepOut(BaseModel):
    """The set-up changed at one moment and was solved before and after it."""

    run: int
    row: int
    kind: Literal["place", "tilt", "range", "pose"] = Field(
        "pose",
        description="place or tilt of the tracker; range: another range offset; pose: "
        "neither place nor tilt alone, and results of earlier versions.",
    )
    t_s: float
    shift_um: float = Field(
        description="At the middle of the points; of range, how much longer distances "
        "are since then."
    )
    turn_urad: float


class HoldingTargetOut(BaseModel):
    """A target that was measured."""

    name: str
    on: Literal["tool", "workpiece"]
    offset_mm: Vector3


class HoldsForOut(BaseModel):
    """What the tables hold for."""

    any_tool: bool = Field(description="Else for these targets only.")
    targets: list[HoldingTargetOut]


class FigureOut(BaseModel):
    """A number in µm with its standard uncertainty."""

    value_um: float
    uncertainty_um: float
    scale_uncertainty_um: float | None = Field(
        None,
        description="The part of it that comes from the scale of all lengths, of air "
        "and tracker. Earlier versions do not have it, nor the scale in their sum.",
    )


class VolumetricSpreadOut(BaseModel):
    """Length of the volumetric error over a grid."""

    mean: FigureOut
    p95: FigureOut = Field(description="95 % of the points are below it.")
    largest: FigureOut


class VolumetricOut(BaseModel):
    """Volumetric error before compensation, and expected after it."""

    before: VolumetricSpreadOut = Field(
        description="Of the map, which is the mean of both directions of travel."
    )
    after_expected: VolumetricSpreadOut
    both_directions: VolumetricSpreadOut | None = Field(
        default=None,
        description="Before, every place come to in both directions: with lost motion. "
        "Mean and 95 % over positions that fill the travel evenly, as in the account "
        "of compensation files. Null where no lost motion is determined.",
    )
    left_in_both_directions: VolumetricSpreadOut | None = Field(
        default=None,
        description="What tables of the mean of both directions leave there: lost "
        "motion stays unless the control corrects it.",
    )
    on: str


class LineOfRunOut(BaseModel):
    """How a line or point fits."""

    run: int
    row: int
    cells: int
    rms_um: float


class AllResidualsOut(ResidualsOut):
    """Residuals of all Runs."""

    by_line: list[LineOfRunOut]


class NoiseOut(NoiseFoundOut):
    """Noise of the first Run, and how strongly the prior counted."""

    prior_strength: dict[str, float] = Field(description="By symbol.")


class OptionsOut(BaseModel):
    """How it was computed."""

    perpendicular_only: bool


class KnownLengthsOut(BaseModel):
    """By how much the tracker's ranges were too long, by known lengths."""

    count: int
    off_ppm: float
    uncertainty_ppm: float = Field(description="Standard uncertainty of it.")


class ProvenanceOut(BaseModel):
    """From what, by what and when it was made."""

    software: str
    software_version: str
    created: str
    run: str
    input_sha256: str
    runs: list[RunDigestOut]
    source: dict[str, str] = Field(description="Where it came from, and digests.")
    control_compensation: Literal["on", "off", "mixed"] | None = Field(
        None, description="Whether the control compensated; null where nobody says."
    )
    active_tables: dict[str, str] | None = Field(
        None, description="SHA-256 by name of the files that were active, if known."
    )
    options: OptionsOut
    model: UsedModelOut | None
    measured_s: float
    length_scale_ppm: float | None = Field(
        None,
        description="Standard uncertainty that all lengths have in common, of air and "
        "tracker. Earlier versions lack it.",
    )
    length_scale_in_tables: bool = Field(
        False,
        description="Whether the tables' uncertainties contain it, as that of the "
        "volumetric error does. Earlier versions: no.",
    )
    known_lengths: KnownLengthsOut | None = Field(
        None,
        description="What known lengths say of that scale; the result is without it.",
    )
    feed_mm_min: list[float] | None
    temperature_degC: dict[str, tuple[float, float]] = Field(  # noqa: N815
        description="Lowest and highest, by sensor."
    )


class ResultOut(MeasuredTablesOut, extra="allow"):
    """Content of `result.json`, schema `result/1`. More keys may be there.

    Values in µm and µrad with standard uncertainties (k = 1).
    """

    schema_: Literal["result/1"] = Field(alias="schema")
    machine: MachineFileOut
    mode: Literal["otf", "standstill"]
    verdict: VerdictOut
    left_out: list[LeftOutOut]
    setup_steps: list[SetupStepOut]
    effects: list[UpdatedEffectOut]
    monte_carlo: TrialsOut | None = Field(
        description="The uncertainties held against trials, where that was asked."
    )
    holds_for: HoldsForOut
    volumetric_error: VolumetricOut
    volumetric_uncertainty_um: float | None = Field(
        description="Root mean square over the travel."
    )
    alignment: AlignmentOut = Field(description="Of the first Run.")
    residuals: AllResidualsOut
    noise: NoiseOut
    runs: list[ResultRunOut]
    observability: ObservabilityOut
    grade: GradeOut | None
    provenance: ProvenanceOut
    model: ModelNumbersOut = Field(
        description="What prediction needs: parameters with their covariance."
    )


class ErrorTablesOut(TablesOut):
    """The error tables alone, with the verdict on them; standard uncertainties."""

    schema_: Literal["error-tables/1"] = Field(alias="schema")
    machine: MachineFileOut
    verdict: VerdictOut
