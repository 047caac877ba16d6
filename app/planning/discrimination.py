"""How well lines not yet driven would decide between two hypotheses about a machine.

Each hypothesis is a Gaussian over the machine's parameters, mean + root z with z
standard normal. Data y of the lines have the log Bayes factor log p(y | a) −
log p(y | b); its expectation under a is the divergence of both predictions and never
below 0 (Kullback & Leibler 1951). The tracker's next place and the timing of each line
are integrated out, as in the decision.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.alignment.observations import Observations
from app.estimation.prior import diagonal_precision
from app.kinematics.effects.tracker_pose import TrackerPose

_POSE = TrackerPose((0.0, 0.0, 0.0)).parameters
POSE = len(_POSE)


@dataclass(frozen=True)
class Question:
    """Two hypotheses about the machine, between which lines are to decide.

    left, right : in words, the right one empty where the question is whether or not
    ranks : number of columns of the root of each hypothesis
    measure : returns the normal equations of observations of the next Run, its timing
        integrated out; columns are both roots, both means, the tracker's pose
    """

    left: str
    right: str
    ranks: tuple[int, int]
    measure: Callable[[Observations], Float64[np.ndarray, "q q"]]

    @property
    def size(self) -> int:
        """Number of columns of the normal equations."""
        return sum(self.ranks) + 2 + POSE

    def expect_log_bayes(
        self, normal: Float64[np.ndarray, "q q"], pose_sigma: Mapping[str, float]
    ) -> float:
        """Return the expected log Bayes factor for the truth that is harder to confirm.

        normal : normal equations of lines; pose_sigma : standard uncertainty of the
        tracker's next place, mm and rad
        """
        known = diagonal_precision(_POSE, pose_sigma)
        begin = len(normal) - POSE
        cross = normal[begin:, :begin]
        absorbed = np.linalg.solve(normal[begin:, begin:] + known, cross)
        rest = normal[:begin, :begin] - cross.T @ absorbed
        middle = self.ranks[0]
        one = _Columns(np.arange(middle), begin - 2)
        other = _Columns(np.arange(middle, begin - 2), begin - 1)
        return min(_divergence(rest, one, other), _divergence(rest, other, one))


@dataclass(frozen=True)
class _Columns:
    """Where root and mean of a hypothesis are in the normal equations."""

    root: Int64[np.ndarray, " k"]
    mean: int


def _divergence(
    normal: Float64[np.ndarray, "q q"], truth: _Columns, other: _Columns
) -> float:
    """Return E[log p(y | truth) − log p(y | other)] under the truth."""
    return _expect_log_likelihood(normal, truth, truth) - _expect_log_likelihood(
        normal, truth, other
    )


def _expect_log_likelihood(
    normal: Float64[np.ndarray, "q q"], truth: _Columns, model: _Columns
) -> float:
    """Return E[log p(y | model)] under the truth, up to a constant of all models.

    With y less the model's mean d + n, and its root's information S,
    log p = −½ |y − mean|² + ½ rᵀ (I + S)⁻¹ r − ½ log det (I + S).
    """
    z, w, mean, own = truth.root, model.root, truth.mean, model.mean
    off = normal[mean, mean] - 2.0 * normal[mean, own] + normal[own, own]
    misfit = float(off) + float(np.trace(normal[np.ix_(z, z)]))
    S = normal[np.ix_(w, w)]
    r = normal[w, mean] - normal[w, own]
    shared = normal[np.ix_(w, z)]
    spread = np.outer(r, r) + shared @ shared.T + S
    one = np.eye(len(S)) + S
    _, log_determinant = np.linalg.slogdet(one)
    fitted = float(np.trace(np.linalg.solve(one, spread)))
    return -0.5 * misfit + 0.5 * fitted - 0.5 * float(log_determinant)
