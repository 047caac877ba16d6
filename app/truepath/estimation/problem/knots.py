"""Knots by need: spaced by how much an error motion bends, not by the axis length.

Under the bending prior of precision λ a motion varies between knots at a distance h
with the variance

    v ≈ h³ / (3 π⁴ λ),

the sum over all waves shorter than those that the knots can follow. λ is estimated from
the data, so a motion with local structure (a rack of several pieces, say) has a large
v. Where v is not small against the variance of the motion, its knots are refined, and
the cells of the data with them, up to the density that any machine needs. The final
variance between knots counts as uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.observations import Observations
from truepath.alignment.observations.reduction import CELL_MM
from truepath.estimation.problem.information import Posterior
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.identifiable import KNOT_SPACING_MM
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.model import MachineModel

_HIDDEN = 0.01  # of a motion's variance, between its knots
_CLOSEST_MM = 1.05 * KNOT_SPACING_MM
_FASTEST = 5.0  # times as many knots in one step
_MOST = 1500  # parameters of all error motions: time grows with their cube
_GRID = 101  # positions of an axis


def merge_cells(
    observed: Sequence[Observations], model: MachineModel
) -> list[Observations]:
    """Observations in cells matched to the model's knot spacing.

    Effects of the catalogue may change faster: with them, cells are not merged.
    """
    if model.catalogue_effects:
        return list(observed)
    longest_mm = _compute_cell_mm(model)
    return [each.merge_cells(longest_mm) for each in observed]


def _compute_cell_mm(model: MachineModel) -> dict[str, float]:
    cells: dict[str, float] = {}
    for motion in model.error_motions:
        name = motion.axis.name
        if not isinstance(motion.axis, RotaryAxis):
            cell_mm = CELL_MM * compute_spacing(motion) / KNOT_SPACING_MM
            cells[name] = min(cell_mm, cells.get(name, np.inf))
    return cells


def compute_intervals(
    model: MachineModel, precision: Mapping[str, float], result: Posterior
) -> dict[str, int]:
    """Number of intervals needed by motions whose knots are too coarse.

    precision : of the prior, by motion; result : of the model

    Largest hidden share first, within a limit on the size of the problem.
    """
    share = {
        m.name: compute_hidden_variance(m, precision[m.name])
        / _mean_variance(m, result.covariance, model.slices[m.name])
        for m in model.error_motions
        if can_refine(m)
    }
    motions = {m.name: m for m in model.error_motions}
    left = _MOST - sum(len(m.parameters) for m in motions.values())
    found: dict[str, int] = {}
    for name in sorted(share, key=lambda name: -share[name]):
        more = min(_FASTEST, max(2.0, (share[name] / _HIDDEN) ** (1 / 3)))
        length = motions[name].axis.high - motions[name].axis.low
        now = round(length / compute_spacing(motions[name]))
        closest = round(length / KNOT_SPACING_MM)
        wanted = min(round(more * now), closest, now + left)
        if share[name] > _HIDDEN and wanted > 1.2 * now:
            found[name] = wanted
            left -= wanted - now
    return found


def add_hidden_variance(
    result: Posterior, model: MachineModel, precision: Mapping[str, float]
) -> Posterior:
    """Adds the variance between coarse knots to the covariance.

    precision : of the prior, by motion
    """
    hidden = np.zeros(len(result.theta))
    hidden[: model.size] = compute_hidden_variances(model, precision)
    return replace(result, covariance=result.covariance + np.diag(hidden))


def compute_hidden_variances(
    model: MachineModel, precision: Mapping[str, float]
) -> Float64[np.ndarray, " p"]:
    hidden = np.zeros(model.size)
    for motion in model.identifiable_motions:
        if can_refine(motion):
            # Of every control value: their shapes are orthonormal.
            own = model.slices[motion.name]
            hidden[own] = compute_hidden_variance(motion, precision[motion.name])
    return hidden


def compute_hidden_variance(motion: ErrorMotion, precision: float) -> float:
    """h³ / (3 π⁴ λ), for a motion of a linear axis."""
    return compute_spacing(motion) ** 3 / (3.0 * np.pi**4 * precision)


def can_refine(motion: ErrorMotion) -> bool:
    """True for motions of linear axes with knots coarser than the standard spacing."""
    is_linear = not isinstance(motion.axis, RotaryAxis)
    return is_linear and compute_spacing(motion) > _CLOSEST_MM


def compute_spacing(motion: ErrorMotion) -> float:
    """Mean distance of the knots, mm or deg."""
    return float(np.diff(motion.spline.knots).mean())


def _mean_variance(
    motion: ErrorMotion, covariance: Float64[np.ndarray, "m m"], own: slice
) -> float:
    rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, _GRID))
    spread = covariance[own, own]
    return float(np.einsum("np,np->n", rows @ spread, rows).mean())


def refine_motions(model: MachineModel, intervals: Mapping[str, int]) -> MachineModel:
    """Number of intervals by name of the motion; other effects stay."""
    effects = [
        effect.coarsen(intervals[effect.name])
        if isinstance(effect, ErrorMotion) and effect.name in intervals
        else effect
        for effect in model.effects
    ]
    return replace(model, effects=tuple(effects))
