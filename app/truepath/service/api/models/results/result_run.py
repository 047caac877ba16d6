"""Part of a result about one Run."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.tables import Vector3


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
