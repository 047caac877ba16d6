"""What a writer gets: tables of each axis at equal spacing, in mm and rad."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.compensation.source import Source
from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import LINEAR

_FEWEST, _FINEST = 2, 11  # positions of the axis that another one bends with


@dataclass(frozen=True, slots=True)
class Bending:
    """What an axis does beyond its own table, as another axis stands elsewhere.

    by_mm : (m,) positions of the other axis, equidistant over its travel
    more_mm : (m, n, 3) at the axis' own n positions; 0 where either axis is at its
        reference
    """

    by: LinearAxis
    by_mm: Float64[np.ndarray, " m"]
    more_mm: Float64[np.ndarray, "m n 3"]


@dataclass(frozen=True, slots=True)
class AxisTable:
    """What an axis does to the tool point as it moves.

    position_mm : (n,) equidistant, ascending, over the whole travel
    reference : index of the row nearest to the reference position, where tables are 0
    forward_mm, backward_mm : (n, 3) δ along the middle of the other axes' travel, less
        its mean over both directions at the reference
    shift_mm, turn_rad : (n, 3) E and ω of the axis, for lever arms that count from the
        zero of the later axes; the target's offset is in E
    bending : with one other axis, where the model has such an effect
    """

    axis: LinearAxis
    position_mm: Float64[np.ndarray, " n"]
    reference: int
    forward_mm: Float64[np.ndarray, "n 3"]
    backward_mm: Float64[np.ndarray, "n 3"]
    shift_mm: Float64[np.ndarray, "n 3"]
    turn_rad: Float64[np.ndarray, "n 3"]
    bending: Bending | None = None

    @property
    def mean_mm(self) -> Float64[np.ndarray, "n 3"]:
        """Mean of both directions."""
        return 0.5 * (self.forward_mm + self.backward_mm)

    @property
    def spacing_mm(self) -> float:
        """Distance of neighbouring rows."""
        return float(self.position_mm[1] - self.position_mm[0])

    @property
    def own(self) -> int:
        """Index of the axis' own direction."""
        return LINEAR.index(self.axis.name)


@dataclass(frozen=True, slots=True)
class CompensationOrder:
    """Everything a writer may put down.

    stem : of file names; stamp : lines for comments, in plain ASCII
    """

    stem: str
    machine: Machine
    tables: tuple[AxisTable, ...]
    stamp: tuple[str, ...]

    def table(self, axis: str) -> AxisTable:
        """Return the table of an axis."""
        return next(t for t in self.tables if t.axis.name == axis)


def axis_table(
    source: Source, axis: LinearAxis, spacing_mm: float, most_points: int
) -> AxisTable:
    """Return the table of an axis, rows at most `spacing_mm` apart where they fit."""
    travel = axis.max_mm - axis.min_mm
    wished = math.ceil(travel / spacing_mm - 1e-9) + 1
    count = int(np.clip(wished, 2, most_points))
    at_mm = np.linspace(axis.min_mm, axis.max_mm, count)
    reference = int(np.argmin(np.abs(at_mm - reference_position_mm(axis))))
    place = _along(source, axis, at_mm, source.middle_mm())
    forward, backward = (source.error_mm(place, sign) for sign in (1.0, -1.0))
    zero = 0.5 * (forward + backward)[reference]
    return AxisTable(
        axis,
        at_mm,
        reference,
        forward - zero,
        backward - zero,
        *_motions(source, axis, at_mm),
        _bending(source, axis, at_mm, most_points // count),
    )


def _bending(
    source: Source, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"], most: int
) -> Bending | None:
    """Return what the model's effects of two axes do; None without any.

    most : positions of the other axis that the controller has room for
    """
    machine = source.machine
    by = next((b for a, b in source.pairs() if a == axis.name), "")
    if not by or most < _FEWEST:
        return None
    other = machine.linear(by)
    by_mm = np.linspace(other.min_mm, other.max_mm, min(most, _FINEST))
    rest = np.array([reference_position_mm(a) for a in machine.axes])
    grid = np.stack(np.meshgrid(by_mm, at_mm, indexing="ij"), axis=-1).reshape(-1, 2)
    columns = [machine.axis_names.index(name) for name in (by, axis.name)]
    total = np.zeros((len(grid), 3))
    for kept, sign in (((0, 1), 1.0), ((0,), -1.0), ((1,), -1.0), ((), 1.0)):
        place = np.tile(rest, (len(grid), 1))
        for k in kept:
            place[:, columns[k]] = grid[:, k]
        total += sign * source.bent_mm(place, axis.name, by)
    return Bending(other, by_mm, total.reshape(len(by_mm), len(at_mm), 3))


def _along(
    source: Source,
    axis: LinearAxis,
    at_mm: Float64[np.ndarray, " n"],
    others_mm: Float64[np.ndarray, " a"],
) -> Float64[np.ndarray, "n a"]:
    place = np.tile(others_mm, (len(at_mm), 1))
    place[:, source.machine.axis_names.index(axis.name)] = at_mm
    return place


def _motions(
    source: Source, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Return E and ω of an axis, squareness and the target's offset in E.

    With the others at their reference, where their turns are 0, δ changes along the
    axis by E + ω × R, R the positions of the later axes there.
    """
    machine = source.machine
    rest = np.array([reference_position_mm(a) for a in machine.axes])
    place = _along(source, axis, np.append(at_mm, reference_position_mm(axis)), rest)
    error = source.error_mm(place)
    omega = source.turn_rad(axis.name, at_mm)
    later = machine.order[machine.order.index(axis.name) + 1 :]
    lever = np.zeros(3)
    for name in later:
        if name in LINEAR:
            lever[LINEAR.index(name)] = rest[machine.axis_names.index(name)]
    return error[:-1] - error[-1] - np.cross(omega, lever), omega
