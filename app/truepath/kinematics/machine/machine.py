"""The machine as in `machine.json`: chain, axes, targets, tracker noise.

A rotary axis on the workpiece side turns the workpiece by its angle, so seen from the
workpiece all else turns back; one on the tool side turns the tool.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.machine.symbols import TURNS
from truepath.kinematics.machine.tracker_noise import TrackerNoise

SAME_TARGET_MM = 1e-6  # rounding
SEAT_SIGMA_MM = 1.0  # where the uncertainty of a target's position is not stated


@dataclass(frozen=True, slots=True)
class LinearAxis:
    """Travel from low to high, mm."""

    name: str
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class RotaryAxis:
    """A rotary axis: travel, a point on its axis and its direction (right-handed).

    low, high : ends of the travel, deg
    """

    name: str
    low: float
    high: float
    origin_mm: tuple[float, float, float]
    direction: tuple[float, float, float]

    @property
    def turns_fully(self) -> bool:
        """Travel of at least 360°: its errors repeat."""
        return self.high - self.low >= 360.0 - 1e-9


Axis = LinearAxis | RotaryAxis


def position_unit(axis: Axis) -> str:
    """`mm`, or `deg` for a rotary axis."""
    return "deg" if isinstance(axis, RotaryAxis) else "mm"


@dataclass(frozen=True, slots=True)
class Target:
    """A reflector and the side that carries it: `tool` or `workpiece`.

    seat_sigma_mm : standard uncertainty of each coordinate
    """

    name: str
    on: str
    offset_mm: tuple[float, float, float]
    seat_sigma_mm: float = SEAT_SIGMA_MM


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of motion along a line.

    assumed : names of those not stated, which have typical values
    """

    max_feed_mm_min: float = 10_000.0
    acceleration_mm_s2: float = 1000.0
    jerk_mm_s3: float = float("inf")
    assumed: tuple[str, ...] = ("max_feed_mm_min", "acceleration_mm_s2", "jerk_mm_s3")


@dataclass(frozen=True, slots=True)
class Approach:
    """Path of an NC program to its first row: one axis after another.

    clearance_mm : linear axes that move first, and their positions; None is Z to near
        the upper end of its travel
    order : in which all axes then move to the row; empty is that of the machine, those
        of the clearance last
    """

    clearance_mm: tuple[tuple[str, float], ...] | None = None
    order: tuple[str, ...] = ()
    feed_mm_min: float = 2000.0


@dataclass(frozen=True, slots=True)
class Machine:
    """Nominal machine. The chain runs from workpiece to tool around the base `b`.

    workpiece_side : axes that move the workpiece, in chain order from `w` to `b`
    tool_side : axes that move the tool, in chain order from `b` to `t`
    altitude_m : of its site; None where it is not stated
    """

    name: str
    workpiece_side: tuple[str, ...]
    tool_side: tuple[str, ...]
    axes: tuple[Axis, ...]
    targets: tuple[Target, ...]
    tracker: TrackerNoise
    motion: MotionLimits = MotionLimits()
    altitude_m: float | None = None
    approach: Approach = Approach()

    @property
    def chain(self) -> str:
        """Kinematic chain in the notation of ISO 10791-6, `w-…-b-…-t`."""
        return "-".join(["w", *self.workpiece_side, "b", *self.tool_side, "t"])

    @property
    def order(self) -> tuple[str, ...]:
        """Axes from workpiece to tool."""
        return self.workpiece_side + self.tool_side

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Axes in the order of position columns: X, Y, Z, then A, B, C."""
        return tuple(axis.name for axis in self.axes)

    @property
    def linear_axes(self) -> tuple[LinearAxis, ...]:
        """X, Y, Z as far as they exist, in column order."""
        return tuple(a for a in self.axes if isinstance(a, LinearAxis))

    @property
    def rotary_axes(self) -> tuple[RotaryAxis, ...]:
        """A, B, C as far as they exist, in column order."""
        return tuple(a for a in self.axes if isinstance(a, RotaryAxis))

    @property
    def travel(
        self,
    ) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]]:
        """Lowest and highest positions of all axes, in column order."""
        low, high = np.array([(axis.low, axis.high) for axis in self.axes]).T
        return low, high

    def axis(self, name: str) -> Axis:
        """Raises KeyError if there is none."""
        return _find_named(self.axes, name)

    def rotary(self, name: str) -> RotaryAxis:
        """Raises KeyError if it is not a rotary axis."""
        return _find_named(self.rotary_axes, name)

    def linear(self, name: str) -> LinearAxis:
        """Raises KeyError if it is not a linear axis."""
        return _find_named(self.linear_axes, name)

    def target(self, name: str = "") -> Target:
        """The first if no name is given. Raises KeyError if there is none."""
        if self.targets and not name:
            return self.targets[0]
        return _find_named(self.targets, name)


Named = TypeVar("Named", bound=Axis | Target)


def _find_named(things: tuple[Named, ...], name: str) -> Named:
    for thing in things:
        if thing.name == name:
            return thing
    raise KeyError(name)


def remove_rotary_axes(machine: Machine) -> Machine:
    """For measurements during which the rotary axes stand still."""
    names = {axis.name for axis in machine.linear_axes}
    return replace(
        machine,
        axes=machine.linear_axes,
        workpiece_side=tuple(n for n in machine.workpiece_side if n in names),
        tool_side=tuple(n for n in machine.tool_side if n in names),
    )


def compute_turns(
    axis: RotaryAxis, angle_rad: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "n 3 3"]:
    """Right-handed turns about the direction of the axis (Rodrigues), (n, 3, 3)."""
    K = _across(np.array(axis.direction))
    sine, cosine = np.sin(angle_rad)[:, None, None], np.cos(angle_rad)[:, None, None]
    return np.eye(3) + sine * K + (1.0 - cosine) * (K @ K)


@lru_cache(maxsize=64)
def compute_local_directions(axis: RotaryAxis) -> Float64[np.ndarray, "3 3"]:
    """Directions of X, Y, Z in the symbols of the axis, as columns.

    They are those of the machine, turned the shortest way that brings the letter's own
    direction (A: X, B: Y, C: Z) onto the direction of the axis.
    """
    own = np.eye(3)[TURNS.index(axis.name)]
    direction = np.array(axis.direction)
    cosine = float(own @ direction)
    if cosine < -1.0 + 1e-12:  # half a turn, about the next direction
        other = np.eye(3)[(TURNS.index(axis.name) + 1) % 3]
        return 2.0 * np.outer(other, other) - np.eye(3)
    K = _across(np.cross(own, direction))
    return np.eye(3) + K + K @ K / (1.0 + cosine)


def _across(v: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """K with K p = v × p."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
