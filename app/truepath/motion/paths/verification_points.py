"""Points and circles that verify a calibration: places not used for it.

Body and face diagonals (ISO 230-6), random points in the travel, axes moved alone to
targets from both sides (ISO 230-2), and circles as polygons (ISO 230-4). Random numbers
follow from a seed, so that a plan can be reproduced.

Whole circles at constant feed are measured in motion (ISO 230-4), in each plane of two
linear axes one in both senses: half a turn and a little to run in, the turn that
counts, and as much to run out. Straight lines through corners of the travel lead from
one to the next; they determine the tracker's pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput, PlanningError
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, Configurations
from truepath.motion.motion_times import find_short_order
from truepath.motion.paths.verification_kinds import VerificationKind
from truepath.motion.workspace import (
    DECIMALS,
    Workspace,
    add_resting_axes,
    inner_travel,
    moving_targets,
)
from truepath_drivers.interfaces.arcs import turn_about
from truepath_drivers.interfaces.records import ARC_PLANES, Arc, Path

DWELL_S = 1.0
TURN_DEG = 732.0  # 186 to run in, 360, 186 to run out
FEED_MM_MIN = 3000.0
RANDOM_POINTS = 30
_ON_DIAGONAL, _DIAGONAL_RUNS = 5, 2
_AXIS_RUNS = 5  # of ISO 230-2
_FEWEST_TARGETS, _TARGETS_PER_M = 5, 5.0
_OVERRUN = 0.02  # of the travel, beyond the outer targets
_VERTICES = 24
_RADIUS = 0.4  # of the shorter travel of a plane
_MOST_ACCELERATION = 0.1  # of the machine's limit, on a circle in motion
_SMALLEST_MM = 10.0  # radius of a circle in motion
_DRAWS = 1_000  # until the workspace counts as full
_FORBIDDEN_MM = 1e9
_ANYWHERE = Workspace()

Row = Float64[np.ndarray, " a"]
Rows = Float64[np.ndarray, "n a"]


def make_verification_rows(
    machine: Machine,
    kinds: Sequence[VerificationKind],
    seed: int,
    workspace: Workspace = _ANYWHERE,
) -> Commanded:
    """The points of the kinds, or the path of circles in motion.

    workspace : limits random points only
    Raises BadInput where a path is requested together with points, PlanningError where
    the workspace leaves no room for random points.
    """
    if VerificationKind.CIRCLES_IN_MOTION not in kinds:
        return make_verification_points(machine, kinds, seed, workspace)
    if len(set(kinds)) > 1:
        raise BadInput(
            "circles-in-motion are a path and the other kinds are standstills, which "
            "are two measurements; ask for each by itself"
        )
    return make_circle_path(machine)


def make_verification_points(
    machine: Machine,
    kinds: Sequence[VerificationKind],
    seed: int,
    workspace: Workspace = _ANYWHERE,
) -> Configurations:
    """Points of the kinds, one kind after another.

    Rotary axes are at rest, but at random points. Of several targets the first that
    moves is measured. Random points are inside the workspace, and so is their order as
    far as one is found; all other points are where their standard requires them.

    Raises PlanningError where the workspace leaves no room for random points.
    """
    rng = np.random.default_rng(seed)
    low, high = inner_travel(machine)
    makers = {
        VerificationKind.DIAGONALS: _list_diagonals,
        VerificationKind.RANDOM_POINTS: partial(_sample_points, workspace),
        VerificationKind.BIDIRECTIONAL: _run_axes,
        VerificationKind.CIRCLES: _list_circles,
    }
    parts = [
        makers[kind](machine, low, high, rng)
        for kind in makers  # always in this order: one seed, one plan
        if kind in kinds
    ]
    position = np.round(np.concatenate(parts), DECIMALS)
    name = moving_targets(machine)[0].name
    return Configurations(
        machine.axis_names,
        position,
        np.full(len(position), DWELL_S),
        (name,) * len(position) if name else (),
    )


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
        rows += _list_circle_in_motion(machine, plane, low, high)
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


def _list_diagonals(
    machine: Machine, low: Row, high: Row, rng: np.random.Generator
) -> Rows:
    n = len(machine.linear_axes)
    ends = [
        np.array([[x, y, 0.0], [1.0 - x, 1.0 - y, 1.0]])
        for x, y in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    ]
    for a, b in combinations(range(n), 2):
        for begin in (0.0, 1.0):
            pair = np.full((2, n), 0.5)
            pair[:, a], pair[:, b] = (0.0, 1.0), (begin, 1.0 - begin)
            ends.append(pair)
    share = np.linspace(0.0, 1.0, _ON_DIAGONAL)[:, None]
    to_and_fro = _pass(_ON_DIAGONAL, _DIAGONAL_RUNS)
    unit = np.concatenate(
        [(pair[0] + share * (pair[1] - pair[0]))[to_and_fro] for pair in ends]
    )
    linear = low[:n] + unit * (high[:n] - low[:n])
    return add_resting_axes(machine, linear)


def _sample_points(
    workspace: Workspace,
    machine: Machine,
    low: Row,
    high: Row,
    rng: np.random.Generator,
) -> Rows:
    points = np.empty((0, len(low)))
    for _ in range(_DRAWS):
        drawn = rng.uniform(low, high, (RANDOM_POINTS, len(low)))
        points = np.vstack([points, drawn[workspace.allows(machine, drawn, drawn)]])
        if len(points) >= RANDOM_POINTS:
            break
    else:
        raise PlanningError(
            f"the workspace leaves room for {len(points)} of {RANDOM_POINTS} random "
            "points; correct the workspace, or ask for other points"
        )
    points = points[:RANDOM_POINTS]
    begin, end = (
        np.repeat(points, RANDOM_POINTS, 0),
        np.tile(points, (RANDOM_POINTS, 1)),
    )
    free = workspace.allows(machine, begin, end).reshape(RANDOM_POINTS, RANDOM_POINTS)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    return points[find_short_order(np.where(free, apart, _FORBIDDEN_MM))]


def _run_axes(machine: Machine, low: Row, high: Row, rng: np.random.Generator) -> Rows:
    """Five runs of each linear axis alone, to and fro, beyond the outer targets.

    Targets are spread evenly and shifted a little at random, so that no period of a
    screw or scale hides between them.
    """
    n = len(machine.linear_axes)
    middle = 0.5 * (low[:n] + high[:n])
    parts: list[Rows] = []
    for column in range(n):
        span = high[column] - low[column]
        count = max(_FEWEST_TARGETS, int(np.ceil(_TARGETS_PER_M * span / 1e3)))
        step = (1.0 - 2.0 * _OVERRUN) / (count - 1)
        inside = _OVERRUN + step * np.arange(count)
        inside[1:-1] += 0.3 * step * rng.uniform(-1.0, 1.0, count - 2)
        share = np.concatenate([[0.0], inside, [1.0]])[_pass(count + 2, _AXIS_RUNS)]
        rows = np.tile(middle, (len(share), 1))
        rows[:, column] = low[column] + share * span
        parts.append(rows)
    return add_resting_axes(machine, np.concatenate(parts))


def _list_circles(
    machine: Machine, low: Row, high: Row, rng: np.random.Generator
) -> Rows:
    n = len(machine.linear_axes)
    middle = 0.5 * (low[:n] + high[:n])
    angle = np.linspace(0.0, 2.0 * np.pi, _VERTICES + 1)
    angle = np.concatenate([angle, angle[-2::-1]])
    parts: list[Rows] = []
    for a, b in combinations(range(n), 2):
        radius = _RADIUS * min(high[a] - low[a], high[b] - low[b])
        rows = np.tile(middle, (len(angle), 1))
        rows[:, a] += radius * np.cos(angle)
        rows[:, b] += radius * np.sin(angle)
        parts.append(rows)
    return add_resting_axes(machine, np.concatenate(parts))


def _pass(count: int, runs: int) -> list[int]:
    order = [0]
    for _ in range(runs):
        order += [*range(1, count), *range(count - 2, -1, -1)]
    return order


def _list_corners(machine: Machine, low: Row, high: Row) -> list[Row]:
    n = len(machine.linear_axes)
    order = (0, 7, 1, 6, 2, 5) if n == 3 else range(2**n)
    share = np.array([[k >> axis & 1 for axis in range(n)] for k in order], float)
    moved = np.round(low[:n] + share * (high[:n] - low[:n]), DECIMALS)
    return list(add_resting_axes(machine, moved))


def _list_circle_in_motion(
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
