"""Simulated repetitions of the measurement, solved again (GUM Supplement 1).

A trial samples white and Ornstein–Uhlenbeck noise of every cell, jitter along the
travel, the precision of each error motion's prior, the shapes that only the prior
knows, and error motions between coarse knots. It solves again, and records the outputs.
The noise is made from its description alone, cell by cell in time, and not by the
algebra that weights it; precisions act in full, where the linear law takes them to
second order: so trials and linear law can contradict each other.

With H = D + Σ λₖKₖ, D the data's information on the machine's parameters, a trial is

    d = H(λ)⁻¹ (Qᵀε + Σ √(λₖKₖ) z − Σ (λₖ − λ̂ₖ) Kₖ θ̂),  θ = θ̂ + d:

a sample of the posterior if noise and prior are as specified.

Every block of trials has a separate seed: the answer depends neither on how many
workers share the blocks nor on where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.linalg import cho_factor, cho_solve

from truepath.alignment.observations.observations import Observations
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.knots import compute_hidden_variances
from truepath.estimation.problem.noise import NoiseModel, split_sigma_mm
from truepath.estimation.problem.normal_equations import RunInformation, combine_runs
from truepath.estimation.problem.prior import log_precision_variance
from truepath.numerics.adaptive_trials import (
    BLOCK,
    Interval,
    TrialBlock,
    TrialPlan,
    summarise,
)

_AT_ONCE = 500  # trials drawn together: their noise fits the memory of any computer
_SAME_PRECISION = 10  # trials that share a draw of precisions, and so one factorisation


@dataclass(frozen=True, slots=True)
class PriorBlock:
    """Prior of one error motion, or of known effects together.

    precision : (k, k) λ̂K of its parameters; root : (k, k) with root rootᵀ = precision
    log_sigma : standard deviation of log λ
    """

    first: int
    precision: Float64[np.ndarray, "k k"]
    root: Float64[np.ndarray, "k k"]
    log_sigma: float

    @property
    def part(self) -> slice:
        return slice(self.first, self.first + len(self.precision))


@dataclass(frozen=True, slots=True)
class TrialRun:
    """Inputs of trials from one Run.

    travel : (n, 3) its direction in the beam frame; weighted : (n, 3, m), Q
    """

    observations: Observations
    noise: NoiseModel
    travel: Float64[np.ndarray, "n 3"]
    weighted: Float32[np.ndarray, "n 3 m"]


@dataclass(frozen=True, slots=True)
class Trials:
    """All inputs of a block of trials; may be sent to another process.

    data : (m, m), D; theta : (m,), θ̂; outputs : (o, m)
    hidden_sigma : (m,) of error motions between coarse knots
    """

    runs: tuple[TrialRun, ...]
    data: Float64[np.ndarray, "m m"]
    theta: Float64[np.ndarray, " m"]
    prior: tuple[PriorBlock, ...]
    outputs: Float64[np.ndarray, "o m"]
    hidden_sigma: Float64[np.ndarray, " m"]
    seed: int
    interval: Interval


def prepare_trials(
    fit: Fit, outputs: Float64[np.ndarray, "o m"], plan: TrialPlan
) -> Trials:
    """Inputs of the trials of an estimate.

    outputs : (o, m), linear outputs of the machine's parameters
    """
    return Trials(
        tuple(_trial_run(run) for run in fit.runs),
        combine_runs(fit.runs).matrix,
        fit.result.theta,
        _split_prior(fit),
        outputs,
        np.sqrt(compute_hidden_variances(fit.model, fit.prior.precision)),
        plan.seed,
        plan.interval,
    )


def _trial_run(run: RunInformation) -> TrialRun:
    design = run.linearisation.build(run.observations)
    size = run.linearisation.machine_model.size
    weighted = design.weigh(design.whiten(run.noise), design.columns)
    # The pose is solved along: its share of the data is passed on.
    machine = weighted[:, :, :size] - weighted[:, :, size:] @ run.own.compute_coupling()
    return TrialRun(
        run.observations, run.noise, design.travel, machine.astype(np.float32)
    )


def run_block(trials: Trials, number: int) -> TrialBlock:
    """Summary of one block of trials: deviations of each output from its estimate."""
    return summarise(sample_outputs(trials, number, BLOCK), trials.interval)


def sample_outputs(
    trials: Trials, number: int, count: int
) -> Float64[np.ndarray, "o t"]:
    """Deviations of the outputs in the first `count` trials of a block."""
    seed = np.random.SeedSequence(trials.seed, spawn_key=(number,))
    rng = np.random.default_rng(seed)
    parts = [_sample_some(trials, rng) for _ in range(0, count, _AT_ONCE)]
    return np.concatenate(parts, axis=1)[:, :count]


def _split_prior(fit: Fit) -> tuple[PriorBlock, ...]:
    prior, blocks = fit.prior, list[PriorBlock]()
    for name, variance in log_precision_variance(prior, fit.result).items():
        precision = prior.precision[name] * prior.penalties[name].form
        value, vector = np.linalg.eigh(precision)
        root = vector * np.sqrt(np.maximum(value, 0.0))
        first = prior.model.slices[name].start
        blocks.append(PriorBlock(first, precision, root, float(np.sqrt(variance))))
    if fit.known.effects:
        precision = fit.known.precision_matrix()
        root = np.linalg.cholesky(precision)
        first = fit.known.locate(fit.model).start
        blocks.append(PriorBlock(first, precision, root, 0.0))
    return tuple(blocks)


def _sample_some(
    trials: Trials, rng: np.random.Generator
) -> Float64[np.ndarray, "o t"]:
    pulled = np.zeros((len(trials.theta), _AT_ONCE))
    for run in trials.runs:
        noise = _sample_white(run, rng) + _sample_ou(run, rng)
        pulled += np.tensordot(run.weighted, noise, axes=((0, 1), (0, 1)))
    moved = np.empty_like(pulled)
    for first in range(0, _AT_ONCE, _SAME_PRECISION):
        same = slice(first, first + _SAME_PRECISION)
        moved[:, same] = _solve_again(trials, pulled[:, same], rng)
    moved += trials.hidden_sigma[:, None] * rng.standard_normal(moved.shape)
    return trials.outputs @ moved


def _solve_again(
    trials: Trials, pulled: Float64[np.ndarray, "m t"], rng: np.random.Generator
) -> Float64[np.ndarray, "m t"]:
    H, right = trials.data.copy(order="F"), pulled.copy(order="F")
    for one in trials.prior:
        part = one.part
        times = float(np.exp(one.log_sigma * rng.standard_normal()))
        draw = rng.standard_normal((len(one.root), pulled.shape[1]))
        H[part, part] += times * one.precision
        right[part] += np.sqrt(times) * (one.root @ draw)
        right[part] -= (times - 1.0) * (one.precision @ trials.theta[part])[:, None]
    factor = cho_factor(H, lower=True, overwrite_a=True, check_finite=False)
    return cho_solve(factor, right, overwrite_b=True, check_finite=False)


def _sample_white(
    run: TrialRun, rng: np.random.Generator
) -> Float32[np.ndarray, "n 3 t"]:
    sigma, _ = split_sigma_mm(run.observations, run.noise)
    draw = _sample_normal(rng, *sigma.shape, _AT_ONCE)
    draw *= sigma[:, :, None].astype(np.float32)
    jitter_mm = run.noise.along_sigma_mm
    if 0.0 < jitter_mm < np.inf:
        jitter = _sample_normal(rng, len(sigma), 1, _AT_ONCE)
        draw += (jitter_mm * run.travel[:, :, None]).astype(np.float32) * jitter
    return draw


def _sample_ou(run: TrialRun, rng: np.random.Generator) -> Float32[np.ndarray, "n 3 t"]:
    _, sigma = split_sigma_mm(run.observations, run.noise)
    step = np.diff(run.observations.at.time_s, prepend=-np.inf)
    keep = np.exp(-step / run.noise.ou_time_s)
    fresh = np.sqrt(1.0 - keep**2)
    state = _sample_normal(rng, *sigma.shape, _AT_ONCE)
    state[1:] *= fresh[1:, None, None].astype(np.float32)
    for k in range(1, len(sigma)):
        state[k] += np.float32(keep[k]) * state[k - 1]
    state *= sigma[:, :, None].astype(np.float32)
    return state


def _sample_normal(rng: np.random.Generator, *shape: int) -> Float32[np.ndarray, "..."]:
    return rng.standard_normal(shape, dtype=np.float32)
