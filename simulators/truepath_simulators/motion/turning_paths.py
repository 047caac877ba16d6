"""Paths and points of machines with rotary axes: all axes, every target in turn.

Half of the lines turn all axes together, the others the rotary axes alone. Where the
target changes, the machine stands for the tracker to turn to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truepath_simulators.machine_file import MachineFile, Reflector
from truepath_simulators.motion.paths import MARGIN_MM
from truepath_simulators.motion.program import Program
from truepath_simulators.randomness import generator

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
