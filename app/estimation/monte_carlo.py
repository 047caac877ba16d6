"""Trials of the measurement: what it could have been, solved again (GUM Supplement 1).

A trial draws white and Ornstein–Uhlenbeck noise of every cell, jitter along the travel,
how strongly the prior charges each error motion, and the shapes that only the prior
knows. It solves again, and keeps what the outputs do. The noise is made from its
description alone, cell by cell in time, and not by the algebra that weighs it;
precisions act in full, where the linear law takes them to second order: so trials and
linear law can contradict each other.

With H = D + Σ λₖKₖ, D the data's information on the machine's parameters, a trial is

    d = H(λ)⁻¹ (Qᵀε + Σ √(λₖKₖ) z − Σ (λₖ − λ̂ₖ) Kₖ θ̂),  θ = θ̂ + d:

a draw of the posterior where noise and prior are what they are said to be.

Every block of trials has a seed of its own: the answer depends neither on how many
workers share the blocks nor on where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.linalg import cho_factor, cho_solve

from app.alignment.observations import Observations
from app.estimation.direction import Fit
from app.estimation.noise import NoiseModel, whiten
from app.estimation.prior import log_precision_variance
from app.estimation.problem import Part
from app.estimation.runs import Share, together
from app.numerics.adaptive_trials import BLOCK, Interval, TrialBlock, TrialPlan, kept

_AT_ONCE = 500  # trials drawn together: their noise fits the memory of any computer
_SAME_PRECISION = 10  # trials that share a draw of precisions, and so one factorisation


@dataclass(frozen=True, slots=True)
class Charged:
    """What the prior charges one error motion, or knows of effects together.

    precision : (k, k) λ̂K of its parameters; root : (k, k) with root rootᵀ = precision
    log_sigma : standard deviation of log λ
    """

    first: int
    precision: Float64[np.ndarray, "k k"]
    root: Float64[np.ndarray, "k k"]
    log_sigma: float

    @property
    def part(self) -> slice:
        """Where its parameters are."""
        return slice(self.first, self.first + len(self.precision))


@dataclass(frozen=True, slots=True)
class TrialRun:
    """What trials need of one Run.

    frame : (n, 3, 3) workpiece to beam frame; weighted : (n, 3, m), Q
    """

    seen: Observations
    noise: NoiseModel
    frame: Float64[np.ndarray, "n 3 3"]
    weighted: Float32[np.ndarray, "n 3 m"]


@dataclass(frozen=True, slots=True)
class Trials:
    """Everything that a block of trials needs; may be sent to another process.

    data : (m, m), D; theta : (m,), θ̂; outputs : (o, m)
    """

    runs: tuple[TrialRun, ...]
    data: Float64[np.ndarray, "m m"]
    theta: Float64[np.ndarray, " m"]
    charged: tuple[Charged, ...]
    outputs: Float64[np.ndarray, "o m"]
    seed: int
    interval: Interval


def prepared(fit: Fit, outputs: Float64[np.ndarray, "o m"], plan: TrialPlan) -> Trials:
    """Return the trials of an estimate.

    outputs : (o, m), linear outputs of the machine's parameters
    """
    return Trials(
        tuple(_trial_run(share) for share in fit.shares),
        together(fit.shares).matrix,
        fit.result.theta,
        _charged(fit),
        outputs,
        plan.seed,
        plan.interval,
    )


def _trial_run(share: Share) -> TrialRun:
    problem, size = share.problem, share.problem.machine_model.size
    part = problem.part(problem.seen)
    weighted = _weighted(part, share.noise)
    # The pose is solved along: its share of the data is passed on.
    machine = weighted[:, :, :size] - weighted[:, :, size:] @ share.own_per_machine
    return TrialRun(problem.seen, share.noise, part.frame, machine.astype(np.float32))


def _weighted(part: Part, noise: NoiseModel) -> Float64[np.ndarray, "n 3 p"]:
    """Return V⁻¹A of machine and pose, less what the timing of the lines takes up."""
    known, timing = part.rows[:, :, : part.data], part.timing
    V = whiten(part.seen, noise, part.frame)
    weighted = V.applied(known)
    if not timing.size:
        return weighted
    told = V.applied(timing)
    H = np.tensordot(told, timing, axes=((0, 1), (0, 1)))
    taken = np.tensordot(told, known, axes=((0, 1), (0, 1)))
    return weighted - told @ np.linalg.lstsq(H, taken, rcond=None)[0]


def block(trials: Trials, number: int) -> TrialBlock:
    """Draw one block of trials: how far each output moves from its estimate."""
    return kept(drawn(trials, number, BLOCK), trials.interval)


def drawn(trials: Trials, number: int, count: int) -> Float64[np.ndarray, "o t"]:
    """Return how far the outputs move in the first trials of a block."""
    seed = np.random.SeedSequence(trials.seed, spawn_key=(number,))
    rng = np.random.default_rng(seed)
    parts = [_some(trials, rng) for _ in range(0, count, _AT_ONCE)]
    return np.concatenate(parts, axis=1)[:, :count]


def _charged(fit: Fit) -> tuple[Charged, ...]:
    prior, charged = fit.prior, list[Charged]()
    for name, variance in log_precision_variance(prior, fit.result).items():
        precision = prior.precision[name] * prior.charges[name].form
        value, vector = np.linalg.eigh(precision)
        root = vector * np.sqrt(np.maximum(value, 0.0))
        first = prior.model.slices[name].start
        charged.append(Charged(first, precision, root, float(np.sqrt(variance))))
    if fit.known.effects:
        precision = fit.known.precision_matrix()
        root = np.linalg.cholesky(precision)
        first = fit.known.part(fit.model).start
        charged.append(Charged(first, precision, root, 0.0))
    return tuple(charged)


def _some(trials: Trials, rng: np.random.Generator) -> Float64[np.ndarray, "o t"]:
    pulled = np.zeros((len(trials.theta), _AT_ONCE))
    for run in trials.runs:
        noise = _white(run, rng) + _slow(run, rng)
        pulled += np.tensordot(run.weighted, noise, axes=((0, 1), (0, 1)))
    moved = np.empty_like(pulled)
    for first in range(0, _AT_ONCE, _SAME_PRECISION):
        same = slice(first, first + _SAME_PRECISION)
        moved[:, same] = _solved(trials, pulled[:, same], rng)
    return trials.outputs @ moved


def _solved(
    trials: Trials, pulled: Float64[np.ndarray, "m t"], rng: np.random.Generator
) -> Float64[np.ndarray, "m t"]:
    """Solve trials again under precisions drawn for them."""
    H, right = trials.data.copy(order="F"), pulled.copy(order="F")
    for one in trials.charged:
        part = one.part
        times = float(np.exp(one.log_sigma * rng.standard_normal()))
        draw = rng.standard_normal((len(one.root), pulled.shape[1]))
        H[part, part] += times * one.precision
        right[part] += np.sqrt(times) * (one.root @ draw)
        right[part] -= (times - 1.0) * (one.precision @ trials.theta[part])[:, None]
    factor = cho_factor(H, lower=True, overwrite_a=True, check_finite=False)
    return cho_solve(factor, right, overwrite_b=True, check_finite=False)


def _white(run: TrialRun, rng: np.random.Generator) -> Float32[np.ndarray, "n 3 t"]:
    """Draw the mean of the samples' white noise, and the jitter of the feed."""
    seen, noise = run.seen, run.noise
    sigma = _stated_mm(seen) * np.array(
        [noise.white[0], noise.white[1], noise.white[1]]
    )
    sigma /= np.sqrt(seen.count)[:, None]
    draw = _normal(rng, *sigma.shape, _AT_ONCE)
    draw *= sigma[:, :, None].astype(np.float32)
    if 0.0 < noise.along_sigma_mm < np.inf:
        along = np.einsum("nij,nj->ni", run.frame, seen.direction)
        jitter = _normal(rng, len(seen), 1, _AT_ONCE)
        draw += (noise.along_sigma_mm * along[:, :, None]).astype(np.float32) * jitter
    return draw


def _slow(run: TrialRun, rng: np.random.Generator) -> Float32[np.ndarray, "n 3 t"]:
    """Draw the Ornstein–Uhlenbeck noise step by step, from cell to cell."""
    seen, noise = run.seen, run.noise
    sigma = _stated_mm(seen) * np.array([noise.ou[0], noise.ou[1], noise.ou[1]])
    keep = np.exp(-np.diff(seen.at.time_s, prepend=-np.inf) / noise.ou_time_s)
    fresh = np.sqrt(1.0 - keep**2)
    state = _normal(rng, len(seen), 3, _AT_ONCE)
    state[1:] *= fresh[1:, None, None].astype(np.float32)
    for k in range(1, len(seen)):
        state[k] += np.float32(keep[k]) * state[k - 1]
    state *= sigma[:, :, None].astype(np.float32)
    return state


def _normal(rng: np.random.Generator, *shape: int) -> Float32[np.ndarray, "..."]:
    return rng.standard_normal(shape, dtype=np.float32)


def _stated_mm(seen: Observations) -> Float64[np.ndarray, "n 3"]:
    tracker = seen.at.machine.tracker
    return tracker.sigma_mm(np.linalg.norm(seen.tracker_mm, axis=1))[:, [0, 1, 1]]
