"""A machine, as in `machine.json`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from truepath.service.api.models.tables import Vector3


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
