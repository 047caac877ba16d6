"""Where the machine may go, with the tracker's view of the target on the way.

Keep-out boxes are in axis positions, like the protection zones of a control. Range and
line of sight are those of the measured target in the tracker's frame. All are checked
over the whole swept line (`line_of_sight`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.errors import PlanningError
from truepath.kinematics.conditions import Conditions, observe_targets
from truepath.kinematics.machine.machine import Machine, Target
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.motion.configurations import Commanded
from truepath.motion.workspace.line_of_sight import (
    Box,
    Reflector,
    angles_deg,
    compute_axis_coupling,
    cross_box,
    measure_distances,
    touch_beam,
)
from truepath_drivers.interfaces.arcs import trace
from truepath_drivers.interfaces.records import Path

MOVE_S = 600.0  # to carry a tracker, let it warm up, check known points
REPLAN = "plan other lines, or correct the workspace"


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
        """Mask of the allowed stations."""
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
        """Sets the tracker's position."""
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
    """True if a target moves relative to the tracker."""
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
