"""Standstills that a machine with typical errors cannot follow: single wrong points.

Precisions of the prior, noise and the direction of approach are learnt from all data,
wrong data included. One standstill that is 20 µm off lets error motions bend until it
fits, and then nothing contradicts it. A machine that bends as typical, and whose
direction of approach does not matter, cannot follow it: the standstill then shows a
separate shift (score test, Rao 1948), conditional on those of others.

Whether the machine is typical is unknown: standstills are excluded only if they also
contradict what is learnt without them. Lines have many cells, which show where one of
them is wrong.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.special import chdtri

from truepath.alignment.observations.observations import Observations
from truepath.estimation.checks.lack_of_fit import free_range_offset
from truepath.estimation.checks.score import compute_score
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.noise import NoiseModel, cap_correlated_noise
from truepath.estimation.problem.prior import guess_prior
from truepath.estimation.problem.runs import RunInput, collect_information
from truepath.numerics.scaled_cholesky import ScaledCholesky

_UNUSUAL = 0.1  # of the typical precision of bending
_FEW_CELLS = 1000  # fewer may be dominated by a few wrong ones
_RISK, _MARGIN = 0.003, 2.0  # of a clean measurement; noise has longer tails than χ²
_MOST = 0.1  # of the lines
_MEDIAN = 2.366  # of χ² of three


def is_doubtful(fit: Fit) -> bool:
    """True if wrong points may have bent the motions, or data are too few."""
    return bends_freely(fit) or fit.direction != "none"


def bends_freely(fit: Fit) -> bool:
    """True if error motions bend more than typical, or there are few cells."""
    usual, found = guess_prior(fit.model).precision, fit.prior.precision
    is_weak = any(found[name] < _UNUSUAL * usual[name] for name in usual)
    return is_weak or sum(len(run.observations) for run in fit.runs) < _FEW_CELLS


def fit_typical_machine(fit: Fit, effects: Collection[str]) -> Fit:
    """Data of a fit, solved again with the typical prior.

    effects : names of those kept, without the direction of approach
    """
    kept = tuple(effect for effect in fit.model.effects if effect.name in effects)
    model = replace(fit.model, effects=kept)
    runs = tuple(run.restrict(kept) for run in fit.found)
    return _solve(replace(fit, model=model, runs=runs, prior=guess_prior(model)))


def fit_as_learnt(fit: Fit, observed: Sequence[Observations]) -> Fit:
    """Solved with more data, while prior, noise and model stay as in the fit."""
    inputs = [
        RunInput(each, run.linearisation.pose, run.noise)
        for each, run in zip(observed, fit.runs, strict=True)
    ]
    return _solve(replace(fit, runs=collect_information(inputs, fit.model)))


def _solve(fit: Fit) -> Fit:
    precision = fit.prior.precision_matrix(fit.model.size)
    return replace(fit, result=compute_posterior(fit.data, precision))


def find_shifted_stops(fit: Fit, number: int) -> Bool[np.ndarray, " l"]:
    """Mask of the standstills, among all lines of a Run, that need a separate shift.

    The largest first, the others conditional on it; scaled by the median over the
    lines.
    """
    seen = fit.runs[number].observations
    moves = np.array([seen.at.line[first] >= 0 for first, _ in seen.lines])
    lines = len(moves)
    if moves.all():
        return np.zeros(lines, bool)
    left, raw, pulled = _list_shifts(fit, number)
    limit = _MARGIN * float(chdtri(3, _RISK / max(lines, 1)))
    found = np.zeros(lines, bool)
    own = np.arange(lines)
    for _ in range(int(_MOST * lines)):
        gain = np.sum(compute_score(left[own, :, own], raw, pulled)[1] ** 2, axis=1)
        scale = max(1.0, float(np.median(gain)) / _MEDIAN)
        gain[found | moves] = 0.0
        best = int(np.argmax(gain))
        if gain[best] < limit * scale:
            return found
        found[best] = True
        left, pulled = _give(left, pulled, best)
    return np.zeros(lines, bool)  # more than a few: no wrong points


def _give(
    left: Float64[np.ndarray, "l 3 l 3"], pulled: Float64[np.ndarray, "l 3"], one: int
) -> tuple[Float64[np.ndarray, "l 3 l 3"], Float64[np.ndarray, "l 3"]]:
    shared = left[:, :, one]
    share = shared @ np.linalg.pinv(left[one, :, one], hermitian=True)
    return (
        left - np.einsum("iab,jcb->iajc", share, shared),
        pulled - share @ pulled[one],
    )


def _list_shifts(
    fit: Fit, number: int
) -> tuple[
    Float64[np.ndarray, "l 3 l 3"],
    Float64[np.ndarray, "l 3 3"],
    Float64[np.ndarray, "l 3"],
]:
    """Remaining information on a shift of each line, information `raw` before
    elimination, and score. Noise is correlated within lines only.
    """
    about, known = free_range_offset(fit, number)
    size = about.machine_model.size
    shift = slice(size, size + 3)  # of the pose
    total = np.zeros((about.size, about.size + 1))
    total[:size, :size] += known.matrix
    total[:size, -1] += known.vector
    shared: list[Float64[np.ndarray, "p 3"]] = []
    pulled: list[Float64[np.ndarray, "3"]] = []
    for line in _cut(about, fit.runs[number].observations):
        products = _multiply(line, cap_correlated_noise(about.noise))
        total += products
        shared.append(products[:, shift])
        pulled.append(products[shift, -1])
    factor = ScaledCholesky.of(total[:, :-1])
    theta = factor.solve(total[:, -1])
    pull = np.array(pulled) - np.einsum("lps,p->ls", np.array(shared), theta)
    columns = np.concatenate(shared, axis=1)
    left = -(columns.T @ factor.solve(columns)).reshape(len(pull), 3, len(pull), 3)
    own, raw = np.arange(len(pull)), np.array(shared)[:, shift]
    left[own, :, own] += raw
    return left, raw, pull


def _cut(about: Linearisation, seen: Observations) -> Iterator[DesignMatrix]:
    for design in about.split(seen):
        timing = slice(design.fixed + 1, None)
        for first, last in design.observations.lines:
            rows = design.rows[first:last]
            kept = np.ones(rows.shape[2], bool)
            kept[timing] = rows[:, :, timing].any(axis=(0, 1))
            yield replace(
                design,
                observations=design.observations.select(np.arange(first, last)),
                frame=design.frame[first:last],
                rows=rows[:, :, kept],
            )


def _multiply(line: DesignMatrix, noise: NoiseModel) -> Float64[np.ndarray, "p q"]:
    every = np.concatenate([line.columns, line.residual[:, :, None]], axis=2)
    whitener = line.whiten(noise)
    timing, weighted = line.fit_timing(whitener, every)
    free = whitener.apply(every) - weighted @ timing
    return np.tensordot(line.columns, free, axes=((0, 1), (0, 1)))
