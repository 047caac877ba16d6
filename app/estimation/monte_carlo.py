"""Trials of the measurement: what it could have been, solved again (GUM Supplement 1).

A trial draws white and slow noise of every cell, jitter along the travel, and the
shapes that only the prior knows. It solves again, and keeps what the outputs do. The
noise is made from its description alone, cell by cell in time, and not by the algebra
that weighs it: so trials and linear law can contradict each other.

Every block of trials has a seed of its own: the answer depends neither on how many
workers share the blocks nor on where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from app.alignment.observations import Observations
from app.estimation.direction import Fit
from app.estimation.noise import NoiseModel, whiten
from app.numerics.adaptive_trials import BLOCK, Interval, TrialBlock, TrialPlan, kept

_AT_ONCE = 500  # trials drawn together: their noise fits the memory of any computer


@dataclass(frozen=True, slots=True)
class Trials:
    """Everything that a block of trials needs; may be sent to another process.

    weighted : (n, 3, p) V⁻¹A; frame : (n, 3, 3); gain : (o, p) outputs per (AᵀV⁻¹y)
    root : (p, p), root of the prior precision
    """

    seen: Observations
    noise: NoiseModel
    frame: Float64[np.ndarray, "n 3 3"]
    weighted: Float32[np.ndarray, "n 3 p"]
    gain: Float64[np.ndarray, "o p"]
    root: Float64[np.ndarray, "p p"]
    seed: int
    interval: Interval


def prepared(
    fit: Fit, noise: NoiseModel, outputs: Float64[np.ndarray, "o m"], plan: TrialPlan
) -> Trials:
    """Return the trials of an estimate.

    outputs : (o, m), linear outputs of the machine's parameters
    """
    problem = fit.problem
    A = problem.rows[:, :, :-1]
    weighted = whiten(problem.seen, noise, problem.frame).applied(A)
    size = problem.model.size
    gain = outputs @ fit.result.covariance[: outputs.shape[1]]
    value, vector = np.linalg.eigh(fit.prior.precision(size))
    root = vector * np.sqrt(np.maximum(value, 0.0))
    return Trials(
        problem.seen,
        noise,
        problem.frame,
        weighted.astype(np.float32),
        gain,
        root,
        plan.seed,
        plan.interval,
    )


def block(trials: Trials, number: int) -> TrialBlock:
    """Draw one block of trials: how far each output moves from its estimate."""
    return kept(drawn(trials, number, BLOCK), trials.interval)


def drawn(trials: Trials, number: int, count: int) -> Float64[np.ndarray, "o t"]:
    """Return how far the outputs move in the first trials of a block."""
    seed = np.random.SeedSequence(trials.seed, spawn_key=(number,))
    rng = np.random.default_rng(seed)
    parts = [_some(trials, rng) for _ in range(0, count, _AT_ONCE)]
    return np.concatenate(parts, axis=1)[:, :count]


def _some(trials: Trials, rng: np.random.Generator) -> Float64[np.ndarray, "o t"]:
    noise = _white(trials, rng) + _slow(trials, rng)
    pulled = np.tensordot(trials.weighted, noise, axes=((0, 1), (0, 1)))
    prior = trials.root @ rng.standard_normal((len(trials.root), _AT_ONCE))
    return trials.gain @ (pulled + prior)


def _white(trials: Trials, rng: np.random.Generator) -> Float32[np.ndarray, "n 3 t"]:
    """Draw the mean of the samples' white noise, and the jitter of the feed."""
    seen, noise = trials.seen, trials.noise
    sigma = _stated_mm(seen) * np.array(
        [noise.white[0], noise.white[1], noise.white[1]]
    )
    sigma /= np.sqrt(seen.count)[:, None]
    draw = _normal(rng, *sigma.shape, _AT_ONCE)
    draw *= sigma[:, :, None].astype(np.float32)
    if 0.0 < noise.along_sigma_mm < np.inf:
        along = np.einsum("nij,nj->ni", trials.frame, seen.direction)
        jitter = _normal(rng, len(seen), 1, _AT_ONCE)
        draw += (noise.along_sigma_mm * along[:, :, None]).astype(np.float32) * jitter
    return draw


def _slow(trials: Trials, rng: np.random.Generator) -> Float32[np.ndarray, "n 3 t"]:
    """Draw the slow noise as it runs: each cell remembers the one before."""
    seen, noise = trials.seen, trials.noise
    sigma = _stated_mm(seen) * np.array([noise.slow[0], noise.slow[1], noise.slow[1]])
    keep = np.exp(-np.diff(seen.at.time_s, prepend=-np.inf) / noise.slow_time_s)
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
