"""Estimate the noise of every Run from the Runs themselves.

500 Hz samples are correlated in time; treating them as independent gives intervals that
contain the truth far too rarely. The white part is the scatter of samples about their
cell. The Ornstein–Uhlenbeck part, its correlation time, the jitter of the feed and the
scatter between standstills maximise the evidence of the whole problem, so that what the
error motions absorb is accounted for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree
from scipy.special import chdtri

from truepath.alignment.observations.observations import Observations
from truepath.estimation.noise.noise_evidence import NoiseEvidence, Slope
from truepath.estimation.problem.confounded_prior import guess_full_prior
from truepath.estimation.problem.design_matrix import DesignMatrix, Linearisation
from truepath.estimation.problem.information import (
    Information,
    Posterior,
    add_information,
)
from truepath.estimation.problem.knots import compute_intervals, refine_motions
from truepath.estimation.problem.noise import NoiseModel, split_sigma_mm
from truepath.estimation.problem.normal_equations import (
    RunInformation,
    RunInput,
    collect_information,
    combine_runs,
)
from truepath.estimation.problem.prior import BendingPrior, compute_evidence_cost
from truepath.estimation.problem.prior_model import PriorEffects
from truepath.kinematics.model import MachineModel

_MERGED_S = 0.25  # longer: the correlated noise changes within a merged cell
_FEWEST_OF_LINE = 4  # merged cells
_CELLS = 1000  # enough for the noise to a few percent
_FEWEST_ROWS = 24
_SWEEPS = 2  # over several Runs
_ROUNDS = 3  # of noise and prior in turn, after the first
_JITTER_FLOOR_MM = 2e-5  # far below any tracker's noise: no jitter
# Few data hardly determine the Ornstein–Uhlenbeck part; most trackers in most halls are
# like this.
_USUAL_SIZE, _USUAL_TIME = np.log([0.15, 1.0])  # of the stated noise; in s
_USUAL_SPREAD, _USUAL_LEVEL = 1.2, 2.0  # of logarithms: of each, of all together
_DRIFTING = (5.0, 5.0, 5.0)  # of the specified noise: a second start of the search
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
_FEW_DIFFER = 0.3  # of the variance: below, a few places cause the rest
_OF_APART = 2.0  # least correlation time over the time between places
_SIZES = np.log([[1e-3, 30.0]] * 3)
# Few places show less than is typical by chance; of the scatter of samples, as stated
# or as found where that is less.
_LEAST_OF_FEW, _FEW_PLACES, _MOST_OF_PLACES = 0.15, 32, 30.0
_TIME, _JITTER = np.log([[0.02, _LONGEST_S], [_JITTER_FLOOR_MM, 0.1]])


def guess_noise(observations: Observations, *, perpendicular_only: bool) -> NoiseModel:
    """Starting values: scatter of this Run, a typical correlated part."""
    along, across = np.nan_to_num(observations.scatter, nan=1.0).tolist()
    is_timed = any(p.is_steady for p in observations.passes)
    jitter = 2e-4 if is_timed and not perpendicular_only else np.inf
    noise = NoiseModel((along, across), (0.1, 0.1, 0.1), 1.0, jitter)
    if (observations.at.line >= 0).any():
        return noise
    if np.isnan(observations.scatter).any():
        # Single shots: all their noise counts as noise between places.
        return replace(noise, white=(0.0, 0.0), place=(1.0, 1.0, 1.0))
    return replace(noise, place=(0.1, 0.1, 0.1))


def refine_runs(
    model: MachineModel,
    runs: Sequence[RunInput],
    known: PriorEffects | None = None,
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
    known = known or PriorEffects()
    few = [replace(r, observations=_select_lines(r.observations)) for r in runs]
    found = _JointFit.of(few, model, known, longest_s)
    if any(any(run.noise.place) for run in runs):
        # Differences between places are noise, or a machine that bends from one to the
        # next: a search that starts at one of them rarely finds the other.
        typical = replace(found, prior=guess_full_prior(model))
        found = min(typical.settle(), found.settle(), key=lambda each: each.cost)
    else:
        found = found.find_noise()
    return tuple(
        RunInput(
            run.observations,
            one.linearisation.correct_pose(one.own.restore(found.result)[0]),
            one.noise,
        )
        for run, one in zip(runs, found.runs, strict=True)
    )


@dataclass(frozen=True)
class _JointFit:
    """Runs with a noise each, and a prior of the machine scaled to their data.

    cost : −2 log evidence of all of them
    """

    runs: tuple[RunInformation, ...]
    prior: BendingPrior
    result: Posterior
    known: PriorEffects
    longest_s: float

    @staticmethod
    def of(
        runs: Sequence[RunInput],
        model: MachineModel,
        known: PriorEffects,
        longest_s: float,
    ) -> _JointFit:
        found = collect_information(runs, model)
        data = known.add_to(combine_runs(found), model)
        prior, result = guess_full_prior(model).fit(data)
        return _JointFit(found, prior, result, known, longest_s)

    @property
    def cost(self) -> float:
        data = self.known.add_to(combine_runs(self.runs), self.prior.model)
        penalty = sum(_penalise(_pack(run.noise), run.noise)[0] for run in self.runs)
        return compute_evidence_cost(data, self.prior, self.result) + penalty

    def find_noise(self) -> _JointFit:
        found = list(self.runs)
        # The noise of one Run shifts the error motions that the others determine.
        for k in [*range(len(found))] * min(len(found), _SWEEPS):
            others = found[:k] + found[k + 1 :]
            noise = _fit_noise(found[k], self.prior, others, self.known, self.longest_s)
            if len(found) > 1:
                found[k] = found[k].replace_noise(noise)
            else:
                about = replace(found[k].linearisation, noise=noise)
                found[k] = replace(found[k], linearisation=about)
        # Parts of one Run share the air; a few places hardly determine their noise.
        for k, one in enumerate(found):
            own = [r for r in found if r.observations.at.run == one.observations.at.run]
            longest = max(own, key=lambda r: len(r.observations))
            if longest is not one and any(one.noise.place):
                found[k] = one.replace_noise(longest.noise)
        return replace(self, runs=tuple(found))

    def settle(self) -> _JointFit:
        found = self.find_noise().refit()
        for _ in range(_ROUNDS):
            better = found.find_noise().refit()
            if better.cost > found.cost - _SETTLED:
                break
            found = better
        return found

    def refit(self) -> _JointFit:
        inputs = [
            RunInput(r.observations, r.linearisation.pose, r.noise) for r in self.runs
        ]
        model, found = self.prior.model, self
        while True:
            found = _JointFit.of(inputs, model, self.known, self.longest_s)
            closer = compute_intervals(model, found.prior.precision, found.result)
            if not closer:
                return found
            model = refine_motions(model, closer)


def _fit_noise(
    run: RunInformation,
    prior: BendingPrior,
    others: Sequence[RunInformation],
    effects: PriorEffects,
    longest_s: float,
) -> NoiseModel:
    design = _merge_design(run.observations, run.linearisation)
    own = Information.of_matrix(prior.precision_matrix(prior.model.size))
    before = effects.add_to(own, prior.model)
    known = add_information([before, *(other.own.eliminate() for other in others)])
    columns = _select_independent(design)
    evidence = NoiseEvidence(design, columns, design.residual, known)
    noise = _maximise_from_both(evidence, run.noise, longest_s)
    about, seen = run.linearisation, run.observations
    left = about.build(seen, solved=evidence.solve(noise)[: design.fixed])
    louder = _raise_fast(left, noise)
    if louder is not None:
        noise = _maximise(evidence, louder, longest_s)
    if any(noise.place):
        noise = _limit_place_noise(evidence, noise)
    rest = design.residual - evidence.columns @ evidence.solve(noise)
    return replace(noise, shown=_estimate_ou_from_neighbours(design, noise, rest))


def _raise_fast(left: DesignMatrix, noise: NoiseModel) -> NoiseModel | None:
    """Noise with another fast part; None if it stays.

    Samples scatter less than their means where noise lasts for some samples: a
    vibration of some hertz. Second differences of neighbours show it; slow noise hardly
    affects them. Each direction by the cells where the jitter of the feed is small.
    """
    seen, rest = left.observations, left.residual
    time_s = seen.at.time_s
    plain = replace(noise, ramp_sigma_mm=0.0, fast=(1.0, 1.0))
    sigma, ou = split_sigma_mm(seen, plain)
    middle = [np.arange(a + 1, b - 1) for a, b in seen.stretches if b - a > 2]
    k = np.concatenate(middle) if middle else np.zeros(0, np.int64)
    k = k[~seen.is_ramp[k]]
    clear = (_split_jitter(left, noise) < sigma)[k]
    if clear.sum(axis=0).min() < _FEWEST_TRIPLES:
        return None
    found = (rest[k - 1] - 2.0 * rest[k] + rest[k + 1]) ** 2
    keep = np.exp(-(time_s[k + 1] - time_s[k - 1]) / 2.0 / noise.ou_time_s)[:, None]
    slow = 2.0 * ou[k] ** 2 * (3.0 - 4.0 * keep + keep**2)
    fast = 4.0 * sigma[k] ** 2 + sigma[k - 1] ** 2 + sigma[k + 1] ** 2
    times = (found - _MEDIAN * slow) / (_MEDIAN * fast)
    times = np.maximum(np.nanmedian(np.where(clear, times, np.nan), axis=0), 0.0)
    raised = np.sqrt([times[0], 0.5 * (times[1] + times[2])])
    raised = np.where(raised > _FAST, raised, 1.0)
    if np.allclose(raised, noise.fast, rtol=_FAST - 1.0):
        return None
    return replace(noise, fast=(float(raised[0]), float(raised[1])))


def _limit_place_noise(evidence: NoiseEvidence, noise: NoiseModel) -> NoiseModel:
    """Noise between places limited to that of most pairs of neighbours in time.

    A few wrong places, or a step, would inflate it for all.
    """
    square, expected = evidence.compare_neighbours(noise)
    times = np.median(square / expected, axis=0) / _MEDIAN
    times = np.where(times < _FEW_DIFFER, times, 1.0)
    x, y, z = (np.sqrt(times) * noise.place).tolist()
    return replace(noise, place=(x, y, z))


def _split_jitter(
    design: DesignMatrix, noise: NoiseModel
) -> Float64[np.ndarray, "n 3"]:
    jitter_mm = noise.along_sigma_mm if np.isfinite(noise.along_sigma_mm) else 0.0
    return np.abs(design.travel) * jitter_mm


def _estimate_ou_from_neighbours(
    design: DesignMatrix, noise: NoiseModel, rest: Float64[np.ndarray, "n 3"]
) -> tuple[float, float, float]:
    """Size of the correlated part, from pairs of neighbours in space on different
    lines: machine errors and approach are alike there, but the time differs. Each
    direction by the cells where the jitter of the feed is small. A low quantile of the
    differences: a step of the set-up is in many of the others.
    """
    seen = design.observations
    white, ou = split_sigma_mm(seen, noise)
    stated = seen.at.machine.tracker.sigma_mm(np.linalg.norm(seen.tracker_mm, axis=1))[
        :, [0, 1, 1]
    ]
    a, b = _pair_neighbours(seen).T
    square = ((rest[a] - rest[b]) / stated[a]) ** 2
    jitter = _split_jitter(design, noise)
    fresh = np.hypot(white, jitter)
    own = (fresh[a] ** 2 + fresh[b] ** 2) / stated[a] ** 2
    clear = jitter < np.hypot(white, ou)
    clear = clear[a] & clear[b]
    x, y, z = (
        _compute_excess(square[each, k], own[each, k]) for k, each in enumerate(clear.T)
    )
    return x, y, z


def _compute_excess(
    square: Float64[np.ndarray, " k"], own: Float64[np.ndarray, " k"]
) -> float:
    if len(square) < _FEWEST_TRIPLES:
        return 0.0
    low = np.quantile(square, _LOW) / float(chdtri(1, 1.0 - _LOW))
    return float(np.sqrt(max(low - own.mean(), 0.0) / 2.0))


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
    nothing = Information.nothing(0)
    evidence = NoiseEvidence(design, timing, residual, nothing)
    return _maximise(evidence, about.noise, _LONGEST_S)


def _merge_design(observations: Observations, about: Linearisation) -> DesignMatrix:
    return about.build_merged(observations, _count_to_merge(observations))


def _select_lines(observations: Observations) -> Observations:
    others = observations.exclude_ramps()
    if len(np.unique(others.row)) >= _FEWEST_ROWS:
        observations = others
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


def _maximise_from_both(
    evidence: NoiseEvidence, noise: NoiseModel, longest_s: float
) -> NoiseModel:
    # On the fly the many cells lead from either start to the same noise.
    quiet = _maximise(evidence, noise, longest_s)
    if not any(noise.place):
        return quiet
    time_s = evidence.design.observations.at.time_s
    drifting = replace(noise, ou=_DRIFTING, ou_time_s=float(np.ptp(time_s)))
    starts = [quiet, _maximise(evidence, drifting, longest_s)]
    return min(starts, key=lambda each: _slope(evidence, _pack(each), each).cost)


def _maximise(
    evidence: NoiseEvidence, noise: NoiseModel, longest_s: float
) -> NoiseModel:
    low, high = _list_bounds(noise, len(evidence.residual)).T
    high[3] = min(high[3], np.log(longest_s))
    if (
        any(noise.place) and len(evidence.residual) > 1
    ):  # what is faster than places follow differs between them
        apart_s = np.median(np.diff(evidence.design.observations.at.time_s))
        low[3] = min(high[3], np.log(_OF_APART * apart_s))
    x = np.clip(_pack(noise), low, high)
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
    cost, gradient, curvature = _penalise(x, noise)
    return Slope(
        found.cost + cost,
        found.gradient + gradient,
        found.curvature + curvature,
    )


def _penalise(
    x: Float64[np.ndarray, " k"], noise: NoiseModel
) -> tuple[float, Float64[np.ndarray, " k"], Float64[np.ndarray, "k k"]]:
    """Cost of an atypical noise, with gradient and curvature.

    A hall noisier than typical is so in all: sizes scatter about a common level.
    """
    sizes = np.array(
        [0, 1, 2, *(range(len(x) - 3, len(x)) if any(noise.place) else ())]
    )
    off, variance = np.zeros(len(x)), np.zeros((len(x), len(x)))
    off[sizes], off[3] = x[sizes] - _USUAL_SIZE, x[3] - _USUAL_TIME
    if not any(noise.white):  # single shots: between places is all their noise
        off[sizes[3:]] = x[sizes[3:]]
    variance[np.ix_(sizes, sizes)] = _USUAL_LEVEL**2
    varied = [*sizes, 3]
    variance[varied, varied] += _USUAL_SPREAD**2
    weight = np.linalg.pinv(variance, hermitian=True)
    return float(off @ weight @ off), 2.0 * weight @ off, 2.0 * weight


def _pack(noise: NoiseModel) -> Float64[np.ndarray, " k"]:
    known = [*noise.ou, noise.ou_time_s]
    if np.isfinite(noise.along_sigma_mm):
        known.append(max(noise.along_sigma_mm, _JITTER_FLOOR_MM))
    return np.log([*known, *(each for each in noise.place if each)])


def _list_bounds(noise: NoiseModel, places: int) -> Float64[np.ndarray, "k 2"]:
    bounds = [*_SIZES, _TIME]
    if np.isfinite(noise.along_sigma_mm):
        bounds.append(_JITTER)
    if any(noise.place):
        least = _LEAST_OF_FEW * min(1.0, (_FEW_PLACES / places) ** 0.5)
        shown = [min(noise.white[k] or 1.0, 1.0) for k in (0, 1, 1)]
        bounds += [np.log([least * each, _MOST_OF_PLACES]) for each in shown]
    return np.array(bounds)


def _unpack(x: Float64[np.ndarray, " k"], noise: NoiseModel) -> NoiseModel:
    beam, azimuth, elevation, tau, *more = (float(v) for v in np.exp(x))
    along, place = noise.along_sigma_mm, noise.place
    if np.isfinite(along):
        along = more[0] if more[0] > _JITTER_FLOOR_MM else 0.0
    if any(place):
        place = (more[-3], more[-2], more[-1])
    ou = (beam, azimuth, elevation)
    return replace(noise, ou=ou, ou_time_s=tau, along_sigma_mm=along, place=place)


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
