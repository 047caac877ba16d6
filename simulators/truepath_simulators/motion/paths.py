"""Paths and points without a planner: random chords, corners, standstills."""

from __future__ import annotations

import itertools

import numpy as np

from truepath_simulators.machine_file import MachineFile
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
