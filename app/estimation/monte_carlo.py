"""Propagation of distributions by Monte Carlo (GUM Supplement 1).

A trial draws what the measurement could have been: white and slow noise of every cell,
jitter along the travel, and the shapes that only the prior knows. It solves again, and
keeps what the outputs do. The noise is made from its description alone, cell by
cell in time, and not by the algebra that weighs it: so trials and linear law can
contradict each other.

Blocks of trials have seeds of their own, so that the answer does not depend on how many
processes share the work. Blocks are added until the standard deviations stand still to
half a unit of their second digit (clause 7.9), or to one part in a hundred.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from app.alignment.observations import Observations
from app.estimation.direction import Fit
from app.estimation.noise import NoiseModel, whiten
from app.estimation.volumetric_map import volumetric_map
from app.kinematics.effects.base import standstill

BLOCK = 1000  # trials
_FEWEST, _MOST = 4, 60  # blocks
_COVERED = 0.95
_GRID = 3  # points an axis, ends included


@dataclass(frozen=True)
class Trials:
    """Everything that a block of trials needs; may be sent to another process.

    weighted : (n, 3, p) V⁻¹A; frame : (n, 3, 3); gain : (o, p) outputs per (AᵀV⁻¹y)
    root : (p, p), root of the prior precision
    """

    seen: Observations
    noise: NoiseModel
    frame: Float64[np.ndarray, "n 3 3"]
    weighted: Float64[np.ndarray, "n 3 p"]
    gain: Float64[np.ndarray, "o p"]
    root: Float64[np.ndarray, "p p"]
    seed: int


@dataclass(frozen=True, slots=True)
class Propagated:
    """What the trials say of the outputs, and what the linear law says.

    position_mm : (q, axes) where the volumetric error was asked for; its components,
        point by point, are the o outputs
    sigma, linear : (o,) standard deviations in mm
    low, high : (o,) ends of the shortest symmetric 95 % interval about the estimate
    settled : the standard deviations stood still before the trials ran out
    """

    position_mm: Float64[np.ndarray, "q a"]
    trials: int
    seed: int
    sigma: Float64[np.ndarray, " o"]
    linear: Float64[np.ndarray, " o"]
    low: Float64[np.ndarray, " o"]
    high: Float64[np.ndarray, " o"]
    settled: bool

    @property
    def disagreement(self) -> float:
        """Largest relative difference of both standard deviations."""
        return float(np.max(np.abs(self.sigma / self.linear - 1.0)))


Block = NDArray[np.float64]
"""(o, t): how far each of the outputs moves in each trial of a block."""
Mapper = Callable[[Callable[[int], Block], Sequence[int]], Iterable[Block]]
"""Computes a function of block numbers, in this process or in others."""


def volume_by_trials(
    fit: Fit, noise: NoiseModel, *, seed: int = 1, run: Mapper = map
) -> Propagated:
    """Return what trials make of the volumetric error on a grid over the travel."""
    machine = fit.problem.machine_model
    ticks = [
        np.linspace(a.min_mm, a.max_mm, _GRID) for a in machine.machine.linear_axes
    ]
    grid = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(ticks))
    J = volumetric_map(machine).jacobian(standstill(machine.machine, grid))
    outputs = J.reshape(-1, machine.size)
    covariance = fit.result.covariance[: machine.size, : machine.size]
    linear = np.sqrt(np.einsum("om,om->o", outputs @ covariance, outputs))
    return propagate(prepared(fit, noise, outputs, seed), grid, linear, run)


def prepared(
    fit: Fit, noise: NoiseModel, outputs: Float64[np.ndarray, "o m"], seed: int
) -> Trials:
    """Return the trials of an estimate.

    outputs : (o, m), linear outputs of the machine's parameters
    """
    problem = fit.problem
    A = problem.rows[:, :, :-1]
    weighted = whiten(problem.seen, noise, problem.frame).applied(A)
    size = problem.model.size
    padded = np.zeros((len(outputs), size))
    padded[:, : outputs.shape[1]] = outputs
    gain = padded @ fit.result.covariance
    value, vector = np.linalg.eigh(fit.prior.precision(size))
    root = vector * np.sqrt(np.maximum(value, 0.0))
    return Trials(problem.seen, noise, problem.frame, weighted, gain, root, seed)


def block(trials: Trials, number: int) -> Block:
    """Return how far the outputs move in each trial of one block."""
    rng = np.random.default_rng(
        np.random.SeedSequence(trials.seed, spawn_key=(number,))
    )
    pulled = np.zeros((trials.weighted.shape[2], BLOCK))
    _add_white(pulled, trials, rng)
    _add_slow(pulled, trials, rng)
    pulled += trials.root @ rng.standard_normal((len(pulled), BLOCK))
    return trials.gain @ pulled


def propagate(
    trials: Trials,
    position_mm: Float64[np.ndarray, "q a"],
    linear: Float64[np.ndarray, " o"],
    run: Mapper = map,
) -> Propagated:
    """Add blocks until the standard deviations stand still, or there are enough.

    linear : (o,) standard deviations by the linear law, to set the tolerance
    """
    digit = 10.0 ** np.floor(np.log10(np.maximum(linear, 1e-300)))
    tolerance = np.maximum(0.05 * digit, 0.01 * linear)
    done: list[Block] = []
    settled = False
    while len(done) < _MOST and not settled:
        first = len(done)
        last = min(_MOST, max(_FEWEST, 2 * first))
        numbers = range(first, last)
        done += run(partial(block, trials), numbers)
        spread = np.array([part.std(axis=1) for part in done])
        unsure = 2.0 * spread.std(axis=0, ddof=1) / np.sqrt(len(done))
        settled = bool((unsure < tolerance).all())
    every = np.concatenate(done, axis=1)
    ends = np.quantile(every, [(1 - _COVERED) / 2, (1 + _COVERED) / 2], axis=1)
    return Propagated(
        position_mm,
        every.shape[1],
        trials.seed,
        every.std(axis=1),
        linear,
        ends[0],
        ends[1],
        settled,
    )


def _add_white(
    pulled: Float64[np.ndarray, "p t"], trials: Trials, rng: np.random.Generator
) -> None:
    """Draw the mean of the samples' white noise, and the jitter of the feed."""
    seen, noise = trials.seen, trials.noise
    sigma = _stated_mm(seen) * np.array(
        [noise.white[0], noise.white[1], noise.white[1]]
    )
    sigma /= np.sqrt(seen.count)[:, None]
    draw = rng.standard_normal((*sigma.shape, pulled.shape[1])) * sigma[:, :, None]
    if 0.0 < noise.along_sigma_mm < np.inf:
        along = np.einsum("nij,nj->ni", trials.frame, seen.direction)
        jitter = rng.standard_normal((len(seen), pulled.shape[1]))
        draw += noise.along_sigma_mm * along[:, :, None] * jitter[:, None, :]
    pulled += np.tensordot(trials.weighted, draw, axes=((0, 1), (0, 1)))


def _add_slow(
    pulled: Float64[np.ndarray, "p t"], trials: Trials, rng: np.random.Generator
) -> None:
    """Draw the slow noise as it runs: each cell remembers the one before."""
    seen, noise = trials.seen, trials.noise
    sigma = _stated_mm(seen) * np.array([noise.slow[0], noise.slow[1], noise.slow[1]])
    keep = np.exp(-np.diff(seen.at.time_s, prepend=-np.inf) / noise.slow_time_s)
    fresh = np.sqrt(1.0 - keep**2)
    state = np.zeros((3, pulled.shape[1]))
    drawn = np.empty((len(seen), 3, pulled.shape[1]), np.float32)
    for k in range(len(seen)):
        state = keep[k] * state + fresh[k] * rng.standard_normal(state.shape)
        drawn[k] = sigma[k, :, None] * state
    pulled += np.tensordot(trials.weighted, drawn, axes=((0, 1), (0, 1)))


def _stated_mm(seen: Observations) -> Float64[np.ndarray, "n 3"]:
    tracker = seen.at.machine.tracker
    return tracker.sigma_mm(np.linalg.norm(seen.tracker_mm, axis=1))[:, [0, 1, 1]]
