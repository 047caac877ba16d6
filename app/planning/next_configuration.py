"""The configuration to measure next: where one scalar measurement lowers J most.

On one axis the optimum is exact (`best_place`). On several, one axis after another is
set to its optimum while the others stand, until nothing rises any more; from several
starts, because there are several summits (brunn-hanebeck-2005, eq. 36–37).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.base import standstill
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.model import MachineModel
from app.numerics.design_criteria import Belief, best_place

PositionRows = Callable[[Float64[np.ndarray, "n a"]], Float64[np.ndarray, "n p"]]

_DRAWS = 50  # places judged for each that climbs
_ROUNDS = 30
_RISEN = 1e-9  # relative rise of a round that is worth another


@dataclass(frozen=True, slots=True)
class NextConfiguration:
    """Axis positions, and by how much a measurement there lowers J."""

    position: Float64[np.ndarray, " a"]
    drop: float


def next_configuration(
    known: Belief,
    rows: PositionRows,
    borders: Sequence[Float64[np.ndarray, " b"]],
    noise_variance: float,
    *,
    starts: int = 12,
    seed: int = 0,
) -> NextConfiguration:
    """Return the best configuration found; the same seed gives the same.

    rows : measurement rows at axis positions, along each axis cubic between borders
    borders : for each axis its ends and every knot between them
    """
    low = np.array([b[0] for b in borders])
    high = np.array([b[-1] for b in borders])
    draws = np.random.default_rng(seed).uniform(low, high, (_DRAWS * starts, len(low)))
    # Random places are judged cheaply, the best of them climb.
    first = np.argsort(-known.drops(rows(draws), noise_variance))[:starts]
    summits = [_climbed(known, rows, borders, noise_variance, draws[i]) for i in first]
    return max(summits, key=lambda summit: summit.drop)


def point_rows(
    model: MachineModel, direction: Float64[np.ndarray, "3"]
) -> PositionRows:
    """Return rows of measuring a point's displacement along one direction.

    Turns of an axis act on levers that are straight in the positions of the others, so
    along each axis a row is cubic between its knots.
    """

    def rows(position: Float64[np.ndarray, "n a"]) -> Float64[np.ndarray, "n p"]:
        columns = model.jacobian(standstill(model.machine, position))
        return np.einsum("d,ndp->np", direction, columns)

    return rows


def knot_borders(model: MachineModel) -> list[Float64[np.ndarray, " b"]]:
    """Return the ends of each axis and every knot of its error motions."""
    borders: list[Float64[np.ndarray, " b"]] = []
    for axis in model.machine.linear_axes:
        knots = [
            effect.spline.knots
            for effect in model.effects
            if isinstance(effect, ErrorMotion) and effect.axis.name == axis.name
        ]
        ends = np.array([axis.min_mm, axis.max_mm])
        borders.append(np.unique(np.concatenate([ends, *knots])))
    return borders


def _climbed(
    known: Belief,
    rows: PositionRows,
    borders: Sequence[Float64[np.ndarray, " b"]],
    noise_variance: float,
    start: Float64[np.ndarray, " a"],
) -> NextConfiguration:
    """Set one axis after another to its optimum until nothing rises any more."""
    position, drop = start.copy(), 0.0
    for _ in range(_ROUNDS):
        before = drop
        for axis, border in enumerate(borders):
            along = _along(rows, position, axis)
            best = best_place(known, along, border, noise_variance)
            position[axis], drop = best.at, best.drop
        if drop <= before * (1.0 + _RISEN):
            break
    return NextConfiguration(position, drop)


def _along(
    rows: PositionRows, position: Float64[np.ndarray, " a"], axis: int
) -> Callable[[Float64[np.ndarray, " n"]], Float64[np.ndarray, "n p"]]:
    """Return the rows over one axis while the others stand."""

    def at(place: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n p"]:
        positions = np.tile(position, (len(place), 1))
        positions[:, axis] = place
        return rows(positions)

    return at
