"""Find the noise of every Run from the Runs themselves.

500 Hz samples are correlated in time; who counts them as independent states intervals
that hold the truth far too seldom. The white part is what samples scatter about their
cell. The Ornstein–Uhlenbeck part, its correlation time and the jitter of the feed
maximise the evidence of the whole problem, so that what the error motions take up is
accounted for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from app.alignment.observations import Observations
from app.estimation.direction import with_half_widths
from app.estimation.information import Information, added
from app.estimation.known_effects import KnownEffects
from app.estimation.noise import NoiseModel
from app.estimation.noise_evidence import NoiseEvidence, Slope
from app.estimation.prior import BendingPrior, first_guess, fitted
from app.estimation.problem import Part, Problem, refined_pose
from app.estimation.runs import Measured, Share, shares_of, together, with_noise
from app.kinematics.effects.base import Effect
from app.kinematics.identifiable import identifiable_model
from app.kinematics.machine import Machine

_MERGED_S = 0.25  # longer: the correlated noise changes within a merged cell
# Knots for judging noise: fine enough that shapes of the errors do not pass for noise.
_COARSE_MM = 35.0
_CELLS = 1000  # as many tell the noise to a few parts in a hundred
_FEWEST_ROWS = 24
_SAME = 1e-6  # phase and speed of a line of one cell are the same
_SWEEPS = 2  # over several Runs
_JITTER_FLOOR_MM = 2e-5  # far below any tracker's noise: no jitter
# Few data say little of the Ornstein–Uhlenbeck part; most trackers in most halls are
# like this.
_USUAL = np.log([0.15, 0.15, 1.0])  # beam, across (of the stated noise), time in s
_USUAL_SPREAD = 1.2
_STEPS = 12
_SETTLED = 0.1  # of −2 log evidence, which a deviation of a tenth of a sigma costs
_LONGEST, _SHORTEST = 1.5, 0.02  # of a step, in logarithms
_LEAST = 1e-3  # curvature of what the data do not tell: no jitter, say
LONGEST_S = 60.0
_BOUNDS = np.log([[1e-3, 3.0], [1e-3, 3.0], [0.02, LONGEST_S], [_JITTER_FLOOR_MM, 0.1]])


def first_noise(seen: Observations, *, perpendicular_only: bool) -> NoiseModel:
    """Return the tracker's noise: this Run's scatter, a usual correlated part."""
    white = (float(seen.scatter[0]), float(seen.scatter[1]))
    along = np.inf if perpendicular_only or not seen.passes else 2e-4
    return NoiseModel(white, (0.1, 0.1), 1.0, along)


def looked_at(
    machine: Machine,
    runs: Sequence[Measured],
    beside: Sequence[Effect] = (),
    known: KnownEffects | None = None,
    *,
    longest_s: float = LONGEST_S,
) -> tuple[Measured, ...]:
    """Return the Runs with a better pose and the noise of greatest evidence.

    beside : further effects that must not pass for Ornstein–Uhlenbeck noise
    known : effects of the machine that an earlier measurement has told
    longest_s : correlation time; what is slower is structure, not noise

    The rough pose is off by the machine's errors. Every Run has a noise of its own;
    what the error motions are, all Runs tell. Some lines and coarse splines tell both
    well, at a fraction of the cost.
    Raises Unidentifiable if the lines do not determine the parameters.
    """
    known = known or KnownEffects()
    offsets_mm = [run.seen.at.offset_mm for run in runs]
    model, _ = identifiable_model(machine, *offsets_mm, knot_spacing_mm=_COARSE_MM)
    # Lost motion must not pass for Ornstein–Uhlenbeck noise.
    model = with_half_widths(known.beside(model))
    model = model.with_effects(*(e for e in beside if e.name not in model.slices))
    few = [replace(run, seen=_some_lines(run.seen)) for run in runs]
    shares = list(shares_of(few, model))
    data = known.informed(together(shares), model)
    prior, result = fitted(data, first_guess(model))
    # The noise of one Run shifts what the others hold for the error motions.
    for k in [*range(len(runs))] * min(len(runs), _SWEEPS):
        others = shares[:k] + shares[k + 1 :]
        noise = _fitted_noise(shares[k], prior, others, known, longest_s)
        if len(runs) > 1:
            shares[k] = with_noise(shares[k].problem, noise)
        else:
            shares[k] = replace(shares[k], noise=noise)
    return tuple(
        Measured(
            run.seen,
            refined_pose(share.problem, share.completed(result)[0]),
            share.noise,
        )
        for run, share in zip(runs, shares, strict=True)
    )


def _fitted_noise(
    share: Share,
    prior: BendingPrior,
    others: Sequence[Share],
    effects: KnownEffects,
    longest_s: float,
) -> NoiseModel:
    """Return the likeliest noise of a Run, precisions and the others' noise held."""
    seen = share.problem.seen
    part = share.problem.part(seen, merge=_merge(seen))
    columns = _columns(part)
    precision = prior.precision_matrix(prior.model.size)
    charged = Information(precision, np.zeros(len(precision)), 0.0, 0.0)
    known = added(
        [
            effects.informed(charged, prior.model),
            *(other.about_machine for other in others),
        ]
    )
    evidence = NoiseEvidence(part, columns, part.off, known)
    return _likeliest(evidence, share.noise, longest_s)


def residual_noise(
    problem: Problem, theta: Float64[np.ndarray, " p"], noise: NoiseModel
) -> NoiseModel:
    """Return the noise that the residuals of an estimate show.

    Quick, for the live estimate: what the estimate has taken up of it is not counted.
    """
    part = problem.part(problem.seen, merge=_merge(problem.seen))
    left = part.off - part.rows[:, :, : part.data] @ theta
    timing = _columns(part)[:, :, part.data :]
    nothing = Information(np.zeros((0, 0)), np.zeros(0), 0.0, 0.0)
    evidence = NoiseEvidence(part, timing, left, nothing)
    return _likeliest(evidence, noise, LONGEST_S)


def _columns(part: Part) -> Float64[np.ndarray, "n 3 p"]:
    """Return the columns of all parameters; of a line's speed where it shows."""
    phase, speed = part.timing[:, :, ::2], part.timing[:, :, 1::2]
    alone = np.einsum("nil,nil->l", phase, phase), np.einsum("nil,nil->l", speed, speed)
    both = np.einsum("nil,nil->l", phase, speed)
    shows = alone[0] * alone[1] - both**2 > _SAME * alone[0] * alone[1]
    told = np.ones(part.rows.shape[2], bool)
    told[part.data] = False
    told[part.data + 2 :: 2] = shows
    return part.rows[:, :, told]


def _some_lines(seen: Observations) -> Observations:
    """Return whole lines or standstills, evenly spread, that make enough cells."""
    rows = np.unique(seen.row)
    cells = len(seen) / _merge(seen)
    keep = max(_FEWEST_ROWS, int(len(rows) * min(1.0, _CELLS / cells)))
    if keep >= len(rows):
        return seen
    kept = rows[np.linspace(0, len(rows) - 1, keep).round().astype(np.int64)]
    return seen.taken(np.flatnonzero(np.isin(seen.row, kept)))


def _merge(seen: Observations) -> int:
    """Return how many cells are still short against the correlation time."""
    length = float(np.median(seen.count)) / seen.at.machine.tracker.rate_hz
    return max(1, round(_MERGED_S / length))


def _likeliest(
    evidence: NoiseEvidence, noise: NoiseModel, longest_s: float
) -> NoiseModel:
    """Return the noise model of least cost: Newton's steps, halved where too long."""
    x = _packed(noise)
    low, high = _BOUNDS[: len(x)].T
    high = np.minimum(high, [np.inf, np.inf, np.log(longest_s), np.inf][: len(x)])
    here, step = _slope(evidence, x, noise), np.zeros(len(x))
    for _ in range(_STEPS):
        damped = here.curvature + np.diag(1e-3 * np.diag(here.curvature) + _LEAST)
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
        x, here = x + step, there
    return _unpacked(x, noise)


def _slope(
    evidence: NoiseEvidence, x: Float64[np.ndarray, " k"], noise: NoiseModel
) -> Slope:
    """Return the slope of the evidence, with the prior on the correlated part."""
    found = evidence.at(_unpacked(x, noise))
    off = (x[:3] - _USUAL) / _USUAL_SPREAD**2
    gradient, curvature = found.gradient.copy(), found.curvature.copy()
    gradient[:3] += 2.0 * off
    curvature[range(3), range(3)] += 2.0 / _USUAL_SPREAD**2
    return Slope(found.cost + float(off @ (x[:3] - _USUAL)), gradient, curvature)


def _packed(noise: NoiseModel) -> Float64[np.ndarray, " k"]:
    known = [*noise.ou, noise.ou_time_s]
    if np.isfinite(noise.along_sigma_mm):
        known.append(max(noise.along_sigma_mm, _JITTER_FLOOR_MM))
    return np.log(known)


def _unpacked(x: Float64[np.ndarray, " k"], noise: NoiseModel) -> NoiseModel:
    beam, across, tau, *jitter = (float(v) for v in np.exp(x))
    along = noise.along_sigma_mm
    if jitter:
        along = jitter[0] if jitter[0] > _JITTER_FLOOR_MM else 0.0
    return NoiseModel(noise.white, (beam, across), tau, along)
