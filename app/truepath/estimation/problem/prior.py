"""The prior, its precisions found from the data.

Each error motion is penalised by its bending energy, as the elastic beam of
brunn-hanebeck-2005 (eq. 12–13); straight lines are free. The precisions maximise the
evidence: MacKay's fixed point, precision = γ / (θᵀKθ), where γ counts the shapes that
the data rather than the prior determine.

With few data a motion would pass for perfectly straight, with far too small an
uncertainty. The log precisions of motions of a kind therefore scatter about a common
centre, as guides of one machine are alike, and the uncertainty of the precisions widens
the covariance (Kass & Steffey 1989).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.special import wrightomega

from truepath.estimation.problem.information import (
    Information,
    OwnParameters,
    Posterior,
    compute_posterior,
)
from truepath.kinematics.effects.base import Parameter, QuadraticPrior
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.model import MachineModel

USUAL_PRECISION = 8.0  # of an effect of typical size 1, before any data
_ROUNDS = 40  # at most
_SETTLED = 0.15  # change of a log precision that no table shows
_SPREAD = 1.2  # τ: standard deviation of log precision within a kind
_STRAIGHT = 1e-5  # of the typical size, squared: below it an error counts as 0


@dataclass(frozen=True)
class BendingPrior:
    """Quadratic penalty of each effect of the machine, and its strength.

    log_forms : log determinant at precisions 1, over the penalised shapes
    """

    model: MachineModel
    penalties: dict[str, QuadraticPrior]
    precision: dict[str, float]
    log_forms: float

    def precision_matrix(self, size: int) -> Float64[np.ndarray, "p p"]:
        """Prior precision of θ; zero for parameters after the machine's."""
        total = np.zeros((size, size))
        for name, penalty in self.penalties.items():
            part = self.model.slices[name]
            total[part, part] = self.precision[name] * penalty.form
        return total

    def log_determinant(self) -> float:
        return self.log_forms + sum(
            penalty.rank * float(np.log(self.precision[name]))
            for name, penalty in self.penalties.items()
        )

    def widen_tracker(self, times: float) -> BendingPrior:
        tracker = {e.name for e in self.model.effects if is_tracker_error(e)}
        wider = {
            name: value / times**2 if name in tracker else value
            for name, value in self.precision.items()
        }
        return replace(self, precision=wider)

    def fit(self, data: Information) -> tuple[BendingPrior, Posterior]:
        """The prior whose precisions maximise the evidence, and the posterior."""
        prior, size = self, self.model.size
        machine = OwnParameters.of(data, size).eliminate()
        for _ in range(_ROUNDS):
            result = compute_posterior(machine, prior.precision_matrix(size))
            precision = _next_precision(prior, result)
            change = max(
                abs(float(np.log(precision[name] / old)))
                for name, old in prior.precision.items()
            )
            prior = replace(prior, precision=precision)
            if change < _SETTLED:
                break
        return prior, compute_posterior(data, prior.precision_matrix(len(data.vector)))


def guess_prior(
    model: MachineModel,
    straight: Mapping[str, Float64[np.ndarray, "_ _"]] | None = None,
) -> BendingPrior:
    """Prior for effects of typical size.

    straight : precision of the shapes that bending leaves free, by the effect's name;
        the whole prior of effects that do not bend
    """
    asked = {effect.name: effect.prior() for effect in model.effects}
    penalties = {name: penalty for name, penalty in asked.items() if penalty}
    precision = {
        name: 1.0 if penalty.is_known else USUAL_PRECISION / penalty.typical
        for name, penalty in penalties.items()
    }
    for name, form in (straight or {}).items():
        bent = penalties.get(name, QuadraticPrior(0.0 * form, 0, 1.0, is_known=True))
        form = bent.form + form / precision.setdefault(name, 1.0)
        penalties[name] = replace(bent, form=form, rank=len(form))
    eigenvalues = [
        np.linalg.eigvalsh(penalty.form)[-penalty.rank :]
        for penalty in penalties.values()
    ]
    log_forms = sum(float(np.log(each).sum()) for each in eigenvalues)
    return BendingPrior(model, penalties, precision, log_forms)


def diagonal_precision(
    parameters: Sequence[Parameter], sigma: Mapping[str, float], other: float = 1.0
) -> Float64[np.ndarray, "p p"]:
    """Precision of parameters from a standard deviation by unit.

    other : standard deviation in units that `sigma` does not name
    """
    return np.diag([sigma.get(p.unit, other) ** -2.0 for p in parameters])


def compute_evidence_cost(
    data: Information, prior: BendingPrior, result: Posterior
) -> float:
    """−2 log p(data | noise, prior), up to a constant."""
    return (
        data.log_determinant
        + result.log_determinant
        - prior.log_determinant()
        + result.misfit
    )


def widen_by_unknown_precision(prior: BendingPrior, result: Posterior) -> Posterior:
    """Adds the uncertainty of the precisions to the covariance.

    Over log precisions of variance v the mean moves by ∂θ/∂l = −C P θ, and the expected
    covariance is C + v/2 ∂²C/∂l² = C + v (C P C P C − C P C / 2), to second order.
    """
    C = result.covariance
    total = C.copy()
    for name, variance in log_precision_variance(prior, result).items():
        part = prior.model.slices[name]
        P = prior.precision[name] * prior.penalties[name].form
        pull = C[:, part] @ P
        moved = pull @ result.theta[part]
        bent = P @ C[part, part] @ P - 0.5 * P
        total += variance * (np.outer(moved, moved) + C[:, part] @ bent @ C[part, :])
    return replace(result, covariance=total)


def log_precision_variance(prior: BendingPrior, result: Posterior) -> dict[str, float]:
    """Posterior variance of the log of each precision.

    Half the shapes that the data determine count as measurements of it, and its kind as
    one more.
    """
    variance: dict[str, float] = {}
    for name, penalty in prior.penalties.items():
        if penalty.is_known:
            variance[name] = 0.0
            continue
        part = prior.model.slices[name]
        P = prior.precision[name] * penalty.form
        free = penalty.rank - float(np.sum(P * result.covariance[part, part]))
        if penalty.counted:
            least = np.argsort(np.diag(P))[: penalty.counted]
            known = np.diag(P) * np.diag(result.covariance[part, part])
            free = penalty.counted - float(known[least].sum())
        variance[name] = 1.0 / (0.5 * max(free, 0.0) + 1.0 / _SPREAD**2)
    return variance


def _compute_kind_precisions(prior: BendingPrior) -> dict[str, float]:
    """Geometric mean precision of each kind, scaled to a typical size of 1."""
    found: dict[str, list[float]] = {}
    for name, penalty in prior.penalties.items():
        relative = np.log(prior.precision[name] * penalty.typical)
        found.setdefault(penalty.kind, []).append(float(relative))
    return {kind: float(np.exp(np.mean(values))) for kind, values in found.items()}


def _next_precision(prior: BendingPrior, result: Posterior) -> dict[str, float]:
    centres = _compute_kind_precisions(prior)
    precision: dict[str, float] = {}
    for name, penalty in prior.penalties.items():
        part, old = prior.model.slices[name], prior.precision[name]
        if penalty.is_known:
            precision[name] = old
            continue
        theta, spread = result.theta[part], result.covariance[part, part]
        free = penalty.rank - old * float(np.sum(spread * penalty.form))
        # An effect that is zero within the noise, or not observed yet, keeps a finite
        # precision.
        energy = float(theta @ penalty.form @ theta) + _STRAIGHT * penalty.typical
        if penalty.kind:
            centre = centres[penalty.kind] / penalty.typical
            precision[name] = pool_precision(free, energy, centre)
        else:
            precision[name] = max(free, 0.05) / energy
    return precision


def pool_precision(
    free: float, energy: float, centre: float, spread: float = _SPREAD
) -> float:
    """Solve γ − λ θᵀKθ = 2 (log λ − log centre) / τ² for the precision λ.

    free : γ; energy : θᵀKθ; spread : τ
    """
    relative = 0.5 * spread**2 * free
    pull = 0.5 * spread**2 * centre * energy
    # x + pull exp(x) = relative for x = log(λ / centre)
    x = relative - float(wrightomega(relative + float(np.log(pull))))
    return centre * float(np.exp(x))
