"""Which squarenesses, locations of rotary axes and seats of targets data can tell.

They enter one by one where they add a shape that poses, error motions and what has been
added before do not make yet.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from scipy.linalg import block_diag

from truepath.app.kinematics.conditions import Conditions
from truepath.app.kinematics.effects.base import Effect, Role
from truepath.app.kinematics.effects.location_error import (
    list_axis_locations,
    list_squarenesses,
)
from truepath.app.kinematics.effects.nuisance import (
    TargetSeat,
    TrackerPose,
    list_target_seats,
)
from truepath.app.kinematics.machine import Machine, Target

_NEW_SHAPE = 0.02  # splines make a sine to a hundredth


def select_numbers(
    runs: Sequence[Sequence[Target]],
    each_run: Sequence[Conditions],
    motions: Sequence[Effect],
) -> tuple[list[Effect], dict[str, tuple[str, ...]]]:
    """Return the numbers and seats that are told, and effects that make the others.

    runs : the targets measured in each Run; each_run : probes of the volume by them
    motions : error motions that are told
    """
    poses, seats = _find_seats(runs, each_run)
    blocks = [poses, *(_columns(e, each_run) for e in (*motions, *seats))]
    basis, _ = np.linalg.qr(np.hstack(blocks))
    added: list[Effect] = []
    untold: dict[str, tuple[str, ...]] = {}
    for effect in list_numbers(each_run[0].machine):
        own = _columns(effect, each_run)
        size = float(np.linalg.norm(own))
        new = _remove(basis, own)
        if size > 0.0 and np.linalg.norm(new) > _NEW_SHAPE * size:
            more, _ = np.linalg.qr(new)
            basis = np.hstack([basis, more])
            added.append(effect)
        else:
            mates = _nearest(own, [*motions, *added], each_run) if size > 0.0 else ()
            untold[effect.name] = mates
    return [*added, *seats], untold


def list_numbers(machine: Machine) -> list[Effect]:
    """Return squarenesses and locations."""
    found: list[Effect] = [*list_squarenesses(machine.axis_names)]
    for axis in machine.rotary_axes:
        found += list_axis_locations(axis)
    return found


def _find_seats(
    runs: Sequence[Sequence[Target]], each_run: Sequence[Conditions]
) -> tuple[Float64[np.ndarray, "m q"], list[TargetSeat]]:
    """Return the columns of the poses, and the seats that are no matter of a pose.

    A seat that looks like an error motion stays: its prior says how much it may be.
    """
    poses = _pose_columns(each_run)
    basis, _ = np.linalg.qr(poses)
    found: list[TargetSeat] = []
    for seat in list_target_seats(runs):
        own = _columns(seat, each_run)
        new = _remove(basis, own)
        if np.linalg.norm(new) > _NEW_SHAPE * np.linalg.norm(own):
            more, size, _ = np.linalg.svd(new, full_matrices=False)
            basis = np.hstack([basis, more[:, size > _NEW_SHAPE * size[0]]])
            found.append(seat)
    return poses, found


def _remove(
    basis: Float64[np.ndarray, "m b"], columns: Float64[np.ndarray, "m p"]
) -> Float64[np.ndarray, "m p"]:
    """Return what an orthonormal basis does not make of columns."""
    once = columns - basis @ (basis.T @ columns)
    return once - basis @ (basis.T @ once)


def _pose_columns(each_run: Sequence[Conditions]) -> Float64[np.ndarray, "m q"]:
    """Return the columns of the tracker's poses, a pose a Run."""
    poses: list[Float64[np.ndarray, "_ 6"]] = []
    for at in each_run:
        x, y, z = (float(v) for v in at.point_mm.mean(axis=0))
        poses.append(_columns(TrackerPose((x, y, z)), [at]))
    return np.asarray(block_diag(*poses), np.float64)


def _columns(
    effect: Effect, each_run: Sequence[Conditions]
) -> Float64[np.ndarray, "m p"]:
    J = np.concatenate([effect.jacobian(at) for at in each_run])
    return J.reshape(-1, J.shape[2])


def _nearest(
    own: Float64[np.ndarray, "m 1"], known: list[Effect], each_run: Sequence[Conditions]
) -> tuple[str, ...]:
    """Return the effects that make most of a shape."""
    blocks = [_columns(e, each_run) for e in known]
    scale = [1.0 / max(float(np.linalg.norm(b)), 1e-12) for b in blocks]
    stacked = np.hstack([b * s for b, s in zip(blocks, scale, strict=True)])
    solution, *_ = np.linalg.lstsq(stacked, own, rcond=1e-6)
    ends = np.cumsum([b.shape[1] for b in blocks])
    part = [float(np.linalg.norm(p)) for p in np.split(solution, ends[:-1])]
    return tuple(
        e.name
        for e, p in zip(known, part, strict=True)
        if p > 0.2 * max(part) and e.role is Role.MACHINE
    )
