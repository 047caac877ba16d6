"""The prior, its strengths found from the data.

Each error motion is charged for its bending energy, as the elastic beam of
brunn-hanebeck-2005 (eq. 12–13) would charge it; straight lines are free. The strengths
maximise the evidence: MacKay's fixed point, strength = γ / (θᵀKθ), where γ counts the
shapes that the data rather than the prior determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.estimation.information import (
    Information,
    Posterior,
    posterior,
    without_rest,
)
from app.kinematics.effects.base import Charge
from app.kinematics.model import MachineModel

_ROUNDS = 40
_SETTLED = 0.05
_STRAIGHT = 1e-5  # of the usual size, squared: below it an error counts as none


@dataclass(frozen=True)
class BendingPrior:
    """What each effect of the machine proper is charged for, and how strongly.

    log_forms : log determinant at strengths 1, over the shapes that are charged
    """

    model: MachineModel
    charges: dict[str, Charge]
    strength: dict[str, float]
    log_forms: float

    def precision(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Return the prior precision of θ; what follows the machine's has none."""
        total = np.zeros((size, size))
        for name, charge in self.charges.items():
            part = self.model.slices[name]
            total[part, part] = self.strength[name] * charge.form
        return total

    def log_determinant(self) -> float:
        """Return the log determinant over the shapes that are charged."""
        return self.log_forms + sum(
            charge.rank * float(np.log(self.strength[name]))
            for name, charge in self.charges.items()
        )


def first_guess(model: MachineModel) -> BendingPrior:
    """Return a prior for effects of usual size."""
    asked = {effect.name: effect.charge() for effect in model.effects}
    charges = {name: charge for name, charge in asked.items() if charge}
    strength = {name: 8.0 / charge.usual for name, charge in charges.items()}
    log_forms = sum(_log_determinant(charge) for charge in charges.values())
    return BendingPrior(model, charges, strength, log_forms)


def _log_determinant(charge: Charge) -> float:
    eigenvalue = np.linalg.eigvalsh(charge.form)[-charge.rank :]
    return float(np.log(eigenvalue).sum())


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
        prior = replace(prior, strength=strength)
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
    for name, charge in prior.charges.items():
        part, old = prior.model.slices[name], prior.strength[name]
        theta, spread = result.theta[part], result.covariance[part, part]
        free = charge.rank - old * float(np.sum(spread * charge.form))
        # An effect that is nothing within the noise keeps a finite strength.
        energy = float(theta @ charge.form @ theta) + _STRAIGHT * charge.usual
        strength[name] = max(free, 0.05) / energy
    return strength
