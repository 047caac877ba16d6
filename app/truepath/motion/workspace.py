"""Where the machine may go, with the tracker's view of the target on the way.

Keep-out boxes are in axis positions, like the protection zones of a control. Range and
line of sight are those of the measured target in the tracker's frame. All are checked
over the whole swept line.

A straight line in axis positions is compared with boxes, the triangle that the beam
sweeps with obstacles. That is exact where the box is at rest or is carried by the tool;
a box carried by another axis is enlarged by its motion in a sixteenth of the line.

Straight lines in axis positions never leave the travel if both of their ends are in it,
so checking the rows checks the whole swept path; arcs are checked at their extreme
points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.errors import OutOfTravel, PlanningError
from truepath.kinematics.conditions import Conditions, observe_targets
from truepath.kinematics.machine.machine import (
    Axis,
    Machine,
    RotaryAxis,
    Target,
    position_unit,
)
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.motion.configurations import Commanded
from truepath_drivers.interfaces.arcs import find_reach, trace
from truepath_drivers.interfaces.records import Path

MOVE_S = 600.0  # to carry a tracker, let it warm up, check known points
REPLAN = "plan other lines, or correct the workspace"
# Rows are written with three or four decimals: a limit may be overrun by the rounding.
ROUNDING = 1e-3
DECIMALS = 4  # of mm and deg: rows survive a CSV file and a controller's counts
_PARTS = 8  # of a line, where beam and box both move


@dataclass(frozen=True, slots=True)
class Box:
    """A closed box.

    low_mm, high_mm : in X, Y, Z; name : for people
    carried_by : axis whose carriage it moves with, or `base`, given at the axis zeros;
        if empty, it is at rest relative to the tracker
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    name: str = ""
    carried_by: str = ""


@dataclass(frozen=True, slots=True)
class Reflector:
    """Direction of a reflector in the tool frame, and its acceptance angle."""

    direction: tuple[float, float, float]
    half_angle_deg: float


@dataclass(frozen=True, slots=True)
class StationAreas:
    """Allowed stations of the tracker, in the frame that it is mounted on.

    keep_out : boxes without stations
    move_s : time of a move to another station
    specification : of the tracker's systematic errors; None if unknown
    """

    areas: tuple[Box, ...]
    keep_out: tuple[Box, ...] = ()
    move_s: float = MOVE_S
    specification: TrackerSpecification | None = None

    def find_specification(self, machine: Machine) -> TrackerSpecification:
        """Specification of the machine file, else this one, else a typical one."""
        stated = machine.tracker.specification
        return stated or self.specification or machine.tracker.systematic

    def allow(self, place_mm: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        inside = [cross_box(place_mm, place_mm, box) for box in self.areas]
        out = [cross_box(place_mm, place_mm, box) for box in self.keep_out]
        return np.any(inside, axis=0) & ~np.any([*out, np.zeros(len(place_mm))], axis=0)


@dataclass(frozen=True, slots=True)
class Workspace:
    """Limits of a plan in addition to the travel.

    keep_out : boxes of axis positions X, Y, Z that no motion may touch
    tracker_mm : tracker's position in the frame that it is mounted on; None if unknown
    nearest_mm, farthest_mm : range of the tracker
    blocks_sight : boxes in the same frame that the beam must not touch
    reflector : of the measured target; None for one that accepts every direction
    stations : allowed stations of the tracker; None if not given
    """

    keep_out: tuple[Box, ...] = ()
    tracker_mm: tuple[float, float, float] | None = None
    nearest_mm: float = 0.0
    farthest_mm: float = np.inf
    blocks_sight: tuple[Box, ...] = ()
    reflector: Reflector | None = None
    stations: StationAreas | None = None

    def place_tracker(self, place_mm: Float64[np.ndarray, "3"]) -> Workspace:
        x, y, z = (float(v) for v in place_mm)
        return replace(self, tracker_mm=(x, y, z))

    def allows(
        self,
        machine: Machine,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
    ) -> Bool[np.ndarray, " n"]:
        """Mask of the straight lines inside the workspace from begin to end.

        Linear axes only.
        """
        ok = np.ones(len(begin), bool)
        for breaks, _ in self._check_rules(machine, begin, end):
            ok &= ~breaks
        return ok

    def require_allowed(
        self, machine: Machine, commanded: Commanded, remedy: str = REPLAN
    ) -> None:
        """Raise PlanningError if a motion is not allowed; names row and reason.

        Rows are counted from 1; a single row is a standstill.
        """
        position, row = commanded.position, np.arange(len(commanded))
        if isinstance(commanded, Path):
            position, row = trace(commanded)
        begin = position[:-1] if len(position) > 1 else position
        end = position[1:] if len(position) > 1 else position
        bad = ~self.allows(machine, begin, end)
        if bad.any():
            index = int(np.argmax(bad))
            way = f"the way to row {row[index + (len(position) > 1)] + 1}"
            self.reject_way(machine, begin[index], end[index], way, remedy)

    def reject_way(
        self,
        machine: Machine,
        begin: Float64[np.ndarray, " a"],
        end: Float64[np.ndarray, " a"],
        name: str,
        remedy: str,
    ) -> None:
        """Raise PlanningError if a straight motion is not allowed, with reason."""
        for breaks, reason in self._check_rules(machine, begin[None], end[None]):
            if breaks[0]:
                raise PlanningError(f"{name} {reason}; {remedy}")

    @property
    def without_sight(self) -> Workspace:
        """Only the keep-out boxes: the beam may be lost on the way."""
        return replace(self, tracker_mm=None)

    def _check_rules(
        self,
        machine: Machine,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
    ) -> Iterator[tuple[Bool[np.ndarray, " n"], str]]:
        for box in self.keep_out:
            touched = cross_box(begin[:, :3], end[:, :3], box)
            yield touched, f"enters the keep-out box {_name_box(box)}"
        if self.tracker_mm is None:
            return
        tracker = np.array(self.tracker_mm)
        first, last = _observe(machine, begin), _observe(machine, end)
        yield from self._check_range(tracker, first, last)
        for box in self.blocks_sight:
            share = compute_axis_coupling(machine, box.carried_by)
            moved = begin @ share, end @ share
            behind = touch_beam(
                (tracker - moved[0], tracker - moved[1]),
                (first.point_mm - moved[0], last.point_mm - moved[1]),
                box,
            )
            yield behind, f"goes behind {_name_box(box)}, out of the tracker's sight"
        if self.reflector is not None:
            # What a reflector accepts is a cone: both ends in it, all between in it.
            turned = [angles_deg(self.reflector, at, tracker) for at in (first, last)]
            angle = np.maximum(*turned)
            yield (
                angle > self.reflector.half_angle_deg,
                f"turns the reflector {angle.max(initial=0.0):.0f}° away from the "
                "tracker, farther than it reflects",
            )

    def _check_range(
        self, tracker: Float64[np.ndarray, "3"], first: Conditions, last: Conditions
    ) -> Iterator[tuple[Bool[np.ndarray, " n"], str]]:
        near, far = measure_distances(tracker, first.point_mm, last.point_mm)
        least, most = near.min(initial=np.inf), far.max(initial=0.0)
        yield (
            near < self.nearest_mm,
            f"brings the target to {least:.0f} mm, nearer than the tracker sees",
        )
        yield (
            far > self.farthest_mm,
            f"takes the target {most:.0f} mm away, farther than the tracker sees",
        )


def moves_relative_to_tracker(machine: Machine, target: Target) -> bool:
    from_base = machine.tracker.stands_on == "base"
    if target.on == "workpiece":
        return from_base and bool(machine.workpiece_side)
    return bool(machine.tool_side) or not from_base


def moving_targets(machine: Machine) -> tuple[Target, ...]:
    """Targets that move relative to the tracker, in the machine's order.

    Raises PlanningError if there is none.
    """
    targets = tuple(t for t in machine.targets if moves_relative_to_tracker(machine, t))
    if not targets:
        raise PlanningError(
            f"no target of {machine.name} moves where the tracker stands; "
            "state one on the tool in machine.json"
        )
    return targets


def _name_box(box: Box) -> str:
    return box.name or f"{list(box.low_mm)} to {list(box.high_mm)} mm"


def _observe(machine: Machine, position: Float64[np.ndarray, "n a"]) -> Conditions:
    return observe_targets(machine, position, [machine.target()])


def angles_deg(
    reflector: Reflector, at: Conditions, tracker_mm: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " n"]:
    """Angles between the reflector's direction and the tracker."""
    frame = at.chain.tool_frame + at.chain.workpiece_frame
    looks = frame @ np.array(reflector.direction)
    beam = tracker_mm - at.point_mm
    size = np.linalg.norm(beam, axis=1) * np.linalg.norm(looks, axis=1)
    cosine = np.einsum("ni,ni->n", looks, beam) / np.maximum(size, 1e-12)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def compute_axis_coupling(machine: Machine, carrier: str) -> Float64[np.ndarray, "a 3"]:
    """Displacement of a body in the tracker's frame, per unit of each axis.

    carrier : axis whose carriage carries it, or `base`; empty for a body at rest
    """
    before, after = machine.workpiece_side, machine.tool_side
    if carrier in before:
        cut = before.index(carrier)
        before, after = before[:cut], ()
        pulled = machine.workpiece_side[cut:]
    else:
        after = after[: after.index(carrier) + 1] if carrier in after else ()
        pulled = ()
    from_base = machine.tracker.stands_on == "base"
    moves = dict.fromkeys(after, 1.0)
    moves |= dict.fromkeys(pulled, -1.0) if from_base else dict.fromkeys(before, 1.0)
    share = np.zeros((len(machine.axes), 3))
    for column, axis in enumerate(machine.axes):
        if carrier and axis.name in "XYZ":
            share[column, "XYZ".index(axis.name)] = moves.get(axis.name, 0.0)
    return share


def cross_box(
    begin: Float64[np.ndarray, "n 3"], end: Float64[np.ndarray, "n 3"], box: Box
) -> Bool[np.ndarray, " n"]:
    """Mask of the segments that touch a box: slabs, one coordinate after another."""
    low, high = np.array(box.low_mm), np.array(box.high_mm)
    step = end - begin
    still = step == 0.0
    rate = np.where(still, 1.0, step)
    first, last = (low - begin) / rate, (high - begin) / rate
    enters, leaves = np.minimum(first, last), np.maximum(first, last)
    inside = (begin >= low) & (begin <= high)
    enters = np.where(still, np.where(inside, -np.inf, np.inf), enters)
    leaves = np.where(still, np.where(inside, np.inf, -np.inf), leaves)
    latest = np.maximum(enters.max(axis=1), 0.0)
    return latest <= np.minimum(leaves.min(axis=1), 1.0)


def measure_distances(
    place: Float64[np.ndarray, "3"],
    begin: Float64[np.ndarray, "n 3"],
    end: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Least and largest distance of each segment from a point."""
    step, off = end - begin, place - begin
    square = np.maximum(np.einsum("ni,ni->n", step, step), 1e-12)
    share = np.clip(np.einsum("ni,ni->n", off, step) / square, 0.0, 1.0)
    near = np.linalg.norm(off - share[:, None] * step, axis=1)
    ends = [np.linalg.norm(place - p, axis=1) for p in (begin, end)]
    return near, np.maximum(ends[0], ends[1])


def touch_beam(
    tracker: tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]],
    target: tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]],
    box: Box,
) -> Bool[np.ndarray, " n"]:
    """Mask of the beams that touch a box on the way, seen from the box.

    Of tracker and target the one that moves less is taken as fixed in the middle of its
    motion, and the box as larger by half of that motion.
    """
    ends = [np.stack(pair) for pair in (tracker, target)]
    ways = [np.linalg.norm(end[1] - end[0], axis=1) for end in ends]
    calm, swept = ends if ways[0].sum() <= ways[1].sum() else ends[::-1]
    parts = 1 if min(way.sum() for way in ways) == 0.0 else _PARTS
    half_mm = np.linalg.norm(calm[1] - calm[0], axis=1) / (2.0 * parts)
    touches = np.zeros(len(half_mm), bool)
    for part in range(parts):
        begin, middle, end = (part + np.array([0.0, 0.5, 1.0])) / parts
        apex = calm[0] + middle * (calm[1] - calm[0])
        a, b = (swept[0] + t * (swept[1] - swept[0]) for t in (begin, end))
        touches |= _triangle_touches(apex, a, b, box, half_mm)
    return touches


def _triangle_touches(
    a: Float64[np.ndarray, "n 3"],
    b: Float64[np.ndarray, "n 3"],
    c: Float64[np.ndarray, "n 3"],
    box: Box,
    margin_mm: Float64[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Separating axes, Akenine-Möller 2001. margin_mm : enlargement of the box"""
    low, high = np.array(box.low_mm), np.array(box.high_mm)
    half = (high - low) / 2.0
    corners = np.stack([a, b, c], axis=1) - (low + high) / 2.0
    edges = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(edges[:, 0], edges[:, 1])
    unit = np.broadcast_to(np.eye(3), (len(a), 3, 3))
    across = np.cross(edges[:, :, None], np.eye(3)).reshape(len(a), 9, 3)
    axes = np.concatenate([unit, normal[:, None], across], axis=1)
    reach = np.abs(axes) @ half
    reach += np.linalg.norm(axes, axis=2) * margin_mm[:, None]
    shadow = axes @ np.swapaxes(corners, 1, 2)
    apart = (shadow.min(axis=2) > reach) | (shadow.max(axis=2) < -reach)
    return ~apart.any(axis=1)


@dataclass(frozen=True, slots=True)
class Breach:
    """A commanded position beyond the travel of an axis.

    index : row of the commanded positions, from 0
    """

    index: int
    axis: Axis
    value: float

    def __str__(self) -> str:
        axis, unit = self.axis, position_unit(self.axis)
        above = self.value > axis.high
        side, limit = ("exceeds", axis.high) if above else ("is below", axis.low)
        return f"{axis.name} = {self.value:.4g} {unit} {side} {limit:.4g} {unit}"


def first_breach(machine: Machine, commanded: Commanded) -> Breach | None:
    """The first row beyond the travel, or None. Every axis must be known."""
    by_name = {axis.name: axis for axis in machine.axes}
    axes = [by_name[name] for name in commanded.axes]
    low, high = np.array([(axis.low, axis.high) for axis in axes]).T
    position, rows = commanded.position, np.arange(len(commanded))
    if isinstance(commanded, Path):
        position, rows = find_reach(commanded)
    outside = (position < low - ROUNDING) | (position > high + ROUNDING)
    if not outside.any():
        return None
    place, column = (int(i) for i in np.argwhere(outside)[0])
    return Breach(int(rows[place]), axes[column], float(position[place, column]))


def inner_travel(
    machine: Machine,
) -> tuple[Float64[np.ndarray, " a"], Float64[np.ndarray, " a"]]:
    """Travel of all axes less a margin at both ends, mm or deg.

    The margin is 10, or 2 % of a short travel. Rounded as rows are written. A full turn
    has no ends, and so no margin.
    """
    low, high = machine.travel
    is_round = [
        isinstance(axis, RotaryAxis) and axis.turns_fully for axis in machine.axes
    ]
    margin = np.minimum(10.0, 0.02 * (high - low))
    margin = np.where(is_round, 0.0, margin)
    return np.round(low + margin, DECIMALS), np.round(high - margin, DECIMALS)


def add_resting_axes(
    machine: Machine, moved: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "n b"]:
    """Adds columns for the last axes, which do not move.

    They are at 0, or at the near end of their travel.
    """
    resting = machine.axes[moved.shape[1] :]
    rest = [min(max(0.0, axis.low), axis.high) for axis in resting]
    return np.hstack([moved, np.tile(rest, (len(moved), 1))])


def check_travel(machine: Machine, commanded: Commanded) -> None:
    """Raise OutOfTravel if a row is beyond the travel or moves an unknown axis.

    Rows are counted from 1. To be called before a plan reaches the machine.
    """
    for name in commanded.axes:
        if name not in machine.axis_names:
            raise OutOfTravel(
                f"the plan moves axis {name}, which {machine.name} does not have; "
                f"its axes are {', '.join(machine.axis_names)}"
            )
    if not np.isfinite(commanded.position).all():
        row, column = np.argwhere(~np.isfinite(commanded.position))[0]
        raise OutOfTravel(
            f"row {row + 1}: {commanded.axes[column]} is not a finite number; "
            "correct the row"
        )
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise OutOfTravel(
            f"row {breach.index + 1}: {breach}; "
            "shorten the plan or correct the travel in the machine file"
        )
