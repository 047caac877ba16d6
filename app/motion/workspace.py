"""Where the machine may go and what the tracker must see while it does.

Keep-out boxes are stated in axis positions, like the protection zones of a control.
Range and line of sight are those of the measured target where the tracker stands. All
are checked over the whole swept line: a straight line in axis positions against boxes,
the triangle that the beam sweeps against what blocks it. That is exact where the box
stands still or is carried by the tool; a box carried by another axis counts as larger
by what it moves in a sixteenth of the line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float64

from app.errors import PlanningError
from app.kinematics.conditions import Conditions, observe_targets
from app.kinematics.effects.tracker_error import TrackerSpecification
from app.kinematics.machine import Machine, Target
from app.motion.configurations import Commanded

_PARTS = 8  # of a line, where beam and box both move


@dataclass(frozen=True, slots=True)
class Box:
    """A closed box.

    low_mm, high_mm : in X, Y, Z; name : for people
    carried_by : axis whose carriage it moves with, or `base`, stated at the axis zeros;
        where left out, it stands where the tracker stands
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    name: str = ""
    carried_by: str = ""


@dataclass(frozen=True, slots=True)
class Reflector:
    """Where a reflector looks, in the frame of the tool, and how far to the side."""

    direction: tuple[float, float, float]
    half_angle_deg: float


@dataclass(frozen=True, slots=True)
class StationAreas:
    """Where the tracker may stand, in the frame that it stands on.

    keep_out : boxes in which it must not stand
    move_s : what another station costs: carry it, warm up, check known points
    specification : what the tracker may be off by in a way that no time averages
    """

    areas: tuple[Box, ...]
    keep_out: tuple[Box, ...] = ()
    move_s: float = 600.0
    specification: TrackerSpecification = field(default_factory=TrackerSpecification)

    def allow(self, place_mm: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Tell at which places the tracker may stand."""
        inside = [_crosses(place_mm, place_mm, box) for box in self.areas]
        out = [_crosses(place_mm, place_mm, box) for box in self.keep_out]
        return np.any(inside, axis=0) & ~np.any([*out, np.zeros(len(place_mm))], axis=0)


@dataclass(frozen=True, slots=True)
class Workspace:
    """What limits a plan beside the travel.

    keep_out : boxes of axis positions X, Y, Z that no motion may touch
    tracker_mm : place of the tracker in the frame that it stands on; None if unknown
    nearest_mm, farthest_mm : range of the tracker
    blocks_sight : boxes in the same frame that the beam must not touch
    reflector : of the measured target; None where it looks everywhere
    stations : where the tracker may stand; None where nobody has said so
    """

    keep_out: tuple[Box, ...] = ()
    tracker_mm: tuple[float, float, float] | None = None
    nearest_mm: float = 0.0
    farthest_mm: float = np.inf
    blocks_sight: tuple[Box, ...] = ()
    reflector: Reflector | None = None
    stations: StationAreas | None = None

    def place_tracker(self, place_mm: Float64[np.ndarray, "3"]) -> Workspace:
        """Return it with the tracker at a place."""
        x, y, z = (float(v) for v in place_mm)
        return replace(self, tracker_mm=(x, y, z))

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
        first, last = _observe(machine, begin), _observe(machine, end)
        a, b = first.point_mm, last.point_mm
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
            share = _compute_share(machine, box.carried_by)
            moved = begin @ share, end @ share
            behind = _beam_touches(
                (tracker - moved[0], tracker - moved[1]),
                (a - moved[0], b - moved[1]),
                box,
            )
            yield behind, f"goes behind {_name_box(box)}, out of the tracker's sight"
        if self.reflector is not None:
            # What a reflector accepts is a cone: both ends in it, all between in it.
            turned = [_angles_deg(self.reflector, at, tracker) for at in (first, last)]
            angle = np.maximum(*turned)
            yield (
                angle > self.reflector.half_angle_deg,
                f"turns the reflector {angle.max(initial=0.0):.0f}° away from the "
                "tracker, farther than it reflects",
            )


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


def _observe(machine: Machine, position: Float64[np.ndarray, "n a"]) -> Conditions:
    """Return conditions of the first target where the tracker stands."""
    return observe_targets(machine, position, [machine.target()])


def _angles_deg(
    reflector: Reflector, at: Conditions, tracker_mm: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, " n"]:
    """Return the angles between where the reflector looks and the tracker."""
    frame = at.chain.tool_frame + at.chain.workpiece_frame
    looks = frame @ np.array(reflector.direction)
    beam = tracker_mm - at.point_mm
    size = np.linalg.norm(beam, axis=1) * np.linalg.norm(looks, axis=1)
    cosine = np.einsum("ni,ni->n", looks, beam) / np.maximum(size, 1e-12)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _compute_share(machine: Machine, carrier: str) -> Float64[np.ndarray, "a 3"]:
    """Return how far a body moves where the tracker stands, by the axes' positions.

    carrier : axis whose carriage carries it, or `base`; it stands where left out
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


def _beam_touches(
    tracker: tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]],
    target: tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]],
    box: Box,
) -> Bool[np.ndarray, " n"]:
    """Tell which beams touch a box on the way from begin to end, seen from the box.

    Of tracker and target the one that moves less is taken to stand in the middle of its
    way, and the box to be larger by half of that way.
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
    """Tell which triangles touch a box (separating axes, Akenine-Möller 2001).

    margin_mm : by which the box is larger
    """
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
