"""Where the machine may go and what the tracker must see while it does.

Keep-out boxes are stated in axis positions, like the protection zones of a control.
Range and line of sight are those of the measured target where the tracker stands. All
are checked over the whole swept line, exactly: a straight line in axis positions
against boxes, the triangle that the beam sweeps against what blocks it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from app.errors import PlanningError
from app.kinematics.conditions import observe_targets
from app.kinematics.machine import Machine, Target
from app.motion.configurations import Commanded


@dataclass(frozen=True, slots=True)
class Box:
    """A closed box.

    low_mm, high_mm : in X, Y, Z; name : for people
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    name: str = ""


@dataclass(frozen=True, slots=True)
class Workspace:
    """What limits a plan beside the travel.

    keep_out : boxes of axis positions X, Y, Z that no motion may touch
    tracker_mm : place of the tracker in the frame that it stands on; None if unknown
    nearest_mm, farthest_mm : range of the tracker
    blocks_sight : boxes in the same frame that the beam must not touch
    """

    keep_out: tuple[Box, ...] = ()
    tracker_mm: tuple[float, float, float] | None = None
    nearest_mm: float = 0.0
    farthest_mm: float = np.inf
    blocks_sight: tuple[Box, ...] = ()

    def allows(
        self,
        machine: Machine,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
    ) -> Bool[np.ndarray, " n"]:
        """Tell which straight lines keep to it from begin to end. Linear axes only."""
        ok = np.ones(len(begin), bool)
        for breaks, _ in self._check_rules(machine, begin, end):
            ok &= ~breaks
        return ok

    def refuse(self, machine: Machine, commanded: Commanded) -> None:
        """Raise PlanningError if a motion of the plan breaks it; names row and reason.

        Rows are counted from 1; a single row is a place to stand at.
        """
        position = commanded.position
        begin = position[:-1] if len(position) > 1 else position
        end = position[1:] if len(position) > 1 else position
        bad = ~self.allows(machine, begin, end)
        if bad.any():
            index = int(np.argmax(bad))
            rules = self._check_rules(machine, begin[index, None], end[index, None])
            reason = next(reason for breaks, reason in rules if breaks[0])
            raise PlanningError(
                f"the way to row {index + 1 + (len(position) > 1)} {reason}; plan "
                "other lines, or correct the workspace"
            )

    def _check_rules(
        self,
        machine: Machine,
        begin: Float64[np.ndarray, "n a"],
        end: Float64[np.ndarray, "n a"],
    ) -> Iterator[tuple[Bool[np.ndarray, " n"], str]]:
        """Yield which lines break a rule, and what one that does so does."""
        for box in self.keep_out:
            name = _name_box(box)
            yield (
                _crosses(begin[:, :3], end[:, :3], box),
                f"enters the keep-out box {name}",
            )
        if self.tracker_mm is None:
            return
        a, b = _target_mm(machine, begin), _target_mm(machine, end)
        tracker = np.array(self.tracker_mm)
        near, far = _distances(tracker, a, b)
        least, most = near.min(initial=np.inf), far.max(initial=0.0)
        yield (
            near < self.nearest_mm,
            f"brings the target to {least:.0f} mm, nearer than the tracker sees",
        )
        yield (
            far > self.farthest_mm,
            f"takes the target {most:.0f} mm away, farther than the tracker sees",
        )
        for box in self.blocks_sight:
            behind = _triangle_touches(np.tile(tracker, (len(a), 1)), a, b, box)
            yield behind, f"goes behind {_name_box(box)}, out of the tracker's sight"


def moves_where_seen(machine: Machine, target: Target) -> bool:
    """Tell whether a target moves where the tracker stands."""
    from_base = machine.tracker.stands_on == "base"
    if target.on == "workpiece":
        return from_base and bool(machine.workpiece_side)
    return bool(machine.tool_side) or not from_base


def moving_targets(machine: Machine) -> tuple[Target, ...]:
    """Return the targets that move where the tracker stands.

    Raises PlanningError if there is none.
    """
    targets = tuple(t for t in machine.targets if moves_where_seen(machine, t))
    if not targets:
        raise PlanningError(
            f"no target of {machine.name} moves where the tracker stands; "
            "state one on the tool in machine.json"
        )
    return targets


def _name_box(box: Box) -> str:
    return box.name or f"{list(box.low_mm)} to {list(box.high_mm)} mm"


def _target_mm(
    machine: Machine, position: Float64[np.ndarray, "n a"]
) -> Float64[np.ndarray, "n 3"]:
    """Return the nominal place of the first target where the tracker stands."""
    return observe_targets(machine, position, [machine.target()]).point_mm


def _crosses(
    begin: Float64[np.ndarray, "n 3"], end: Float64[np.ndarray, "n 3"], box: Box
) -> Bool[np.ndarray, " n"]:
    """Tell which segments touch a box: slabs, one coordinate after another."""
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


def _distances(
    place: Float64[np.ndarray, "3"],
    begin: Float64[np.ndarray, "n 3"],
    end: Float64[np.ndarray, "n 3"],
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return the least and the largest distance of each segment from a place."""
    step, off = end - begin, place - begin
    square = np.maximum(np.einsum("ni,ni->n", step, step), 1e-12)
    share = np.clip(np.einsum("ni,ni->n", off, step) / square, 0.0, 1.0)
    near = np.linalg.norm(off - share[:, None] * step, axis=1)
    ends = [np.linalg.norm(place - p, axis=1) for p in (begin, end)]
    return near, np.maximum(ends[0], ends[1])


def _triangle_touches(
    a: Float64[np.ndarray, "n 3"],
    b: Float64[np.ndarray, "n 3"],
    c: Float64[np.ndarray, "n 3"],
    box: Box,
) -> Bool[np.ndarray, " n"]:
    """Tell which triangles touch a box (separating axes, Akenine-Möller 2001)."""
    low, high = np.array(box.low_mm), np.array(box.high_mm)
    half = (high - low) / 2.0
    corners = np.stack([a, b, c], axis=1) - (low + high) / 2.0
    edges = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(edges[:, 0], edges[:, 1])
    unit = np.broadcast_to(np.eye(3), (len(a), 3, 3))
    across = np.cross(edges[:, :, None], np.eye(3)).reshape(len(a), 9, 3)
    axes = np.concatenate([unit, normal[:, None], across], axis=1)
    reach = np.abs(axes) @ half
    shadow = axes @ np.swapaxes(corners, 1, 2)
    apart = (shadow.min(axis=2) > reach) | (shadow.max(axis=2) < -reach)
    return ~apart.any(axis=1)
