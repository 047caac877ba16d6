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
from truepath.kinematics.machine.tracker_noise import TrackerNoise, TrackerSpecification

SCHEMA = "machine/1"
_DIRECTIONS = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}
_USUAL = TrackerNoise()

# Figures that no machine has are slips of unit or of the key.
_LARGEST = 1e6
_LEAST_TRAVEL = {"mm": 1.0, "deg": 0.01}

_AXIS = {"type": "linear", "min_mm": 0, "max_mm": 500}

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


def _reject_others(
    model: type[FileModel], content: object, problem: str, remedy: str
) -> object:
    for name in content if isinstance(content, dict) else ():
        if name not in model.model_fields:
            raise reject(problem, remedy, name)
    return content


Place = Annotated[Vector, AfterValidator(_require_within)]


class LinearAxisFile(FileModel):
    """A linear axis."""

    type: Literal["linear"] = Field(description="linear", examples=["linear"])
    min_mm: Mm = Field(description="Travel, in machine coordinates.", examples=[0])
    max_mm: Mm = Field(description="Highest position.", examples=[500])

    @model_validator(mode="after")
    def _require_travel(self) -> LinearAxisFile:
        _require_order("mm", self.min_mm, self.max_mm)
        return self

    def axis(self, name: str) -> LinearAxis:
        """With limits in mm."""
        return LinearAxis(name, self.min_mm, self.max_mm)


class RotaryAxisFile(FileModel):
    """A rotary axis; without a direction it turns about that of its name."""

    type: Literal["rotary"] = Field(description="rotary", examples=["rotary"])
    min_deg: Deg = Field(description="Travel; one of 360 is a full turn.", examples=[0])
    max_deg: Deg = Field(description="Highest position.", examples=[360])
    origin_mm: Place = Field(
        default=(0.0, 0.0, 0.0),
        description="A point that it turns about, linear axes at 0.",
    )
    direction: Place | None = Field(
        default=None,
        description="About which it turns right-handed while its position grows; of "
        "a table, the table itself. Left out, X of A, Y of B, Z of C.",
    )

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

    X: LinearAxisFile = Field(examples=[_AXIS])
    Y: LinearAxisFile = Field(examples=[_AXIS])
    Z: LinearAxisFile = Field(examples=[_AXIS])
    A: RotaryAxisFile | None = None
    B: RotaryAxisFile | None = None
    C: RotaryAxisFile | None = None

    @model_validator(mode="before")
    @classmethod
    def _reject_unknown(cls, content: object) -> object:
        known = "linear axes are X, Y, Z; rotary axes are A, B, C"
        return _reject_others(cls, content, "is an unknown axis", known)

    def axes(self) -> tuple[Axis, ...]:
        """In the order of the class."""
        stated = {name: getattr(self, name) for name in type(self).model_fields}
        return tuple(file.axis(name) for name, file in stated.items() if file)


class TargetFile(FileModel):
    """A target; how well its place is known."""

    on: Literal["tool", "workpiece"] = Field(
        description="tool, or workpiece: on the table."
    )
    offset_mm: Place = Field(
        description="As `tool_offset_mm`; on the table from the zero point of the "
        "machine. All axes at 0.",
        examples=[[20, 30, -150]],
    )
    seat_sigma_mm: Positive = Field(
        default=SEAT_SIGMA_MM, description="Standard uncertainty of each coordinate."
    )


_KEYS: dict[str, Any] = {
    one.name: (NotNegative, 0.0) for one in fields(TrackerSpecification)
}
_Keys = create_model("_Keys", __base__=FileModel, **_KEYS)


class SpecificationFile(_Keys):
    """What the tracker may be off by, standard uncertainties; 0 where left out."""

    @model_validator(mode="before")
    @classmethod
    def _reject_unknown(cls, content: object) -> object:
        known = f"known are {', '.join(cls.model_fields)}"
        return _reject_others(cls, content, "is an unknown error of a tracker", known)

    def specification(self) -> TrackerSpecification:
        """All in standard uncertainties."""
        return TrackerSpecification(**self.model_dump())


class TrackerFile(FileModel):
    """The tracker's noise, usual where it is not stated, and where it stands."""

    range_sigma_um: Positive = Field(
        default=_USUAL.range_sigma_um,
        description="Noise of one sample along the beam, 1 σ.",
    )
    range_ppm: NotNegative = Field(
        default=_USUAL.range_ppm, description="And so much more with the distance."
    )
    angle_sigma_urad: NotNegative = Field(
        default=_USUAL.angle_sigma_urad,
        description="Noise across the beam, by distance.",
    )
    transverse_sigma_um: NotNegative = Field(
        default=_USUAL.transverse_sigma_um,
        description="Noise across it at any distance.",
    )
    rate_hz: RateHz = Field(
        default=_USUAL.rate_hz, description="Samples, or shots of a polled tracker."
    )
    stands_on: Literal["workpiece", "base"] = Field(
        default="workpiece",
        description="workpiece: on the table; base: on floor or bed.",
    )
    specification: SpecificationFile | None = Field(
        default=None,
        description="What it may be off by; that of a typical one if left out.",
    )
    face: Literal[1, 2] | None = Field(
        default=None, description="In which it measures, if it has two."
    )

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

    max_feed_mm_min: Annotated[float, Field(ge=10.0, le=1e6)] | None = Field(
        default=None, description="Highest feed of a plan; 10 000 if left out."
    )
    acceleration_mm_s2: Annotated[float, Field(ge=1.0, le=1e6)] | None = Field(
        default=None, description="Along a line; 1000 if left out."
    )
    jerk_mm_s3: Annotated[float, Field(ge=10.0, le=1e9)] | None = Field(
        default=None, description="Along a line; unlimited if left out."
    )

    def limits(self) -> MotionLimits:
        """Limits of motion, with the names of those assumed."""
        stated = {k: v for k, v in self.model_dump().items() if v is not None}
        assumed = tuple(name for name in type(self).model_fields if name not in stated)
        return MotionLimits(**stated, assumed=assumed)


class ApproachFile(FileModel):
    """How an NC program goes to its first row."""

    clearance_mm: dict[str, Mm] | None = Field(
        default=None,
        description="Linear axes that go first, in this order, and where to; {} is "
        "none. Left out, Z to the upper end of its travel, less 10 mm or 2 %.",
    )
    order: list[str] = Field(
        default_factory=list,
        description="In which all axes then go to row 1. Left out, that of the "
        "machine, those of `clearance_mm` last, in reverse.",
    )
    feed_mm_min: Annotated[float, Field(ge=1.0, le=2e4)] = Field(
        default=Approach().feed_mm_min,
        description="Of rotary axes deg/min; no more than `max_feed_mm_min`.",
    )

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

    altitude_m: Annotated[float, Field(ge=-450.0, le=6000.0)] | None = Field(
        default=None, description="Above the sea."
    )


class MachineFile(FileModel):
    """A machine file."""

    schema_: Literal["machine/1"] = Field(
        alias="schema", description="Of this file.", examples=["machine/1"]
    )
    name: Line = Field(
        default="machine", description="By which Runs and results know the machine."
    )
    axes: AxesFile = Field(
        description="X, Y and Z; A, B and C where there are such.",
        examples=[{"X": _AXIS}],
    )
    kinematic_chain: Text = Field(
        description="w, axes that move the table, b for the bed, axes that move the "
        "tool, t.",
        examples=["w-X-b-Y-Z-t"],
    )
    tool_offset_mm: Place | None = Field(
        default=None,
        description="The reflector, from the point that the control shows.",
    )
    targets: dict[str, TargetFile] | None = Field(
        default=None, description="In place of `tool_offset_mm`: reflectors by name."
    )
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
            remedy = 'add it, as "tool_offset_mm": [20, 30, -150]'
            raise reject("is missing", remedy, "tool_offset_mm")
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
    site, motion = machine.altitude_m, machine.motion
    limits = [name for name in MotionFile.model_fields if name not in motion.assumed]
    return {
        "schema": SCHEMA,
        "name": machine.name,
        "kinematic_chain": machine.chain,
        "axes": {axis.name: _axis_json(axis) for axis in machine.axes},
        **_targets_json(machine.targets),
        "tracker": {k: v for k, v in asdict(machine.tracker).items() if v is not None},
        **({"motion": {n: getattr(motion, n) for n in limits}} if limits else {}),
        **_approach_json(machine.approach),
        **({} if site is None else {"site": {"altitude_m": site}}),
    }


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
    content: dict[str, dict[str, Any]] = {}
    for target in targets:
        one = {"on": target.on, "offset_mm": list(target.offset_mm)}
        if target.seat_sigma_mm != SEAT_SIGMA_MM:
            one["seat_sigma_mm"] = target.seat_sigma_mm
        content[target.name] = one
    return {"targets": content}
