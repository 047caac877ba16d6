"""Lines of five-axis machines on which the tip keeps its place while the axes turn."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine
from truepath.motion.workspace import moving_targets
from truepath_drivers.interfaces.records import Path

_TURN_DEG, _LEAST_TURN_DEG, _TRIES = 25.0, 10.0, 40
_SLOWEST_DEG_MIN, _MARGIN = 1800.0, 2.0
_DWELL_S, _CHANGE_S = 0.4, 5.0


def keep_tip(machine: Machine, begin: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """Return the position with other angles at which the tip stands where it did."""

    def find_tip(position: np.ndarray) -> np.ndarray:
        return make_standstill(machine, position[None]).point_mm[0]

    place, position = find_tip(begin), begin.copy()
    position[3:] = angles_deg
    for _ in range(4):
        here = find_tip(position)
        moved = [find_tip(position + one) - here for one in np.eye(len(begin))[:3]]
        position[:3] -= np.linalg.solve(np.array(moved).T, here - place)
    return position


@dataclass
class _Rows:
    """Rows of a path, one after another."""

    feed_mm_min: float
    position: list[np.ndarray]
    target: list[str]
    dwell_s: list[float]
    feed: list[float] = field(default_factory=list[float])

    def go(self, place: np.ndarray, name: str, dwell_s: float = _DWELL_S) -> None:
        """Add a line at the feed that the rotary axes keep up with."""
        step = np.abs(place - self.position[-1])
        way_mm = float(np.linalg.norm(step[:3]))
        slow = way_mm / max(float(step[3:].max()) / _SLOWEST_DEG_MIN, 1e-9)
        self.position.append(np.round(place, 4))
        self.target.append(name)
        self.dwell_s.append(dwell_s)
        self.feed.append(min(self.feed_mm_min, slow) if way_mm else _SLOWEST_DEG_MIN)


def add_kept_tips(machine: Machine, path: Path, lines: int, seed: int) -> Path:
    """Return the path and, for each target, lines on which the tip keeps its place."""
    rng = np.random.default_rng([seed, 8])
    low, high = np.array([(a.low, a.high) for a in machine.axes]).T
    rows = _Rows(
        float(path.feed_mm_min.max()),
        list(path.position),
        list(path.target),
        list(path.dwell_s),
        list(path.feed_mm_min),
    )
    for target in moving_targets(machine):
        rows.go(rows.position[-1], target.name, _CHANGE_S)
        kept = 0
        while kept < lines:
            rows.go(rng.uniform(low + _MARGIN, high - _MARGIN), target.name)
            for _ in range(_TRIES):
                begin = rows.position[-1]
                turn = rng.uniform(-_TURN_DEG, _TURN_DEG, len(low) - 3)
                place = keep_tip(machine, begin, begin[3:] + turn)
                inside = ((place > low) & (place < high)).all()
                if inside and np.abs(turn).max() > _LEAST_TURN_DEG and kept < lines:
                    rows.go(place, target.name)
                    kept += 1
    return Path(
        path.axes,
        np.array(rows.position),
        np.array(rows.feed),
        np.array(rows.dwell_s),
        tuple(rows.target),
    )
