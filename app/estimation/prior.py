"""The bending prior, its strength found from the data.

Each error motion is charged for its bending energy, as the elastic beam of
brunn-hanebeck-2005 (eq. 12–13) would charge it. Straight lines are free. The strength
maximises the evidence: MacKay's fixed point, strength = γ / (θᵀKθ), where γ counts the
shapes that the data rather than the prior determine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.estimation.information import (
    Information,
    Posterior,
    posterior,
    without_rest,
)
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel
from app.kinematics.symbols import is_turn

_ROUNDS = 40
_SETTLED = 0.05
_TYPICAL_MM, _TYPICAL_RAD = 0.01, 2e-5
_STRAIGHT = 1e-5  # of the usual bending energy: below it a motion counts as straight


@dataclass(frozen=True)
class BendingPrior:
    """Roughness of every motion, and the strength with which each is charged.

    model : effects of the machine proper
    """

    model: MachineModel
    strength: dict[str, float]

    def precision(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the prior precision of θ; what follows the machine's has none."""
        total = np.zeros((size, size))
        for motion in _motions(self.model):
            part = self.model.slices[motion.name]
            total[part, part] = self.strength[motion.name] * motion.roughness()
        return total

    def log_determinant(self) -> float:
        """Return the log determinant over the shapes that are charged."""
        return sum(
            _charged(m) * float(np.log(self.strength[m.name]))
            for m in _motions(self.model)
        )


def first_guess(model: MachineModel) -> BendingPrior:
    """Return a prior for errors of usual size that wave once over the travel."""
    return BendingPrior(
        model, {m.name: 8.0 / _typical_energy(m) for m in _motions(model)}
    )


def _typical_energy(motion: ErrorMotion) -> float:
    """Return the bending energy of an error of usual size, one wave over the travel."""
    length = motion.axis.max_mm - motion.axis.min_mm
    size = _TYPICAL_RAD if is_turn(motion.symbol) else _TYPICAL_MM
    return size**2 * (2.0 * np.pi / length) ** 4 * length / 2.0


def fitted(data: Information, prior: BendingPrior) -> tuple[BendingPrior, Posterior]:
    """Return the prior whose strengths fit the data, and the posterior under it."""
    size = prior.model.size
    machine = without_rest(data, size)
    for _ in range(_ROUNDS):
        result = posterior(machine, prior.precision(size))
        strength = _next_strength(prior, result)
        change = max(
            abs(float(np.log(strength[name] / old)))
            for name, old in prior.strength.items()
        )
        prior = BendingPrior(prior.model, strength)
        if change < _SETTLED:
            break
    return prior, posterior(data, prior.precision(len(data.vector)))


def evidence_cost(data: Information, prior: BendingPrior, result: Posterior) -> float:
    """Return −2 log p(data | noise, prior), up to a constant."""
    return (
        data.log_determinant
        + result.log_determinant
        - prior.log_determinant()
        + result.misfit
    )


def _next_strength(prior: BendingPrior, result: Posterior) -> dict[str, float]:
    strength: dict[str, float] = {}
    for motion in _motions(prior.model):
        part, K = prior.model.slices[motion.name], motion.roughness()
        theta, old = result.theta[part], prior.strength[motion.name]
        free = _charged(motion) - old * float(np.sum(result.covariance[part, part] * K))
        # A motion that is straight within the noise keeps a finite strength.
        energy = float(theta @ K @ theta) + _STRAIGHT * _typical_energy(motion)
        strength[motion.name] = max(free, 0.05) / energy
    return strength


def _motions(model: MachineModel) -> list[ErrorMotion]:
    return [e for e in model.effects if isinstance(e, ErrorMotion)]


def _charged(motion: ErrorMotion) -> int:
    return motion.spline.size - 2
