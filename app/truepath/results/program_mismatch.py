"""Errors that look as if another program had been executed: scaled, sheared or shifted.

An estimate cannot distinguish a program that was scaled from a machine whose scale is
wrong. Errors of machines are far smaller than changes of programs, so a large one is a
doubt.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float64

from truepath.files.earlier.verdict import Reason, Verdict
from truepath.files.units import UM_PER_MM
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.results.volumetric_error import VolumetricError

_SLOPE = 4e-4  # of scale and squareness: poor machines reach half of it
_TURN_SLOPE = 7e-4  # of rotary axes, whose errors are large for short turns
_SHIFT_MM, _SHIFT_RAD = 0.3, 1e-3  # of axes against rotary axes
_STEP = 0.01  # mm or deg
_ALIKE = 1e-6  # of the strongest column: what is left of it is rounding


def assess_program(machine: Machine, volumetric: VolumetricError) -> Verdict:
    """A doubt for each change of the program that explains much of the error."""
    size = _fit_changes(machine, volumetric)
    reasons: list[Reason] = []
    for (kind, axes), value in size.items():
        rotary = not isinstance(machine.axes[axes[0]], LinearAxis)
        most, by = _TURN_SLOPE if rotary else _SLOPE, f"{1e6 * value:+.0f} ppm"
        if kind == "axis-shifted" and rotary:
            most, by = _SHIFT_RAD, f"{np.degrees(value):+.3f}°"
        elif kind == "axis-shifted":
            most, by = _SHIFT_MM, f"{value:+.2f} mm"
        if abs(value) > most:
            names = " ".join(machine.axis_names[k] for k in axes)
            reasons.append(Reason(kind, "doubtful", {"axes": names, "by": by}))
    return Verdict(tuple(reasons))


def _fit_changes(
    machine: Machine, volumetric: VolumetricError
) -> dict[tuple[str, tuple[int, ...]], float]:
    """Size of each change of the program in the error, in mm, rad or ratio."""
    q = volumetric.position_mm
    place = make_standstill(machine, q).point_mm
    moves = [_differentiate(machine, q, k) for k in range(q.shape[1])]
    away = q - (q.min(axis=0) + q.max(axis=0)) / 2.0
    linear = [k for k, axis in enumerate(machine.axes) if isinstance(axis, LinearAxis)]
    columns: dict[tuple[str, tuple[int, ...]], Float64[np.ndarray, "n 3"]] = {}
    for k, move in enumerate(moves):
        unit = 1.0 if k in linear else np.pi / 180.0
        columns["axis-scaled", (k,)] = unit * away[:, [k]] * move
        if machine.rotary_axes:
            columns["axis-shifted", (k,)] = move
    for a, b in combinations(linear, 2):
        columns["axes-leaning", (a, b)] = away[:, [a]] * moves[b]
    flat = np.stack([c.reshape(-1) for c in columns.values()], axis=1)
    error = volumetric.error_um.reshape(-1) / UM_PER_MM
    both = _drop_rigid(place, np.column_stack([flat, error]))
    strength = np.linalg.norm(both[:, :-1], axis=0)
    told = strength > _ALIKE * np.linalg.norm(flat, axis=0)
    size = np.zeros(len(columns))
    scaled = both[:, :-1][:, told] / strength[told]
    size[told] = np.linalg.lstsq(scaled, both[:, -1])[0] / strength[told]
    return dict(zip(columns, size.tolist(), strict=True))


def _differentiate(
    machine: Machine, q: Float64[np.ndarray, "n a"], axis: int
) -> Float64[np.ndarray, "n 3"]:
    """Motion of the target per mm or radian of an axis."""
    step = np.zeros(q.shape[1])
    step[axis] = _STEP
    ahead, behind = (make_standstill(machine, q + s * step).point_mm for s in (1, -1))
    unit = 1.0 if isinstance(machine.axes[axis], LinearAxis) else np.pi / 180.0
    return (ahead - behind) / (2.0 * _STEP * unit)


def _drop_rigid(
    place: Float64[np.ndarray, "n 3"], columns: Float64[np.ndarray, "m c"]
) -> Float64[np.ndarray, "m c"]:
    """Columns without the rigid motions of all points."""
    rigid = np.zeros((len(place), 3, 6))
    rigid[:, :, :3] = np.eye(3)
    for k, turn in enumerate(np.eye(3)):
        rigid[:, :, 3 + k] = np.cross(turn, place - place.mean(axis=0))
    basis = np.linalg.qr(rigid.reshape(-1, 6))[0]
    return columns - basis @ (basis.T @ columns)
