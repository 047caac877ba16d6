"""`machine.json` (schema `machine/1` of the file formats) to and from a `Machine`."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model, model_validator

from truepath.documents.file_model import (
    FileModel,
    Line,
    Text,
    Vector,
    encode_json,
    is_line,
    parse_json,
    quote,
    reject,
    validate,
)
from truepath.documents.whole_files import read_whole
from truepath.kinematics.machine.machine import (
    SEAT_SIGMA_MM,
    Approach,
    Axis,
    LinearAxis,
    Machine,
    MotionLimits,
    RotaryAxis,
    Target,
)
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.machine.tracker_specification import TrackerSpecification

SCHEMA = "machine/1"
_DIRECTIONS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}
_USUAL = TrackerNoise()

# Figures that no machine has are slips of unit or of the key.
_LARGEST = 1e6
_LEAST_TRAVEL = {"mm": 1.0, "deg": 0.01}

Mm = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
Deg = Annotated[float, Field(ge=-1e5, le=1e5)]
Positive = Annotated[float, Field(gt=0.0, le=_LARGEST)]
NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST)]
RateHz = Annotated[float, Field(gt=0.0, le=1e5)]


def _require_within(vector: Vector) -> Vector:
    for index, value in enumerate(vector):
        if abs(value) > _LARGEST:
            remedy = f"it must be within ±{_LARGEST:g}"
            raise reject(f"is {value:g}", remedy, index)
    return vector


Place = Annotated[Vector, AfterValidator(_require_within)]


class LinearAxisFile(FileModel):
    """A linear axis."""

    type: Literal["linear"]
    min_mm: Mm
    max_mm: Mm

    @model_validator(mode="after")
    def _require_travel(self) -> LinearAxisFile:
        _require_order("mm", self.min_mm, self.max_mm)
        return self

    def axis(self, name: str) -> LinearAxis:
        """With limits in mm."""
        return LinearAxis(name, self.min_mm, self.max_mm)


class RotaryAxisFile(FileModel):
    """A rotary axis; without a direction it turns about that of its name."""

    type: Literal["rotary"]
    min_deg: Deg
    max_deg: Deg
    origin_mm: Place = (0.0, 0.0, 0.0)
    direction: Place | None = None

    @model_validator(mode="after")
    def _require_travel_and_direction(self) -> RotaryAxisFile:
        _require_order("deg", self.min_deg, self.max_deg)
        if self.direction is not None and not any(self.direction):
            remedy = "write a direction of any length"
            raise reject("is [0, 0, 0]", remedy, "direction")
        return self

    def axis(self, name: str) -> RotaryAxis:
        """Its direction has length 1."""
        direction = self.direction or _DIRECTIONS[name]
        length = math.hypot(*direction)
        x, y, z = (component / length for component in direction)
        return RotaryAxis(name, self.min_deg, self.max_deg, self.origin_mm, (x, y, z))


class AxesFile(FileModel):
    """The axes by name, in the order in which a machine has them."""

    X: LinearAxisFile
    Y: LinearAxisFile
    Z: LinearAxisFile
    A: RotaryAxisFile | None = None
    B: RotaryAxisFile | None = None
    C: RotaryAxisFile | None = None

    @model_validator(mode="before")
    @classmethod
    def _reject_unknown(cls, content: object) -> object:
        for name in content if isinstance(content, dict) else ():
            if name not in cls.model_fields:
                known = "linear axes are X, Y, Z; rotary axes are A, B, C"
                raise reject("is an unknown axis", known, name)
        return content

    def axes(self) -> tuple[Axis, ...]:
        """In the order of the class."""
        stated = {name: getattr(self, name) for name in type(self).model_fields}
        return tuple(file.axis(name) for name, file in stated.items() if file)


class TargetFile(FileModel):
    """A target; how well its place is known."""

    on: Literal["tool", "workpiece"]
    offset_mm: Place
    seat_sigma_mm: Positive = SEAT_SIGMA_MM


_KEYS: dict[str, Any] = {
    one.name: (NotNegative, 0.0) for one in fields(TrackerSpecification)
}
_Keys = create_model("_Keys", __base__=FileModel, **_KEYS)


class SpecificationFile(_Keys):
    """What the tracker may be off by, standard uncertainties; 0 where left out."""

    @model_validator(mode="before")
    @classmethod
    def _reject_unknown(cls, content: object) -> object:
        for name in content if isinstance(content, dict) else ():
            if name not in cls.model_fields:
                known = f"known are {', '.join(cls.model_fields)}"
                raise reject("is an unknown error of a tracker", known, name)
        return content

    def specification(self) -> TrackerSpecification:
        """All in standard uncertainties."""
        return TrackerSpecification(**self.model_dump())


class TrackerFile(FileModel):
    """The tracker's noise, usual where it is not stated, and where it stands."""

    range_sigma_um: Positive = _USUAL.range_sigma_um
    range_ppm: NotNegative = _USUAL.range_ppm
    angle_sigma_urad: NotNegative = _USUAL.angle_sigma_urad
    transverse_sigma_um: NotNegative = _USUAL.transverse_sigma_um
    rate_hz: RateHz = _USUAL.rate_hz
    stands_on: Literal["workpiece", "base"] = "workpiece"
    specification: SpecificationFile | None = None
    face: Literal[1, 2] | None = None

    @model_validator(mode="after")
    def _require_noise_across(self) -> TrackerFile:
        if self.transverse_sigma_um == self.angle_sigma_urad == 0.0:
            problem = "and angle_sigma_urad are both 0"
            remedy = "state the noise across the beam"
            raise reject(problem, remedy, "transverse_sigma_um")
        return self

    def tracker(self) -> TrackerNoise:
        """Noise and station of the tracker."""
        stated = self.model_dump(exclude={"specification"})
        found = self.specification
        return TrackerNoise(
            **stated, specification=found.specification() if found else None
        )


class MotionFile(FileModel):
    """What the machine can; the usual is taken for what it does not state."""

    max_feed_mm_min: Annotated[float, Field(ge=10.0, le=1e6)] | None = None
    acceleration_mm_s2: Annotated[float, Field(ge=1.0, le=1e6)] | None = None
    jerk_mm_s3: Annotated[float, Field(ge=10.0, le=1e9)] | None = None

    def limits(self) -> MotionLimits:
        """Limits of motion, with the names of those assumed."""
        stated = {k: v for k, v in self.model_dump().items() if v is not None}
        assumed = tuple(name for name in type(self).model_fields if name not in stated)
        return MotionLimits(**stated, assumed=assumed)


class ApproachFile(FileModel):
    """How an NC program goes to its first row."""

    clearance_mm: dict[str, Mm] | None = None
    order: list[str] = Field(default_factory=list)
    feed_mm_min: Annotated[float, Field(ge=1.0, le=2e4)] = Approach().feed_mm_min

    def require_axes(self, axes: tuple[Axis, ...]) -> None:
        """Raise a refusal of what the axes cannot do."""
        linear = {axis.name: axis for axis in axes if isinstance(axis, LinearAxis)}
        for name, value in (self.clearance_mm or {}).items():
            place = "approach", "clearance_mm", name
            if name not in linear:
                raise reject("is no linear axis", "name X, Y or Z", *place)
            axis = linear[name]
            if not axis.low <= value <= axis.high:
                remedy = f"it must be from {axis.low:g} to {axis.high:g}"
                raise reject(f"is {value:g}", remedy, *place)
        names = [axis.name for axis in axes]
        if self.order and sorted(self.order) != sorted(names):
            remedy = f"name every axis once: {', '.join(names)}"
            raise reject(f"is {quote(self.order)}", remedy, "approach", "order")

    def approach(self) -> Approach:
        """Clearance in mm, as pairs of axis and position."""
        stated = self.clearance_mm
        clearance_mm = None if stated is None else tuple(stated.items())
        return Approach(clearance_mm, tuple(self.order), self.feed_mm_min)


class SiteFile(FileModel):
    """Where the machine stands; its altitude tells which pressures there can be."""

    altitude_m: Annotated[float, Field(ge=-450.0, le=6000.0)] | None = None


class MachineFile(FileModel):
    """A machine file."""

    schema_: Literal["machine/1"] = Field(alias="schema")
    name: Line = "machine"
    axes: AxesFile
    kinematic_chain: Text
    tool_offset_mm: Place | None = None
    targets: dict[str, TargetFile] | None = None
    tracker: TrackerFile = TrackerFile()
    motion: MotionFile | None = None
    approach: ApproachFile = ApproachFile()
    site: SiteFile = SiteFile()

    @model_validator(mode="before")
    @classmethod
    def _reject_two_kinds_of_targets(cls, content: object) -> object:
        if isinstance(content, dict) and {"targets", "tool_offset_mm"} <= set(content):
            raise reject(
                "stands beside targets", "keep one of the two", "tool_offset_mm"
            )
        return content

    @model_validator(mode="after")
    def _require_targets(self) -> MachineFile:
        if self.targets is None and self.tool_offset_mm is None:
            raise reject("is missing", "add it", "tool_offset_mm")
        if self.targets == {}:
            raise reject("is empty", "name at least one target", "targets")
        for name in self.targets or ():
            if not name.strip():
                raise reject("has no name", "name every target", "targets", name)
            if not is_line(name):
                problem = f"has the name {quote(name)}"
                raise reject(problem, "write a short line of printed text", "targets")
        return self

    @model_validator(mode="after")
    def _require_chain_of_axes(self) -> MachineFile:
        named = sorted(name for side in self.sides() for name in side)
        known = sorted(axis.name for axis in self.axes.axes())
        if named != known:
            raise reject(
                f"is {quote(self.kinematic_chain)} but the axes are {', '.join(known)}",
                "name every axis once",
                "kinematic_chain",
            )
        return self

    @model_validator(mode="after")
    def _require_approach_of_axes(self) -> MachineFile:
        self.approach.require_axes(self.axes.axes())
        return self

    def sides(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Axes of `w-…-b-…-t` on the side of the workpiece, and of the tool."""
        parts = self.kinematic_chain.split("-")
        if parts[0] != "w" or parts[-1] != "t" or parts.count("b") != 1:
            raise reject(
                f"is {quote(self.kinematic_chain)}",
                "write w-…-b-…-t, workpiece to tool, one base",
                "kinematic_chain",
            )
        base = parts.index("b")
        return tuple(parts[1:base]), tuple(parts[base + 1 : -1])

    def machine(self) -> Machine:
        """The target of `tool_offset_mm` has no name."""
        stated = (self.targets or {}).items()
        targets = tuple(
            Target(name, t.on, t.offset_mm, t.seat_sigma_mm) for name, t in stated
        )
        if self.tool_offset_mm is not None:
            targets = (Target("", "tool", self.tool_offset_mm),)
        noise = self.tracker.tracker()
        motion = (self.motion or MotionFile()).limits()
        axes = self.axes.axes()
        return Machine(
            self.name,
            *self.sides(),
            axes,
            targets,
            noise,
            motion,
            self.site.altitude_m,
            self.approach.approach(),
        )


def read_machine(path: str | Path) -> Machine:
    """Raises BundleError."""
    return decode_machine(read_whole(path), file=Path(path).name)


def decode_machine(data: bytes, *, file: str = "machine.json") -> Machine:
    """Raises BundleError."""
    return machine_from_json(parse_json(data, file), file=file)


def machine_from_json(content: object, *, file: str = "machine.json") -> Machine:
    """From parsed JSON. Raises BundleError."""
    return validate(MachineFile, content, file).machine()


def machine_to_json(machine: Machine) -> dict[str, Any]:
    """Content of `machine.json`; assumed limits of motion are left out."""
    noise, site = machine.tracker, machine.altitude_m
    return {
        "schema": SCHEMA,
        "name": machine.name,
        "kinematic_chain": machine.chain,
        "axes": {axis.name: _axis_json(axis) for axis in machine.axes},
        **_targets_json(machine.targets),
        "tracker": _tracker_json(noise),
        **_motion_json(machine.motion),
        **_approach_json(machine.approach),
        **({} if site is None else {"site": {"altitude_m": site}}),
    }


def _tracker_json(tracker: TrackerNoise) -> dict[str, Any]:
    return {key: value for key, value in asdict(tracker).items() if value is not None}


def encode_machine(machine: Machine) -> bytes:
    """Bytes of `machine.json`."""
    return encode_json(machine_to_json(machine), indent=1)


def _require_order(unit: str, low: float, high: float) -> None:
    least = _LEAST_TRAVEL[unit]
    if high - low < least:
        remedy = f"it must exceed min_{unit}, {low:g}, by {least:g} {unit} or more"
        raise reject(f"is {high:g}", remedy, f"max_{unit}")


def _axis_json(axis: Axis) -> dict[str, Any]:
    if isinstance(axis, LinearAxis):
        return {"type": "linear", "min_mm": axis.low, "max_mm": axis.high}
    return {
        "type": "rotary",
        "min_deg": axis.low,
        "max_deg": axis.high,
        "origin_mm": list(axis.origin_mm),
        "direction": list(axis.direction),
    }


def _motion_json(motion: MotionLimits) -> dict[str, Any]:
    names = [name for name in MotionFile.model_fields if name not in motion.assumed]
    return {"motion": {n: getattr(motion, n) for n in names}} if names else {}


def _approach_json(approach: Approach) -> dict[str, Any]:
    if approach == Approach():
        return {}
    stated = approach.clearance_mm
    clearance = {} if stated is None else {"clearance_mm": dict(stated)}
    rest = {"order": list(approach.order), "feed_mm_min": approach.feed_mm_min}
    return {"approach": {**clearance, **rest}}


def _targets_json(targets: tuple[Target, ...]) -> dict[str, Any]:
    if len(targets) == 1 and not targets[0].name and targets[0].on == "tool":
        return {"tool_offset_mm": list(targets[0].offset_mm)}
    return {"targets": {target.name: _target_json(target) for target in targets}}


def _target_json(target: Target) -> dict[str, Any]:
    content: dict[str, Any] = {"on": target.on, "offset_mm": list(target.offset_mm)}
    if target.seat_sigma_mm != SEAT_SIGMA_MM:
        content["seat_sigma_mm"] = target.seat_sigma_mm
    return content
