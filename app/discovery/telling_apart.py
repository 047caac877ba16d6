"""How well lines not yet driven would tell two explanations apart.

Each explanation is a Gaussian over machine and effects, as the Runs so far leave it, so
that what the base can absorb is absorbed by both. Lines that would give the data y have
the log Bayes factor log p(y | a) − log p(y | b); expected under a, it is the divergence
of the two predictions, and never below 0 (Kullback & Leibler 1951). The tracker's new
place and the timing of each line are integrated out, as in the decision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from app.discovery.explaining import Explanation
from app.discovery.sums import Lines
from app.discovery.view import Base, View
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import USUAL_MM

_POSE = 6
_HARDLY_MM = 3e-5  # displacements of which what is unknown is left aside


@dataclass(frozen=True)
class Belief:
    """Machine and effects of an explanation: mean + root z, z standard normal.

    mean : (p,); root : (p, k)
    """

    effects: tuple[Effect, ...]
    mean: Float64[np.ndarray, " p"]
    root: Float64[np.ndarray, "p k"]


def belief_of(explanation: Explanation, machine: Float64[np.ndarray, "m m"]) -> Belief:
    """Return what an explanation believes of all Runs to come.

    machine : its Gram matrix: θᵀGθ is the mean square of its displacements, mm²

    With C = A Aᵀ, the eigenvectors of Aᵀ G A are the shapes of what is unknown, by how
    far each displaces; the few that matter are kept.
    """
    size, fit, offers = len(machine), explanation.fit, explanation.chosen
    keep = np.r_[np.arange(size), np.arange(explanation.base_size, len(fit.theta))]
    covariance = fit.covariance[np.ix_(keep, keep)]
    own = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / own[:, None] / own)
    half = own[:, None] * vector * np.sqrt(np.maximum(value, 0.0))
    gram = np.zeros_like(covariance)
    gram[:size, :size] = machine
    usual = np.concatenate([np.zeros(0), *(o.candidate.usual for o in offers)])
    more = np.arange(size, len(gram))
    gram[more, more] = (USUAL_MM / usual) ** 2
    square, shape = np.linalg.eigh(half.T @ gram @ half)
    root = half @ shape[:, square > _HARDLY_MM**2]
    return Belief(tuple(o.effect for o in offers), fit.theta[keep], root)


@dataclass(frozen=True)
class Question:
    """Two explanations of the same Runs.

    left, right : in words, the right one empty where the question is whether or not
    base : of the next Run, its pose the last of `runs`
    """

    left: str
    right: str
    one: Belief
    other: Belief
    base: Base

    @property
    def size(self) -> int:
        """Columns of `sums`: both roots, both means, the next Run's pose."""
        return self.one.root.shape[1] + self.other.root.shape[1] + 2 + _POSE

    def sums(self, view: View) -> Float64[np.ndarray, "q q"]:
        """Return what lines would tell, timing left out; those of several lines add."""
        effects = (*self.one.effects, *self.other.effects)
        total = Lines([view], 1).sums(effects).total()[:-1, :-1]
        columns = self._columns(len(total))
        return columns.T @ total @ columns

    def log_bayes(
        self, sums: Float64[np.ndarray, "q q"], pose_sigma: tuple[float, float]
    ) -> float:
        """Return the log Bayes factor expected for the truth, if that is the harder.

        pose_sigma : how well the next place of the tracker is known, mm and rad
        """
        known = np.diag(np.repeat(np.array(pose_sigma) ** -2.0, 3))
        begin = len(sums) - _POSE
        cross = sums[begin:, :begin]
        pull = np.linalg.solve(sums[begin:, begin:] + known, cross)
        told = sums[:begin, :begin] - cross.T @ pull
        middle = int(self.one.root.shape[1])
        one = _Columns(np.arange(middle), begin - 2)
        other = _Columns(np.arange(middle, begin - 2), begin - 1)
        return min(_divergence(told, one, other), _divergence(told, other, one))

    def _columns(self, size: int) -> Float64[np.ndarray, "t q"]:
        """Return the map from roots, means and pose to machine, poses, effects."""
        machine = self.base.model.size
        first = machine + _POSE * self.base.runs
        split = first + len(self.one.mean) - machine
        middle, end = self.one.root.shape[1], self.size - _POSE - 2
        columns = np.zeros((size, self.size))
        for belief, effects, roots, mean in (
            (self.one, np.arange(first, split), slice(0, middle), end),
            (self.other, np.arange(split, size), slice(middle, end), end + 1),
        ):
            rows = np.r_[np.arange(machine), effects]
            columns[rows, roots] = belief.root
            columns[rows, mean] = belief.mean
        columns[first - _POSE : first, end + 2 :] = np.eye(_POSE)
        return columns


@dataclass(frozen=True)
class _Columns:
    """Where root and mean of a belief lie in the sums."""

    root: Int64[np.ndarray, " k"]
    mean: int


def _divergence(
    told: Float64[np.ndarray, "q q"], truth: _Columns, other: _Columns
) -> float:
    """Return E[log p(y | truth) − log p(y | other)] under the truth."""
    return _score(told, truth, truth) - _score(told, truth, other)


def _score(told: Float64[np.ndarray, "q q"], truth: _Columns, model: _Columns) -> float:
    """Return E[log p(y | model)] under the truth, up to what all models share.

    With y less the model's mean d + n, and its roots' information S,
    log p = −½ |y − mean|² + ½ rᵀ (I + S)⁻¹ r − ½ log det (I + S).
    """
    z, w, mean, own = truth.root, model.root, truth.mean, model.mean
    off = told[mean, mean] - 2.0 * told[mean, own] + told[own, own]
    misfit = float(off) + float(np.trace(told[np.ix_(z, z)]))
    S = told[np.ix_(w, w)]
    r = told[w, mean] - told[w, own]
    pulled = told[np.ix_(w, z)]
    spread = np.outer(r, r) + pulled @ pulled.T + S
    one = np.eye(len(S)) + S
    _, log_determinant = np.linalg.slogdet(one)
    taken = float(np.trace(np.linalg.solve(one, spread)))
    return -0.5 * misfit + 0.5 * taken - 0.5 * float(log_determinant)
