"""Effects of the machine known from an earlier measurement.

They are estimated together with the error motions, and the earlier knowledge of their
parameters is one more measurement: information adds. So a Run corrects what it
determines, the rest stays as it was, and the uncertainty of the tables includes that of
the effects. Nothing else of the earlier model is used: the error motions are measured
again, for a table that leans on the past would hide that the machine has changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from scipy.special import chdtrc

from truepath.estimation.problem.information import (
    EXACTLY,
    Information,
    Posterior,
    invert_covariance,
)
from truepath.kinematics.model import CatalogueEffect, MachineModel

_LOOSE = 100.0
_MEASURED_SHARE = 0.05  # of a variance, removed by the Run: enough to contradict


@dataclass(frozen=True)
class PriorEffects:
    """Effects with their parameters and covariance, before a measurement.

    theta : (k,), covariance : (k, k), one effect after another
    """

    effects: tuple[CatalogueEffect, ...] = ()
    theta: Float64[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))
    covariance: Float64[np.ndarray, "k k"] = field(
        default_factory=lambda: np.zeros((0, 0))
    )

    def locate(self, model: MachineModel) -> slice:
        if not self.effects:
            return slice(0, 0)
        slices = [model.slices[effect.name] for effect in self.effects]
        return slice(slices[0].start, slices[-1].stop)

    def precision_matrix(self) -> Float64[np.ndarray, "k k"]:
        """Singular covariances are regularised, see `invert_covariance`."""
        return invert_covariance(self.covariance)

    def add_to(self, data: Information, model: MachineModel) -> Information:
        """Adds the earlier measurement to the information on a model.

        data : on the model's parameters, which may be followed by others
        """
        if not self.effects:
            return data
        part, precision = self.locate(model), self.precision_matrix()
        matrix, vector = data.matrix.copy(), data.vector.copy()
        pull = precision @ self.theta
        matrix[part, part] += precision
        vector[part] += pull
        square = data.square + float(self.theta @ pull)
        return replace(data, matrix=matrix, vector=vector, square=square)

    def inflate_covariance(self) -> PriorEffects:
        """The same effects with covariances of 100² times the size.

        For a Run that they were found in: it must not count twice.
        """
        return replace(self, covariance=_LOOSE**2 * self.covariance)

    def compute_chances(
        self, model: MachineModel, result: Posterior
    ) -> tuple[float | None, ...]:
        """Probability of at least this change if nothing has changed, by effect.

        result : of the model, with the Run. None where the Run does not determine the
            effect.
        """
        found: list[float | None] = []
        begin = 0
        for effect in self.effects:
            own = slice(begin, begin + len(effect.parameters))
            now, begin = model.slices[effect.name], own.stop
            before, after = self.covariance[own, own], result.covariance[now, now]
            moved = result.theta[now] - self.theta[own]
            found.append(_compute_chance(before, after, moved))
        return tuple(found)


def _compute_chance(
    before: Float64[np.ndarray, "k k"],
    after: Float64[np.ndarray, "k k"],
    moved: Float64[np.ndarray, " k"],
) -> float | None:
    """The covariance of the change is what the Run has removed."""
    scale = np.sqrt(np.diag(before) + EXACTLY**2)
    value, vector = np.linalg.eigh((before - after) / scale[:, None] / scale)
    is_measured = value > _MEASURED_SHARE
    if not is_measured.any():
        return None
    along = vector.T @ (moved / scale)
    square = float(np.sum(along[is_measured] ** 2 / value[is_measured]))
    return float(chdtrc(int(is_measured.sum()), square))


def extract_prior_effects(
    model: MachineModel,
    theta: Float64[np.ndarray, " p"],
    covariance: Float64[np.ndarray, "p p"],
) -> PriorEffects:
    effects = model.catalogue_effects
    numbers = np.arange(model.size)
    kept = np.concatenate(
        [np.zeros(0, np.int64), *(numbers[model.slices[e.name]] for e in effects)]
    )
    return PriorEffects(effects, theta[kept], covariance[np.ix_(kept, kept)])
