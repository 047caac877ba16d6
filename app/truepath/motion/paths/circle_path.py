"""A path of whole circles at constant feed, to be measured in motion (ISO 230-4).

In each plane of two linear axes one circle in both senses: half a turn and a little to
run in, the turn that counts, and as much to run out. Straight lines through corners of
the travel lead from one to the next; they determine the tracker's pose.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.workspace.travel import DECIMALS, add_resting_axes, inner_travel
from truepath.motion.workspace.workspace import moving_targets
from truepath_drivers.interfaces.arcs import turn_about
from truepath_drivers.interfaces.records import ARC_PLANES, Arc, Path

TURN_DEG = 732.0  # 186 to run in, 360, 186 to run out
FEED_MM_MIN = 3000.0
DWELL_S = 1.0
_RADIUS = 0.4  # of the shorter travel of a plane
_MOST_ACCELERATION = 0.1  # of the machine's limit
_SMALLEST_MM = 10.0

Row = Float64[np.ndarray, " a"]


def make_circle_path(machine: Machine) -> Path:
    """A circle in each plane in which the tracker sees both axes move.

    Raises PlanningError where there is none.
    """
    target = moving_targets(machine)[0]
    seen = [axis.name for axis in machine.linear_axes]
    if machine.tracker.stands_on == "base":
        moves = machine.tool_side if target.on == "tool" else machine.workpiece_side
        seen = [name for name in seen if name in moves]
    planes = [plane for plane in ARC_PLANES if set(plane) <= set(seen)]
    low, high = inner_travel(machine)
    corners = _list_corners(machine, low, high)
    rows: list[tuple[Row, Arc | None, float]] = [(corners[0], None, _feed(machine, 0))]
    for number, plane in enumerate(planes):
        rows += _list_circle(machine, plane, low, high)
        corner = corners[(number + 1) % len(corners)]
        rows.append((corner, None, _feed(machine, 0)))
    if len(rows) == 1:
        raise PlanningError(
            f"no plane of {machine.name} has two axes whose motion the tracker sees; "
            "drive other kinds"
        )
    rows += [(corner, None, _feed(machine, 0)) for corner in corners[len(planes) + 1 :]]
    places, arcs, feeds = zip(*rows, strict=True)
    return Path(
        machine.axis_names,
        np.array(places),
        np.array(feeds),
        np.full(len(rows), DWELL_S),
        (target.name,) * len(rows) if target.name else (),
        arcs,
    )


def _list_corners(machine: Machine, low: Row, high: Row) -> list[Row]:
    n = len(machine.linear_axes)
    order = (0, 7, 1, 6, 2, 5) if n == 3 else range(2**n)
    share = np.array([[k >> axis & 1 for axis in range(n)] for k in order], float)
    moved = np.round(low[:n] + share * (high[:n] - low[:n]), DECIMALS)
    return list(add_resting_axes(machine, moved))


def _list_circle(
    machine: Machine, plane: str, low: Row, high: Row
) -> list[tuple[Row, Arc | None, float]]:
    axes, n = machine.axis_names, len(machine.linear_axes)
    columns = [axes.index(name) for name in plane]
    middle = np.round(0.5 * (low[:n] + high[:n]), DECIMALS)
    radius = round(_RADIUS * float((high - low)[columns].min()), 1)
    if radius < _SMALLEST_MM:
        raise PlanningError(
            f"a circle in {plane} of {machine.name} has a radius of {radius:g} mm; "
            f"{_SMALLEST_MM:g} mm at least tell something"
        )
    begin = add_resting_axes(machine, middle[None])[0]
    centre = (float(begin[columns[0]]), float(begin[columns[1]]))
    begin[columns[0]] = round(float(begin[columns[0]]) + radius, DECIMALS)
    there = Arc(plane, centre, TURN_DEG)
    (end,) = turn_about(axes, begin, there, np.array([TURN_DEG])).round(DECIMALS)
    feed = _feed(machine, radius)
    return [
        (begin, None, _feed(machine, 0)),
        (end, there, feed),
        (begin, Arc(plane, centre, -TURN_DEG), feed),
    ]


def _feed(machine: Machine, radius_mm: float) -> float:
    """Limited by the centripetal acceleration; a radius of 0 is a straight line."""
    limits = machine.motion
    feed = min(FEED_MM_MIN, limits.max_feed_mm_min)
    if radius_mm:
        inwards = _MOST_ACCELERATION * limits.acceleration_mm_s2
        feed = min(feed, 60.0 * float(np.sqrt(inwards * radius_mm)))
    return float(np.floor(feed))
