"""Estimate the noise of every Run from the Runs themselves.

500 Hz samples are correlated in time; treating them as independent gives intervals that
contain the truth far too rarely. The white part is the scatter of samples about their
cell. The Ornstein–Uhlenbeck part, its correlation time and the jitter of the feed
maximise the evidence of the whole problem, so that what the error motions absorb is
accounted for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree
from scipy.special import chdtri

from truepath.alignment.observations.observations import Observations
from truepath.estimation.noise.noise_evidence import NoiseEvidence, Slope
from truepath.estimation.problem.confounded_prior import guess_whole_prior
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.information import Information, add_information
from truepath.estimation.problem.known_effects import KnownEffects
from truepath.estimation.problem.noise import NoiseModel, split_sigma_mm
from truepath.estimation.problem.prior import BendingPrior
from truepath.estimation.problem.runs import (
    RunInformation,
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.kinematics.model import MachineModel

_MERGED_S = 0.25  # longer: the correlated noise changes within a merged cell
_FEWEST_OF_LINE = 4  # merged cells
_CELLS = 1000  # enough for the noise to a few percent
_FEWEST_ROWS = 24
_SWEEPS = 2  # over several Runs
_JITTER_FLOOR_MM = 2e-5  # far below any tracker's noise: no jitter
# Few data hardly determine the Ornstein–Uhlenbeck part; most trackers in most halls are
# like this.
_USUAL = np.log([0.15, 0.15, 0.15, 1.0])  # three relative sizes, time in s
_USUAL_SPREAD = 1.2
_STEPS = 12
_SETTLED = 0.1  # of −2 log evidence, which a deviation of a tenth of a sigma costs
_STIFFEST = 4.0  # times as curved as the average information
_LONGEST, _SHORTEST = 1.5, 0.02  # of a step, in logarithms
_SAME = 1e-6  # phase and speed of a line of one cell are the same
_LEAST = 1e-3  # curvature of undetermined parameters, such as zero jitter
_LONGEST_S = 60.0
_FEWEST_TRIPLES = 100
_MEDIAN = 0.455  # of χ² of one
_FAST = 1.2  # ratio of the scatter of means to that of samples
_LOW = 0.3  # quantile of differences
_NEIGHBOURS = 40
_BOUNDS = np.log([*[[1e-3, 30.0]] * 3, [0.02, _LONGEST_S], [_JITTER_FLOOR_MM, 0.1]])


def guess_noise(observations: Observations, *, perpendicular_only: bool) -> NoiseModel:
    """Starting values: scatter of this Run, a typical correlated part."""
    white = (float(observations.scatter[0]), float(observations.scatter[1]))
    is_timed = any(p.is_steady for p in observations.passes)
    along = 2e-4 if is_timed and not perpendicular_only else np.inf
    return NoiseModel(white, (0.1, 0.1, 0.1), 1.0, along)


def refine_runs(
    model: MachineModel,
    runs: Sequence[RunInput],
    known: KnownEffects | None = None,
    *,
    longest_s: float = _LONGEST_S,
) -> tuple[RunInput, ...]:
    """Runs with a refined pose and the noise of greatest evidence.

    model : coarse, with everything that must not be absorbed by Ornstein–Uhlenbeck
        noise
    known : effects of the machine known from an earlier measurement
    longest_s : correlation time; slower changes are structure, not noise

    The initial pose includes the machine's errors. Every Run has separate noise; all
    Runs determine the error motions. A selection of lines and coarse splines determine
    both well, at a fraction of the cost.

    Raises Unidentifiable if the lines do not determine the parameters.
    """
    known = known or KnownEffects()
    few = [
        replace(r, observations=_select_lines(_leave_out_ramps(r.observations)))
        for r in runs
    ]
    found = list(collect_information(few, model))
    data = known.add_to(combine_runs(found), model)
    prior, result = guess_whole_prior(model).fit(data)
    # The noise of one Run shifts the error motions that the others determine.
    for k in [*range(len(runs))] * min(len(runs), _SWEEPS):
        others = found[:k] + found[k + 1 :]
        noise = _fit_noise(found[k], prior, others, known, longest_s)
        if len(runs) > 1:
            found[k] = found[k].replace_noise(noise)
        else:
            about = replace(found[k].linearisation, noise=noise)
            found[k] = replace(found[k], linearisation=about)
    return tuple(
        RunInput(
            run.observations,
            one.linearisation.correct_pose(one.own.restore(result)[0]),
            one.noise,
        )
        for run, one in zip(runs, found, strict=True)
    )


def _fit_noise(
    run: RunInformation,
    prior: BendingPrior,
    others: Sequence[RunInformation],
    effects: KnownEffects,
    longest_s: float,
) -> NoiseModel:
    design = _merge_design(run.observations, run.linearisation)
    charged = Information.of_matrix(prior.precision_matrix(prior.model.size))
    before = effects.add_to(charged, prior.model)
    known = add_information([before, *(other.own.eliminate() for other in others)])
    columns = _select_independent(design)
    evidence = NoiseEvidence(design, columns, design.residual, known)
    noise = _maximise(evidence, run.noise, longest_s)
    about, seen = run.linearisation, run.observations
    theta = evidence.solve(noise)[: design.fixed]
    rest = about.build(seen, solved=theta).residual
    louder = _raise_fast(seen, noise, rest)
    if louder is not None:
        noise = _maximise(evidence, louder, longest_s)
    rest = design.residual - evidence.columns @ evidence.solve(noise)
    return replace(noise, shown=_find_shown(design.observations, noise, rest))


def _raise_fast(
    seen: Observations, noise: NoiseModel, rest: Float64[np.ndarray, "n 3"]
) -> NoiseModel | None:
    """Noise with its fast part raised; None if there is none.

    Samples scatter less than their means where noise lasts for some samples: a
    vibration of some hertz. Second differences of neighbours show it; slow noise hardly
    affects them.
    """
    time_s, before = seen.at.time_s, np.array(noise.fast)
    sigma, ou = split_sigma_mm(seen, replace(noise, ramp_sigma_mm=0.0))
    middle = [np.arange(a + 1, b - 1) for a, b in seen.stretches if b - a > 2]
    k = np.concatenate(middle) if middle else np.zeros(0, np.int64)
    k = k[~seen.is_ramp[k]]
    if len(k) < _FEWEST_TRIPLES:
        return None
    found = (rest[k - 1] - 2.0 * rest[k] + rest[k + 1]) ** 2
    keep = np.exp(-(time_s[k + 1] - time_s[k - 1]) / 2.0 / noise.ou_time_s)[:, None]
    slow = 2.0 * ou[k] ** 2 * (3.0 - 4.0 * keep + keep**2)
    fast = 4.0 * sigma[k] ** 2 + sigma[k - 1] ** 2 + sigma[k + 1] ** 2
    times = np.median((found - _MEDIAN * slow) / (_MEDIAN * fast), axis=0)
    times = np.maximum(times, 0.0)
    raised = np.sqrt([times[0], 0.5 * (times[1] + times[2])])
    if not (raised > _FAST).any():
        return None
    along, across = (before * np.where(raised > _FAST, raised, 1.0)).tolist()
    return replace(noise, fast=(along, across))


def _find_shown(
    seen: Observations, noise: NoiseModel, rest: Float64[np.ndarray, "n 3"]
) -> tuple[float, float, float]:
    """Size of the correlated part, from pairs of neighbours in space on different
    lines: machine errors and approach are alike there, but the time differs. A low
    quantile of the differences: a step of the set-up is in many of the others.
    """
    white, _ = split_sigma_mm(seen, noise)
    stated = seen.at.machine.tracker.sigma_mm(np.linalg.norm(seen.tracker_mm, axis=1))[
        :, [0, 1, 1]
    ]
    pairs = _pair_neighbours(seen)
    if len(pairs) < _FEWEST_TRIPLES:
        return 0.0, 0.0, 0.0
    a, b = pairs.T
    square = ((rest[a] - rest[b]) / stated[a]) ** 2
    own = ((white[a] ** 2 + white[b] ** 2) / stated[a] ** 2).mean(axis=0)
    low = np.quantile(square, _LOW, axis=0) / float(chdtri(1, 1.0 - _LOW))
    x, y, z = np.sqrt(np.maximum(low - own, 0.0) / 2.0).tolist()
    return x, y, z


def _pair_neighbours(seen: Observations) -> Int64[np.ndarray, "k 2"]:
    at, found = seen.at, [np.zeros((0, 2), np.int64)]
    for approach in np.unique(at.approach, axis=0):
        alike = (at.approach == approach).all(axis=1) & ~seen.is_ramp
        own = np.flatnonzero(alike)
        if len(own) < 2:
            continue
        count = min(_NEIGHBOURS, len(own))
        _, near = cKDTree(at.position_mm[own]).query(at.position_mm[own], k=count)
        other = seen.row[own[near]] != seen.row[own][:, None]
        nearest = np.take_along_axis(near, other.argmax(axis=1)[:, None], axis=1)[:, 0]
        found.append(np.stack([own, own[nearest]], axis=1)[other.any(axis=1)])
    return np.concatenate(found)


def estimate_residual_noise(
    observations: Observations, about: Linearisation, theta: Float64[np.ndarray, " p"]
) -> NoiseModel:
    """Noise from the residuals of an estimate.

    Fast, for the live estimate: the share absorbed by the estimate is not corrected.
    """
    design = _merge_design(observations, about)
    timing = _select_independent(design)[:, :, design.fixed :]
    residual = design.residual - design.columns @ theta
    nothing = Information.of_matrix(np.zeros((0, 0)))
    evidence = NoiseEvidence(design, timing, residual, nothing)
    return _maximise(evidence, about.noise, _LONGEST_S)


def _merge_design(observations: Observations, about: Linearisation) -> DesignMatrix:
    return about.build_merged(observations, _count_to_merge(observations))


def _leave_out_ramps(observations: Observations) -> Observations:
    others = observations.leave_out_ramps()
    return observations if len(np.unique(others.row)) < _FEWEST_ROWS else others


def _select_lines(observations: Observations) -> Observations:
    rows = np.unique(observations.row)
    cells = len(observations) / _count_to_merge(observations)
    keep = max(_FEWEST_ROWS, int(len(rows) * min(1.0, _CELLS / cells)))
    if keep >= len(rows):
        return observations
    kept = rows[np.linspace(0, len(rows) - 1, keep).round().astype(np.int64)]
    return observations.select(np.flatnonzero(np.isin(observations.row, kept)))


def _count_to_merge(observations: Observations) -> int:
    """Number of cells still short against the correlation time.

    A line has separate phase and speed: few cells determine hardly more than these.
    """
    length = (
        float(np.median(observations.count)) / observations.at.machine.tracker.rate_hz
    )
    lines = [b - a for a, b in observations.stretches if observations.at.line[a] >= 0]
    most = np.median(lines) / _FEWEST_OF_LINE if lines else np.inf
    return max(1, round(min(_MERGED_S / length, most)))


def _maximise(
    evidence: NoiseEvidence, noise: NoiseModel, longest_s: float
) -> NoiseModel:
    x = _pack(noise)
    low, high = _BOUNDS[: len(x)].T
    high = np.minimum(high, [*[np.inf] * 3, np.log(longest_s), np.inf][: len(x)])
    here, stiffer = _slope(evidence, x, noise), 1.0
    for _ in range(_STEPS):
        damped = stiffer * here.curvature
        damped += np.diag(1e-3 * np.diag(damped) + _LEAST)
        step = np.clip(-np.linalg.solve(damped, here.gradient), -_LONGEST, _LONGEST)
        step = np.clip(x + step, low, high) - x
        if abs(float(here.gradient @ step)) < _SETTLED:
            break
        there = _slope(evidence, x + step, noise)
        while there.cost > here.cost and np.abs(step).max() > _SHORTEST:
            step *= 0.3
            there = _slope(evidence, x + step, noise)
        if there.cost > here.cost:
            break
        stiffer = _compare_curvature(here, there, step)
        x, here = x + step, there
    return _unpack(x, noise)


def _compare_curvature(
    here: Slope, there: Slope, step: Float64[np.ndarray, " k"]
) -> float:
    """Ratio of observed to predicted curvature along a step.

    The average information may be too small: every step would overshoot.
    """
    expected = float(step @ here.curvature @ step)
    found = float((there.gradient - here.gradient) @ step)
    return min(max(found / expected, 1.0), _STIFFEST) if expected > 0.0 else 1.0


def _slope(
    evidence: NoiseEvidence, x: Float64[np.ndarray, " k"], noise: NoiseModel
) -> Slope:
    found = evidence.evaluate(_unpack(x, noise))
    off = (x[:4] - _USUAL) / _USUAL_SPREAD**2
    gradient, curvature = found.gradient.copy(), found.curvature.copy()
    gradient[:4] += 2.0 * off
    curvature[range(4), range(4)] += 2.0 / _USUAL_SPREAD**2
    return Slope(found.cost + float(off @ (x[:4] - _USUAL)), gradient, curvature)


def _pack(noise: NoiseModel) -> Float64[np.ndarray, " k"]:
    known = [*noise.ou, noise.ou_time_s]
    if np.isfinite(noise.along_sigma_mm):
        known.append(max(noise.along_sigma_mm, _JITTER_FLOOR_MM))
    return np.log(known)


def _unpack(x: Float64[np.ndarray, " k"], noise: NoiseModel) -> NoiseModel:
    beam, azimuth, elevation, tau, *jitter = (float(v) for v in np.exp(x))
    along = noise.along_sigma_mm
    if jitter:
        along = jitter[0] if jitter[0] > _JITTER_FLOOR_MM else 0.0
    return replace(
        noise, ou=(beam, azimuth, elevation), ou_time_s=tau, along_sigma_mm=along
    )


def _select_independent(design: DesignMatrix) -> Float64[np.ndarray, "n 3 p"]:
    """A line of one cell has a phase, but no separate speed."""
    n, count = len(design.rows), max(len(design.lines), 1)
    timing = design.timing.reshape(n, 3, count, -1)
    gram = np.einsum("nilj,nilk->ljk", timing, timing)
    shows = [
        np.linalg.det(gram[:, :k, :k])
        > _SAME * np.diagonal(gram[:, :k, :k], axis1=1, axis2=2).prod(axis=1)
        for k in range(1, gram.shape[1] + 1)
    ]
    independent = np.stack(shows, axis=1).ravel() if shows else np.zeros(0, bool)
    columns = [design.columns, design.timing[:, :, independent]]
    return np.concatenate(columns, axis=2)
