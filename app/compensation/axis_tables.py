"""The tables of each axis at equal spacing, in mm and rad: the input of a writer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.compensation.error_map import ErrorMap
from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import LINEAR

_FEWEST, _FINEST = 2, 11  # positions of the second axis of a pair


@dataclass(frozen=True, slots=True)
class PairTable:
    """The error of an axis beyond its own table, at positions of another axis.

    by_mm : (m,) positions of the other axis, equidistant over its travel
    error_mm : (m, n, 3) at the axis' own n positions; 0 where either axis is at its
        reference
    """

    by: LinearAxis
    by_mm: Float64[np.ndarray, " m"]
    error_mm: Float64[np.ndarray, "m n 3"]


@dataclass(frozen=True, slots=True)
class AxisTable:
    """The error at the tool point as one axis moves.

    position_mm : (n,) equidistant, ascending, over the whole travel
    reference : index of the row nearest to the reference position, where tables are 0
    forward_mm, backward_mm : (n, 3) δ along the middle of the other axes' travel, less
        its mean over both directions at the reference
    translation_mm, rotation_rad : (n, 3) E and ω of the axis, for lever arms that count
        from the zero of the later axes; the target's offset is in E
    pair : with one other axis, where the model has such an effect
    """

    axis: LinearAxis
    position_mm: Float64[np.ndarray, " n"]
    reference: int
    forward_mm: Float64[np.ndarray, "n 3"]
    backward_mm: Float64[np.ndarray, "n 3"]
    translation_mm: Float64[np.ndarray, "n 3"]
    rotation_rad: Float64[np.ndarray, "n 3"]
    pair: PairTable | None = None

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
class CompensationTables:
    """The content of the files of a format.

    stem : of file names; stamp : lines for comments, in plain ASCII
    """

    stem: str
    machine: Machine
    tables: tuple[AxisTable, ...]
    stamp: tuple[str, ...]


def tabulate_axis(
    errors: ErrorMap, axis: LinearAxis, spacing_mm: float, most_points: int
) -> AxisTable:
    """Return the table of an axis, rows at most `spacing_mm` apart where they fit."""
    travel = axis.high - axis.low
    wanted = math.ceil(travel / spacing_mm - 1e-9) + 1
    count = int(np.clip(wanted, 2, most_points))
    at_mm = np.linspace(axis.low, axis.high, count)
    reference = int(np.argmin(np.abs(at_mm - reference_position_mm(axis))))
    place = errors.move_axis(axis, at_mm, errors.middle_mm)
    forward, backward = (errors.error_mm(place, sign) for sign in (1.0, -1.0))
    zero = 0.5 * (forward + backward)[reference]
    return AxisTable(
        axis,
        at_mm,
        reference,
        forward - zero,
        backward - zero,
        *_tabulate_motions(errors, axis, at_mm),
        _tabulate_pair(errors, axis, at_mm, most_points // count),
    )


def _tabulate_pair(
    errors: ErrorMap, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"], most: int
) -> PairTable | None:
    """Return the error by effects of two axes; None without any.

    most : positions of the other axis that the controller has room for
    """
    machine = errors.machine
    by = next((b for a, b in errors.list_pairs() if a == axis.name), "")
    if not by or most < _FEWEST:
        return None
    other = machine.linear(by)
    by_mm = np.linspace(other.low, other.high, min(most, _FINEST))
    grid = np.stack(np.meshgrid(by_mm, at_mm, indexing="ij"), axis=-1).reshape(-1, 2)
    columns = [machine.axis_names.index(name) for name in (by, axis.name)]
    total = np.zeros((len(grid), 3))
    for kept, sign in (((0, 1), 1.0), ((0,), -1.0), ((1,), -1.0), ((), 1.0)):
        place = np.tile(errors.reference_mm, (len(grid), 1))
        for k in kept:
            place[:, columns[k]] = grid[:, k]
        total += sign * errors.pair_error_mm(place, axis.name, by)
    return PairTable(other, by_mm, total.reshape(len(by_mm), len(at_mm), 3))


def _tabulate_motions(
    errors: ErrorMap, axis: LinearAxis, at_mm: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Return E and ω of an axis, squareness and the target's offset in E.

    With the others at their reference, where their ω are 0, δ changes along the
    axis by E + ω × R, R the positions of the later axes there.
    """
    machine = errors.machine
    rest = errors.reference_mm
    at_and_zero = np.append(at_mm, reference_position_mm(axis))
    error = errors.error_mm(errors.move_axis(axis, at_and_zero, rest))
    omega = errors.rotation_rad(axis.name, at_mm)
    later = machine.order[machine.order.index(axis.name) + 1 :]
    lever = np.array(
        [rest[machine.axis_names.index(n)] if n in later else 0.0 for n in LINEAR]
    )
    return error[:-1] - error[-1] - np.cross(omega, lever), omega
