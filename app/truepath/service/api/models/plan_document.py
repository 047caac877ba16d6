"""The grade of a set-up before anything moves."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.machine_files import MachineFileOut, UsedModelOut
from truepath.service.api.models.tables import UpdatedEffectOut, Vector3, VerdictOut


class Thresholds(BaseModel):
    """Numbers up to which a set-up is good, and usable."""

    good: float = Field(examples=[0.25])
    usable: float = Field(examples=[1.0])


class TrackerPlace(BaseModel):
    """Where the tracker stands for this grade."""

    position_mm: Vector3
    assumed: bool = Field(description="Nobody has said so: the worst of usual places.")
    best_number: float = Field(description="At the best of the places.")


class WeakMotionOut(BaseModel):
    """One of the weakest error motions."""

    error: str = Field(examples=["EBZ"])
    meaning: str = Field(examples=["turn of Z about Y"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")
    remedy: str | None


class GradeOut(BaseModel):
    """The grade of a set-up from geometry alone; uncertainties are standard ones."""

    number: float = Field(
        examples=[0.11],
        description="Expected uncertainty of the map over the scatter of one sample.",
    )
    verdict: Literal["good", "usable", "poor"] = Field(examples=["good"])
    thresholds: Thresholds
    text: str
    expected_uncertainty_um: float
    sample_sigma_um: float
    tracker: TrackerPlace
    improved_number: float | None = Field(
        description="With the line that the weakest motion asks for."
    )
    weakest: list[WeakMotionOut]
    weak_shapes: list[str]
    unobservable: list[str]


class MapUncertaintyOut(BaseModel):
    """A volumetric uncertainty, as k = 1 and as k = 2."""

    volumetric_uncertainty_um: float
    expanded_volumetric_uncertainty_um: float


class PlannedMotionOut(BaseModel):
    """What the machine can; `assumed` says in words what its file does not state."""

    max_feed_mm_min: float
    acceleration_mm_s2: float
    jerk_mm_s3: float | None
    assumed: list[str]


class FeedWorthOut(BaseModel):
    """Lines of one feed, and what a second would tell with this feed for all."""

    feed_mm_min: float
    lines: int
    relative_information_per_s: float


class FeedChoiceOut(BaseModel):
    """Why lines have the feeds they have."""

    feeds: list[FeedWorthOut]
    reason: str


class PlannedPlaceOut(BaseModel):
    """Where the tracker is to stand."""

    position_mm: Vector3
    assumed: bool
    chosen: bool = Field(description="Chosen in the areas of the workspace.")


class MapShareOut(BaseModel):
    """What a place leaves of the map; `seen` is the share of the travel in sight."""

    volumetric_uncertainty_um: float
    random_um: float
    systematic_um: float
    seen: float


class BestPlaceOut(MapShareOut):
    """The best place of those that were judged."""

    position_mm: Vector3


class StationOptionOut(MapShareOut):
    """What so many stations leave, beside one place for as long."""

    count: int
    position_mm: list[Vector3]
    minutes: float
    one_place_as_long: MapShareOut
    pays: bool
    because: str | None


class StationAdviceOut(BaseModel):
    """What a number of stations is worth."""

    recommended: int
    statement: list[str]
    move_minutes: float
    judged: int
    best: BestPlaceOut
    worst: MapShareOut
    options: list[StationOptionOut]


class StationShareOut(MapUncertaintyOut):
    """Place and share of one station, and what is left after it."""

    position_mm: Vector3
    rows: int
    duration_s: float


class PredictedErrorOut(BaseModel):
    """Uncertainty of one error that is left."""

    uncertainty_um: float | None = None
    uncertainty_urad: float | None = None


class PredictedLagOut(BaseModel):
    """Uncertainty of the servo lag of an axis."""

    uncertainty_ms: float


class SetUpRemedyOut(MapUncertaintyOut):
    """The rows once more with the tracker set up otherwise, and what both leave."""

    change: Literal["second-place", "turned-base", "other-face"]
    position_mm: Vector3
    turn_deg: float = Field(description="Of the base, against where it stands before.")
    minutes: float = Field(description="More than the plan takes, set-up included.")
    removed_um_per_minute: float


class TrackerErrorsOut(BaseModel):
    """What the tracker may be off by leaves, and what takes most of it a minute."""

    random_um: float = Field(description="What a perfect tracker would leave.")
    systematic_um: float
    statement: list[str]
    remedies: list[SetUpRemedyOut]


class PredictedOut(MapUncertaintyOut):
    """What the plan leaves unknown."""

    errors: dict[str, PredictedErrorOut]
    effects: list[UpdatedEffectOut]
    servo_mismatch: dict[str, PredictedLagOut]
    tracker_errors: TrackerErrorsOut | None = Field(
        None, description="Null where the tracker is stated to be perfect."
    )


class PlannedTargetOut(MapUncertaintyOut):
    """The uncertainty that was asked for."""

    reached: bool


class CurveStepOut(MapUncertaintyOut):
    """The uncertainty after a row."""

    row: int
    time_s: float


class PlaceOut(BaseModel):
    """Where a plan has chosen the tracker to stand, and what further places bring."""

    tracker: PlannedPlaceOut
    stations: StationAdviceOut | None
    at_stations: list[StationShareOut] | None


class PlanDocumentOut(PlaceOut):
    """Content of `plan.json`, schema `plan/1`, with the grade of the set-up."""

    schema_: Literal["plan/1"] = Field(alias="schema")
    machine: MachineFileOut
    mode: Literal["otf", "standstill"]
    rows: int
    duration_s: float
    corner_path: bool
    perpendicular_only: bool
    feeds_mm_min: list[float]
    motion: PlannedMotionOut
    feed_choice: FeedChoiceOut | None
    model: UsedModelOut | None
    verdict: VerdictOut
    predicted: PredictedOut
    target: PlannedTargetOut | None
    curve: list[CurveStepOut]
    unobservable: list[str]
    grade: GradeOut
