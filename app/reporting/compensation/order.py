"""What a writer gets: tables of each axis at equal spacing, in mm and rad."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.effects.error_motion import reference_position_mm
from app.kinematics.machine import LinearAxis, Machine
from app.kinematics.symbols import LINEAR
from app.reporting.compensation.source import Source


@dataclass(frozen=True, slots=True)
class AxisTable:
    """What an axis does to the tool point as it moves.

    position_mm : (n,) equidistant, ascending, over the whole travel
    reference : index of the row nearest to the reference position, where tables are 0
    forward_mm, backward_mm : (n, 3) δ along the middle of the other axes' travel, less
        its mean over both directions at the reference
    shift_mm, turn_rad : (n, 3) E and ω of the axis, for lever arms that count from the
        zero of the later axes; the target's offset is in E
    """

    axis: LinearAxis
    position_mm: Float64[np.ndarray, " n"]
    reference: int
    forward_mm: Float64[np.ndarray, "n 3"]
    backward_mm: Float64[np.ndarray, "n 3"]
    shift_mm: Float64[np.ndarray, "n 3"]
    turn_rad: Float64[np.ndarray, "n 3"]

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
    )


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
