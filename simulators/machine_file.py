"""The nominal machine, as `machine.json` (machine/1) states it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulators.errors import SimulatorError

DIRECTIONS = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class LinearAxis:
    """A straight axis and its travel."""

    name: str
    min_mm: float
    max_mm: float

    @property
    def zero_mm(self) -> float:
        """Where its errors are zero: the axis zero, else the lowest position."""
        return 0.0 if self.min_mm <= 0.0 <= self.max_mm else self.min_mm


@dataclass(frozen=True, slots=True)
class Reflector:
    """A target the tracker can look at, on the tool or on the workpiece."""

    name: str
    on: str
    offset_mm: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class TrackerFigures:
    """One sample's standard deviations, the rate, and what the tracker stands on."""

    range_sigma_um: float = 1.0
    range_ppm: float = 0.3
    angle_sigma_urad: float = 3.0
    transverse_sigma_um: float = 4.0
    rate_hz: float = 500.0
    stands_on: str = "workpiece"


@dataclass(frozen=True, slots=True)
class MachineFile:
    """A nominal machine. Positions are columns in the order X, Y, Z.

    workpiece_side, tool_side : axes in chain order, from `w` to `b` and from `b` to `t`
    """

    name: str
    workpiece_side: tuple[str, ...]
    tool_side: tuple[str, ...]
    axes: tuple[LinearAxis, ...]
    reflectors: tuple[Reflector, ...]
    tracker: TrackerFigures

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Axes in column order."""
        return tuple(axis.name for axis in self.axes)

    @property
    def low_mm(self) -> np.ndarray:
        """Lowest position of each axis."""
        return np.array([axis.min_mm for axis in self.axes])

    @property
    def high_mm(self) -> np.ndarray:
        """Highest position of each axis."""
        return np.array([axis.max_mm for axis in self.axes])

    def reflector(self, name: str = "") -> Reflector:
        """Return a reflector by name, the first where none is named."""
        for reflector in self.reflectors:
            if name in ("", reflector.name):
                return reflector
        raise SimulatorError(f"machine {self.name!r} has no target {name!r}")


def parse_machine(content: Mapping[str, Any]) -> MachineFile:
    """Build a machine from machine.json; raises SimulatorError naming the key."""
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
) -> tuple[LinearAxis, ...]:
    if sorted(order) != sorted(content):
        raise SimulatorError(
            f"axes: {sorted(content)} are not those of the chain, {sorted(order)}"
        )
    if sorted(order) != sorted(DIRECTIONS):
        raise SimulatorError(
            f"axes: only machines of the linear axes X, Y, Z are simulated, not {order}"
        )
    return tuple(_linear_axis(name, content[name]) for name in DIRECTIONS)


def _linear_axis(name: str, content: Mapping[str, Any]) -> LinearAxis:
    if content.get("type") != "linear":
        raise SimulatorError(f"axes.{name}.type: only linear axes are simulated")
    axis = LinearAxis(name, float(content["min_mm"]), float(content["max_mm"]))
    if not axis.min_mm < axis.max_mm:
        raise SimulatorError(f"axes.{name}: min_mm is not below max_mm")
    return axis


def _reflectors(content: Mapping[str, Any]) -> tuple[Reflector, ...]:
    if "targets" not in content:
        return (Reflector("", "tool", _vector(content["tool_offset_mm"])),)
    return tuple(
        Reflector(name, str(target["on"]), _vector(target["offset_mm"]))
        for name, target in content["targets"].items()
    )


def _vector(values: list[float]) -> tuple[float, float, float]:
    if len(values) != 3:
        raise SimulatorError(f"an offset has three coordinates, not {values}")
    x, y, z = values
    return (float(x), float(y), float(z))
