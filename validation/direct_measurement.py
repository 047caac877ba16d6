"""A direct measurement as a multi-degree-of-freedom laser makes it, simulated.

Every error motion of every axis on its own, forward and backward, five runs. The
figures of the instrument are assumptions of this study, not those of any make.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    is_straightness,
    is_turn,
    list_error_motions,
)
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine.truth_machine import TruthMachine

RUNS, STEP_MM, MARGIN_MM = 5, 25.0, 10.0
REPEATABILITY = {"um": 0.4, "urad": 1.0}
REVERSAL = {"um": 0.5, "urad": 0.5}


@dataclass(frozen=True)
class DirectTable:
    """One error motion; values (runs, 2, n), forward and backward, in mm or rad."""

    symbol: str
    position_mm: np.ndarray
    value: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean over runs and directions."""
        return self.value.mean(axis=(0, 1))


@dataclass(frozen=True)
class DirectMachine:
    """All 18 tables, and the volumetric error that they predict."""

    model: MachineModel
    theta: np.ndarray
    tables: dict[str, DirectTable]

    def deviation_mm(self, position_mm: np.ndarray) -> np.ndarray:
        """Return the volumetric error of the tables, squareness left out."""
        at = make_standstill(self.model.machine, position_mm)
        return self.model.jacobian(at) @ self.theta


def measure(machine: Machine, truth: TruthMachine, seed: int) -> DirectMachine:
    """Measure every error motion of a machine."""
    rng = np.random.default_rng(seed)
    tables, motions, theta = {}, [], []
    for axis in machine.linear_axes:
        low, high = axis.low + MARGIN_MM, axis.high - MARGIN_MM
        count = round((high - low) / STEP_MM) + 1
        position = np.linspace(low, high, count)
        for symbol in list_error_motions(axis.name):
            unit = "urad" if is_turn(symbol) else "um"
            scale = 1e-6 if is_turn(symbol) else 1e-3
            value = truth.error_motions()[symbol].at(position)
            half = 0.5 * scale * REVERSAL[unit] * rng.normal()
            noise = rng.normal(size=(RUNS, 2, count)) * scale * REPEATABILITY[unit]
            measured = value + half * np.array([1.0, -1.0])[:, None] + noise
            tables[symbol] = DirectTable(symbol, position, measured)
            motion = make_error_motion(symbol, axis, count - 1)
            fit = np.linalg.lstsq(
                motion.rows(position), tables[symbol].mean, rcond=None
            )[0]
            motions.append(motion)
            theta.append(fit)
    return DirectMachine(
        MachineModel(machine, tuple(motions)), np.concatenate(theta), tables
    )


def by_convention(symbol: str, values: np.ndarray) -> np.ndarray:
    """Return values along the first axis in the paper's convention.

    Straightness loses its end-point line; all else is 0 at the lowest position.
    """
    first, last = values[:1], values[-1:]
    if not is_straightness(symbol):
        return values - first
    share = np.linspace(0.0, 1.0, len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return values - (1.0 - share) * first - share * last
