"""Figures of ISO 230-2 that a volumetric estimate can give: the systematic part.

    M = range of the mean of both directions,     x̄ᵢ
    B = largest |reversal value|,                 Bᵢ = x̄ᵢ↑ − x̄ᵢ↓ = 2 hᵢ
    E = range of the means of both directions,    x̄ᵢ ± hᵢ

Their uncertainties are the spreads over errors sampled from the covariance (JCGM 101);
the half differences hᵢ, which a result states apart from its model, are sampled as
fully correlated along their axis. Repeatability and accuracy need repeated approaches
of target positions: they are not here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.estimation.solve.extrapolation import Ranges
from truepath.files.units import scale_of
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.machine.machine import position_unit
from truepath.kinematics.machine.symbols import find_unit, is_positioning
from truepath.kinematics.model import EstimatedModel
from truepath.results.error_tables import choose_table_positions
from truepath.results.volumetric_error import sample_parameters


@dataclass(frozen=True, slots=True)
class Stated:
    """A number with its standard uncertainty (k = 1)."""

    value: float
    uncertainty: float


@dataclass(frozen=True, slots=True)
class PositioningFigures:
    """Of one axis, in `unit`: "um" or "urad".

    range : lowest and highest position of those that they are of, in `position_unit`:
        measured, or the travel where the measured range is unknown
    reversal : None where the result has no dependence on direction
    """

    symbol: str
    unit: str
    range: tuple[float, float]
    position_unit: str
    mean_range: Stated
    reversal: Stated | None
    systematic_range: Stated


@dataclass(frozen=True, slots=True)
class HalfDifference:
    """Half the difference of both directions at the positions of a table.

    position : (n,) mm or deg
    value, uncertainty : (n,), standard uncertainty (k = 1), in the unit of the table
    """

    position: Float64[np.ndarray, " n"]
    value: Float64[np.ndarray, " n"]
    uncertainty: Float64[np.ndarray, " n"]


def compute_positioning_figures(
    estimated: EstimatedModel, halves: Mapping[str, HalfDifference], measured: Ranges
) -> tuple[PositioningFigures, ...]:
    """Of every axis whose positioning is known, over its measured range.

    halves : by the symbol, of those that depend on the direction
    measured : by axis, the range that was measured, if it is known
    """
    at = estimated.reduce_to_targets
    theta = at.theta[:, None] + sample_parameters(at.covariance)
    theta = np.column_stack([at.theta, theta])
    found: list[PositioningFigures] = []
    for motion in at.model.error_motions:
        if is_positioning(motion.symbol) and motion.name not in at.model.confounded:
            axis, every = motion.axis, choose_table_positions(motion.axis)
            low, high = measured.get(axis.name, (axis.low, axis.high))
            inside = every[(every > low) & (every < high)]
            position = np.concatenate([[low], inside, [high]])
            half = halves.get(motion.symbol)
            found.append(_compute_axis(at, motion, theta, half, position))
    return tuple(found)


def _compute_axis(
    at: EstimatedModel,
    motion: ErrorMotion,
    theta: Float64[np.ndarray, "p d"],
    half: HalfDifference | None,
    position: Float64[np.ndarray, " n"],
) -> PositioningFigures:
    unit = find_unit(motion.symbol)
    rows = motion.rows(position)
    mean = scale_of(unit) * rows @ theta[at.model.slices[motion.name]]
    spread = _sample_half(half, position, theta.shape[1])
    both = np.concatenate([mean + spread, mean - spread])
    return PositioningFigures(
        motion.symbol,
        unit,
        (float(position[0]), float(position[-1])),
        position_unit(motion.axis),
        _summarise(np.ptp(mean, axis=0)),
        None if half is None else _summarise(2.0 * np.abs(spread).max(axis=0)),
        _summarise(np.ptp(both, axis=0)),
    )


def _sample_half(
    half: HalfDifference | None, position: Float64[np.ndarray, " n"], count: int
) -> Float64[np.ndarray, "n d"]:
    """Half differences: first as stated, then sampled."""
    if half is None:
        return np.zeros((1, count))
    departure = np.random.default_rng(0).standard_normal(count)
    departure[0] = 0.0
    value, sigma = (
        np.interp(position, half.position, of) for of in (half.value, half.uncertainty)
    )
    return value[:, None] + sigma[:, None] * departure


def _summarise(values: Float64[np.ndarray, " d"]) -> Stated:
    return Stated(float(values[0]), float(values[1:].std()))
