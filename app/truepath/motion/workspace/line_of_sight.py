"""Whether straight lines touch boxes, and the tracker sees its target on all of them.

A straight line in axis positions is compared with boxes, the triangle that the beam
sweeps with obstacles. That is exact where the box is at rest or is carried by the tool;
a box carried by another axis is enlarged by its motion in a sixteenth of the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.machine.machine import Machine

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
