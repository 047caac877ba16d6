"""Paths and points without a planner: random chords, corners, standstills.

Of machines with rotary axes: all axes, every target in turn. Half of the lines turn all
axes together, the others the rotary axes alone. Where the target changes, the machine
stands for the tracker to turn to it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from truepath_simulators.machine_file import MachineFile, Reflector
from truepath_simulators.motion.program import Program
from truepath_simulators.randomness import generator

MARGIN_MM = 10.0


def chord_path(
    machine: MachineFile, seed: int, rows: int, feed_mm_min: float, dwell_s: float = 0.4
) -> Program:
    """Lines between random points on faces of the travel, none between two corners."""
    rng = generator(seed, "path: chords")
    points = _unit_points_on_faces(rng, rows)
    return _program(machine, points, feed_mm_min, dwell_s)


def corner_path(
    machine: MachineFile, feed_mm_min: float, dwell_s: float = 0.4
) -> Program:
    """Edges, face diagonals and space diagonals of the travel."""
    return _program(machine, _corner_tour(), feed_mm_min, dwell_s)


def standstill_points(
    machine: MachineFile,
    seed: int,
    random: int = 150,
    feed_mm_min: float = 20_000.0,
    dwell_s: float = 2.0,
) -> Program:
    """Standstills at the corners, then at random points inside."""
    rng = generator(seed, "path: standstill points")
    corners = np.array(list(itertools.product([0.0, 1.0], repeat=3)))
    points = np.vstack([corners, rng.uniform(0.0, 1.0, (random, 3))])
    return _program(machine, points, feed_mm_min, dwell_s)


def _program(
    machine: MachineFile, unit: np.ndarray, feed_mm_min: float, dwell_s: float
) -> Program:
    low, high = machine.low_mm + MARGIN_MM, machine.high_mm - MARGIN_MM
    # Commanded positions have the resolution of the files and of the controller.
    position = np.round(low + unit * (high - low), 4)
    n = len(position)
    return Program(position, np.full(n, feed_mm_min / 60.0), np.full(n, dwell_s))


def _unit_points_on_faces(rng: np.random.Generator, n: int) -> np.ndarray:
    points = rng.uniform(0.0, 1.0, (n, 3))
    face = np.cumsum(rng.integers(1, 6, n)) % 6  # never the same face twice in a row
    points[np.arange(n), face % 3] = face // 3
    return points


def _corner_tour() -> np.ndarray:
    """Corners such that consecutive ones cover all 28 lines between corners.

    Seven lines meet in each corner, an odd number, so some are travelled twice.
    """
    corners = list(itertools.product([0, 1], repeat=3))
    left = {frozenset(pair) for pair in itertools.combinations(corners, 2)}
    tour = [corners[0]]
    while left:
        here = tour[-1]
        ahead = [c for c in corners if frozenset((here, c)) in left]
        if ahead:
            step = max(
                ahead, key=lambda c: sum(frozenset((c, d)) in left for d in corners)
            )
        else:
            step = next(c for c in corners if any(c in pair for pair in left))
        left.discard(frozenset((here, step)))
        tour.append(step)
    return np.array(tour, dtype=float)


MARGIN_DEG = 1.0
_FASTEST_DEG_S = 40.0
_LEAST_TURN_DEG = 10.0


def turning_path(
    machine: MachineFile,
    seed: int,
    rows: int,
    feed_mm_min: float,
    dwell_s: float = 0.4,
) -> Program:
    """Lines between random positions; each target is measured on a block of rows."""
    rng = generator(seed, "path: lines with rotary axes")
    names = _find_moving_targets(machine)
    share = max(2, rows // len(names))
    position, target = [_anywhere(rng, machine)], [names[0]]
    for name in names:
        if name != target[-1]:
            position.append(position[-1])
            target.append(name)
        for k in range(share):
            end = _anywhere(rng, machine)
            if k % 2:
                end[:3] = position[-1][:3]
            position.append(end)
            target.append(name)
    places = np.round(np.array(position), 4)
    feed = _feed_s(places, feed_mm_min / 60.0)
    return Program(
        places, feed, np.full(len(places), dwell_s), _drop_empty_names(target)
    )


def turning_points(
    machine: MachineFile,
    seed: int,
    points: int,
    feed_mm_min: float = 20_000.0,
    dwell_s: float = 1.0,
) -> Program:
    """Standstills at random positions, the targets one after another."""
    rng = generator(seed, "path: points with rotary axes")
    names = _find_moving_targets(machine)
    target = [names[k * len(names) // points] for k in range(points)]
    drawn = [_anywhere(rng, machine)]
    while len(drawn) < points:
        place = _anywhere(rng, machine)
        # A target on the table moves with its axes alone: they have to turn.
        if np.abs(place - drawn[-1])[3:].min() > _LEAST_TURN_DEG:
            drawn.append(place)
    places = np.round(drawn, 4)
    feed = _feed_s(places, feed_mm_min / 60.0)
    return Program(places, feed, np.full(points, dwell_s), _drop_empty_names(target))


def looking_at(machine: MachineFile, targets: Sequence[str]) -> tuple[str, ...]:
    """Orders that turn a simulated tracker to the target of each row.

    In the syntax of `faults`; empty where only the first target is measured.
    """
    known = [reflector.name for reflector in machine.reflectors]
    orders: list[str] = []
    latest = known[0]
    for row, name in enumerate(targets):
        if name != latest:
            orders.append(f"tracker:target@row{row}*{known.index(name) + 1}")
            latest = name
    return tuple(orders)


def _find_moving_targets(machine: MachineFile) -> list[str]:
    def moves(reflector: Reflector) -> bool:
        on_base = machine.tracker.stands_on == "base"
        return reflector.on == "tool" or (on_base and bool(machine.workpiece_side))

    return [r.name for r in machine.reflectors if moves(r)]


def _drop_empty_names(target: list[str]) -> tuple[str, ...]:
    return tuple(target) if any(target) else ()


def _anywhere(rng: np.random.Generator, machine: MachineFile) -> np.ndarray:
    margin = np.array([MARGIN_MM] * 3 + [MARGIN_DEG] * len(machine.rotary_axes))
    return rng.uniform(machine.low + margin, machine.high - margin)


def _feed_s(position: np.ndarray, feed_mm_s: float) -> np.ndarray:
    """Feed per row, mm/s or deg/s, at which no rotary axis turns too fast."""
    step = np.abs(np.diff(position, axis=0, prepend=position[:1]))
    straight = np.linalg.norm(step[:, :3], axis=1)
    turn = step[:, 3:].max(axis=1)
    slow = straight / np.maximum(turn, 1e-9) * _FASTEST_DEG_S
    return np.where(straight > 0.0, np.minimum(feed_mm_s, slow), _FASTEST_DEG_S).clip(
        1.0
    )
