"""What a fit would gain if every distance of the tracker were off by the same amount.

A wrong home distance, or the constant of another reflector, bends the whole volume
about the tracker. An error of a machine repeats with the position of its axes alone;
this one repeats with the distance, and the part of it that no machine can do stays in
the residuals. It is a score test (`score`) of one column: the unit beam.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from truepath.estimation.checks.misfit import collect_known
from truepath.estimation.checks.misfit_blocks import weigh
from truepath.estimation.problem.design_matrix import cut_into_blocks
from truepath.estimation.problem.direction import Fit
from truepath.estimation.problem.noise import limit_noise
from truepath.estimation.problem.normal_equations import compute_information
from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.tracker_error import TrackerRangeOffset
from truepath.numerics.scaled_cholesky import ScaledCholesky

_UNSEEN = 1e-8  # of the column's information: the fit explains it all


@dataclass(frozen=True, slots=True)
class RangeOffsetScore:
    """What one more parameter of a Run, the range offset, would be.

    gain : of the fit, χ² of one degree of freedom where there is none
    offset_mm, sigma_mm : its value, and standard uncertainty
    """

    gain: float
    offset_mm: float
    sigma_mm: float


def score_range_offset(fit: Fit, number: int) -> RangeOffsetScore | None:
    """Return the score of one Run; None where the data cannot tell it."""
    run = fit.runs[number]
    seen, machine = run.observations, slice(fit.model.size)
    if seen.at.recorded is None:
        return None
    about = replace(run.linearisation, noise=limit_noise(run.noise))
    known = collect_known(fit, number)
    data = compute_information(seen, about, apart=True)
    matrix, vector = data.matrix, data.vector
    matrix[machine, machine] += known.matrix
    vector[machine] += known.vector
    if run.weak is not None:
        matrix[machine.stop :, machine.stop :] += np.diag(run.weak)
    factor = ScaledCholesky.of(matrix)
    theta = factor.solve(vector)
    total = np.zeros(len(theta) + 2)
    for cells in cut_into_blocks(seen):
        design = about.build(seen.select(np.r_[cells]))
        beam = _beam_columns(design.observations.at, design.frame)
        rest = design.residual - design.columns @ theta
        weighted = weigh(design, design.whiten(about.noise), beam)
        every = np.concatenate([design.columns, rest[:, :, None], beam], axis=2)
        flat = every.reshape(-1, every.shape[2])
        total += flat.T @ weighted.reshape(len(flat))
    shared, pulled, raw = total[:-2], float(total[-2]), float(total[-1])
    left = raw - float(shared @ factor.solve(shared))
    if left < _UNSEEN * raw:
        return None
    return RangeOffsetScore(pulled**2 / left, pulled / left, left**-0.5)


def _beam_columns(
    at: Conditions, frame: Float64[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 3 1"]:
    return frame @ TrackerRangeOffset().jacobian(at)
