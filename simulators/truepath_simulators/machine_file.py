"""The nominal machine as in `machine.json` (machine/1)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from truepath_simulators.errors import SimulatorError

DIRECTIONS = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
ROTARY_DIRECTIONS = {
    "A": (1.0, 0.0, 0.0),
    "B": (0.0, 1.0, 0.0),
    "C": (0.0, 0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class LinearAxis:
    """A linear axis and its travel, mm."""

    name: str
    min_mm: float
    max_mm: float

    @property
    def low(self) -> float:
        return self.min_mm

    @property
    def high(self) -> float:
        return self.max_mm

    @property
    def zero_mm(self) -> float:
        """Position of zero errors: the axis zero, else the lowest position."""
        return _zero(self.min_mm, self.max_mm)


@dataclass(frozen=True, slots=True)
class RotaryAxis:
    """An axis that turns, right-handed, about a direction through a point."""

    name: str
    min_deg: float
    max_deg: float
    origin_mm: tuple[float, float, float]
    direction: tuple[float, float, float]

    @property
    def low(self) -> float:
        return self.min_deg

    @property
    def high(self) -> float:
        return self.max_deg

    @property
    def zero_deg(self) -> float:
        """Position of zero errors: the axis zero, else the lowest position."""
        return _zero(self.min_deg, self.max_deg)

    @property
    def turns_fully(self) -> bool:
        """Travel of at least 360°: its errors repeat."""
        return self.max_deg - self.min_deg >= 360.0 - 1e-9


Axis = LinearAxis | RotaryAxis


@dataclass(frozen=True, slots=True)
class Reflector:
    """A target of the tracker, on the tool or on the workpiece."""

    name: str
    on: str
    offset_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class TrackerFigures:
    """Standard deviations of one sample, the rate, and where the tracker stands.

    specification : standard deviations from which its systematic errors are sampled
    face : in which it measures; in the second its head points over its back
    """

    range_sigma_um: float = 1.0
    range_ppm: float = 0.3
    angle_sigma_urad: float = 3.0
    transverse_sigma_um: float = 4.0
    rate_hz: float = 500.0
    stands_on: str = "workpiece"
    specification: Mapping[str, float] = field(default_factory=dict)
    face: int = 1


@dataclass(frozen=True, slots=True)
class MachineFile:
    """A nominal machine. Positions are columns in the order X, Y, Z, then A, B, C.

    workpiece_side, tool_side : axes in chain order, from `w` to `b` and from `b` to `t`
    """

    name: str
    workpiece_side: tuple[str, ...]
    tool_side: tuple[str, ...]
    axes: tuple[Axis, ...]
    reflectors: tuple[Reflector, ...]
    tracker: TrackerFigures

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Axes in column order."""
        return tuple(axis.name for axis in self.axes)

    @property
    def linear_axes(self) -> tuple[LinearAxis, ...]:
        """X, Y, Z, as far as they exist."""
        return tuple(axis for axis in self.axes if isinstance(axis, LinearAxis))

    @property
    def rotary_axes(self) -> tuple[RotaryAxis, ...]:
        """A, B, C, as far as they exist."""
        return tuple(axis for axis in self.axes if isinstance(axis, RotaryAxis))

    @property
    def low_mm(self) -> np.ndarray:
        return np.array([axis.min_mm for axis in self.linear_axes])

    @property
    def high_mm(self) -> np.ndarray:
        return np.array([axis.max_mm for axis in self.linear_axes])

    @property
    def low(self) -> np.ndarray:
        """Lowest position of each axis, mm or deg."""
        return np.array([axis.low for axis in self.axes])

    @property
    def high(self) -> np.ndarray:
        """Highest position of each axis, mm or deg."""
        return np.array([axis.high for axis in self.axes])

    def reflector(self, name: str = "") -> Reflector:
        """The first if no name is given. Raises SimulatorError if there is none."""
        for reflector in self.reflectors:
            if name in ("", reflector.name):
                return reflector
        raise SimulatorError(f"machine {self.name!r} has no target {name!r}")


def parse_machine(content: Mapping[str, Any]) -> MachineFile:
    """Raises SimulatorError naming the invalid key."""
    if content.get("schema") != "machine/1":
        raise SimulatorError(
            f"schema: expected 'machine/1', got {content.get('schema')!r}"
        )
    try:
        workpiece_side, tool_side = _chain(content["kinematic_chain"])
        axes = _axes(content["axes"], workpiece_side + tool_side)
        return MachineFile(
            name=str(content.get("name", "machine")),
            workpiece_side=workpiece_side,
            tool_side=tool_side,
            axes=axes,
            reflectors=_reflectors(content),
            tracker=TrackerFigures(**content.get("tracker", {})),
        )
    except KeyError as error:
        raise SimulatorError(f"{error.args[0]}: missing") from error
    except TypeError as error:
        raise SimulatorError(f"tracker: {error}") from error


def _chain(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    links = text.split("-")
    if links.count("b") != 1 or links[0] != "w" or links[-1] != "t":
        raise SimulatorError(f"kinematic_chain: {text!r} is not of the form w-…-b-…-t")
    base = links.index("b")
    return tuple(links[1:base]), tuple(links[base + 1 : -1])


def _axes(
    content: Mapping[str, Mapping[str, Any]], order: tuple[str, ...]
) -> tuple[Axis, ...]:
    if sorted(order) != sorted(content):
        raise SimulatorError(
            f"axes: {sorted(content)} are not those of the chain, {sorted(order)}"
        )
    unknown = set(order) - set(DIRECTIONS) - set(ROTARY_DIRECTIONS)
    if unknown or not set(DIRECTIONS) <= set(order):
        raise SimulatorError(
            f"axes: X, Y, Z and any of A, B, C are simulated, not {order}"
        )
    rotary = [name for name in ROTARY_DIRECTIONS if name in content]
    return (
        *(_linear_axis(name, content[name]) for name in DIRECTIONS),
        *(_rotary_axis(name, content[name]) for name in rotary),
    )


def _linear_axis(name: str, content: Mapping[str, Any]) -> LinearAxis:
    if content.get("type") != "linear":
        raise SimulatorError(f"axes.{name}.type: expected 'linear'")
    axis = LinearAxis(name, float(content["min_mm"]), float(content["max_mm"]))
    if not axis.min_mm < axis.max_mm:
        raise SimulatorError(f"axes.{name}: min_mm is not below max_mm")
    return axis


def _rotary_axis(name: str, content: Mapping[str, Any]) -> RotaryAxis:
    if content.get("type") != "rotary":
        raise SimulatorError(f"axes.{name}.type: expected 'rotary'")
    direction = np.array(_vector(content.get("direction", ROTARY_DIRECTIONS[name])))
    length = float(np.linalg.norm(direction))
    low, high = float(content["min_deg"]), float(content["max_deg"])
    if length == 0.0 or not low < high:
        raise SimulatorError(f"axes.{name}: no direction, or min_deg not below max_deg")
    return RotaryAxis(
        name,
        low,
        high,
        _vector(content.get("origin_mm", (0.0, 0.0, 0.0))),
        _vector(direction / length),
    )


def _zero(low: float, high: float) -> float:
    return 0.0 if low <= 0.0 <= high else low


def _reflectors(content: Mapping[str, Any]) -> tuple[Reflector, ...]:
    if "targets" not in content:
        return (Reflector("", "tool", _vector(content["tool_offset_mm"])),)
    return tuple(
        Reflector(name, str(target["on"]), _vector(target["offset_mm"]))
        for name, target in content["targets"].items()
    )


def _vector(values: Iterable[float]) -> tuple[float, float, float]:
    coordinates = [float(value) for value in values]
    if len(coordinates) != 3:
        raise SimulatorError(f"a vector has three coordinates, not {coordinates}")
    x, y, z = coordinates
    return (x, y, z)


BUNDLED: Traversable = resources.files("truepath_simulators") / "scenarios"


def list_machines() -> tuple[str, ...]:
    """Names of the machines that are bundled with the simulators."""
    return tuple(
        sorted(
            entry.name.removesuffix(".json")
            for entry in BUNDLED.iterdir()
            if entry.name.endswith(".json")
        )
    )


def load_machine(name: str | Path) -> dict[str, Any]:
    """Content of a bundled machine or of a machine.json.

    Raises SimulatorError naming the file, or the bundled machines.
    """
    if str(name) in list_machines():
        return json.loads((BUNDLED / f"{name}.json").read_text(encoding="utf-8"))
    try:
        content = json.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        known = ", ".join(list_machines())
        raise SimulatorError(
            f"{name}: {error.strerror}; a path to a machine.json, or one of {known}"
        ) from error
    except ValueError as error:
        raise SimulatorError(f"{name}: not JSON: {error}") from error
    if not isinstance(content, dict):
        raise SimulatorError(f"{name}: not a JSON object")
    return content
