"""How error motions change as a machine warms: in few smooth shapes.

A scale that grows makes a straight line of a positioning error, a column that is warm
on one side a curve of an angle. Of each error motion the smoothest shapes may change,
the straight one by a usual size, bends by less. Squarenesses and locations change as
numbers. What depends on the direction of approach is taken to stay.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from truepath.app.kinematics.effects.base import Effect
from truepath.app.kinematics.effects.error_motion import ErrorMotion, find_usual_size
from truepath.app.kinematics.model import MachineModel
from truepath.app.kinematics.symbols import is_straightness

_SIZES = 1.0, 0.5, 0.2  # of the straight shape, one bend, two bends
_USUAL_NUMBER = {"mm": 0.01, "rad": 2e-5}
_PLACES = 33


def build_drift_shapes(model: MachineModel) -> Float64[np.ndarray, "p m"]:
    """Return the shapes in which the parameters of a model change, one a column.

    Each changes its error motion by 10 µm or 20 µrad at most over the travel, or by the
    share of it that is usual.
    """
    columns: list[Float64[np.ndarray, " p"]] = []
    for effect in model.effects:
        part = model.slices[effect.name]
        for shape in _yield_shapes(effect):
            column = np.zeros(model.size)
            column[part] = shape
            columns.append(column)
    return np.stack(columns, axis=1)


def _yield_shapes(effect: Effect) -> Iterator[Float64[np.ndarray, " k"]]:
    size = len(effect.parameters)
    if isinstance(effect, ErrorMotion):
        axis = effect.axis
        rows = effect.rows(np.linspace(axis.low, axis.high, _PLACES))
        # The shapes of an error motion are sorted: straight ones first.
        sizes = _SIZES[1:] if is_straightness(effect.symbol) else _SIZES
        for shape, share in zip(np.eye(size), sizes, strict=False):
            usual = share * find_usual_size(effect.symbol)
            yield usual * shape / float(np.abs(rows @ shape).max())
    elif effect.iso_symbol:
        yield np.array([_USUAL_NUMBER[p.unit] for p in effect.parameters])
