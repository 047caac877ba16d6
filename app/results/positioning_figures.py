"""Figures of ISO 230-2 that a volumetric estimate can give: the systematic part.

    M = range of the mean of both directions,     x̄ᵢ
    B = largest |reversal value|,                 Bᵢ = x̄ᵢ↑ − x̄ᵢ↓ = 2 hᵢ
    E = range of the means of both directions,    x̄ᵢ ± hᵢ

Their uncertainties are the spreads over errors drawn from the covariance (JCGM 101).
Repeatability and accuracy need repeated approaches of target positions: they are not
here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.app.files.units import scale_of
from truepath.app.kinematics.estimated_model import EstimatedModel
from truepath.app.kinematics.symbols import find_unit, is_positioning
from truepath.app.results.error_tables import choose_table_positions
from truepath.app.results.volumetric_error import draw_parameters


@dataclass(frozen=True, slots=True)
class Stated:
    """A number with its standard uncertainty (k = 1)."""

    value: float
    uncertainty: float


@dataclass(frozen=True, slots=True)
class PositioningFigures:
    """Of one axis, in `unit`: "um" or "urad".

    reversal : None where the estimate has no dependence on direction
    """

    symbol: str
    unit: str
    mean_range: Stated
    reversal: Stated | None
    systematic_range: Stated


def compute_positioning_figures(
    estimated: EstimatedModel,
) -> tuple[PositioningFigures, ...]:
    """Return the figures of every axis whose positioning is known."""
    at = estimated.at_targets
    drawn = at.theta[:, None] + draw_parameters(at.covariance)
    theta = np.column_stack([at.theta, drawn])
    return tuple(
        _compute(at, motion.symbol, theta)
        for motion in at.model.error_motions
        if is_positioning(motion.symbol) and motion.name not in at.model.confounded
    )


def _compute(
    at: EstimatedModel, symbol: str, theta: Float64[np.ndarray, "p d"]
) -> PositioningFigures:
    """Return the figures of one axis; the first column of theta is the estimate."""
    model = at.model
    motion = next(m for m in model.error_motions if m.symbol == symbol)
    place = choose_table_positions(motion.axis)
    scale = scale_of(find_unit(symbol))
    mean = scale * motion.rows(place) @ theta[model.slices[motion.name]]
    half = np.zeros_like(mean)
    has_direction = False
    for effect in model.effects:
        curve = effect.half_difference
        if curve and curve.symbol == symbol:
            half += scale * curve.rows(place) @ theta[model.slices[effect.name]]
            has_direction = True
    both = np.concatenate([mean + half, mean - half])
    return PositioningFigures(
        symbol,
        find_unit(symbol),
        _state(np.ptp(mean, axis=0)),
        _state(2.0 * np.abs(half).max(axis=0)) if has_direction else None,
        _state(np.ptp(both, axis=0)),
    )


def _state(values: Float64[np.ndarray, " d"]) -> Stated:
    return Stated(float(values[0]), float(values[1:].std()))
