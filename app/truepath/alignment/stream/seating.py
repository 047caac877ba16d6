"""Targets off their stated positions: the shift of their standstills.

A nest is where the machine file states it to a millimetre or so. Standstills of a
target that is off show the same shift, turned with what carries the target. It is
fitted with the pose, and subtracted before lines are cut out where it is large; the
rest is left to the estimate, which is linear in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from truepath.kinematics.conditions import observe_targets
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded
from truepath.numerics.rigid import cross_matrix

MOST_SIGMAS = 6.0  # largest shift of a target
_SAME_TURN = 1e-9
_SETTLED = 6  # standstills of a target: then its seat is known
_ROUGH_MM = 0.1  # machine errors, still unknown

Seats = Mapping[str, Float64[np.ndarray, "3"]]


@dataclass(frozen=True)
class Seating:
    """Target measured at each point, and the effect of its shift there.

    names : of the targets; sigma_mm : (t,) of each coordinate of their shifts
    target : (w,) its number; frame : (w, 3, 3) rotation of what carries it
    """

    names: tuple[str, ...]
    sigma_mm: Float64[np.ndarray, " t"]
    target: Int64[np.ndarray, " w"]
    frame: Float64[np.ndarray, "w 3 3"]

    @property
    def reach_mm(self) -> Float64[np.ndarray, " w"]:
        return MOST_SIGMAS * self.sigma_mm[self.target]

    def list_settled(self, seen: Int64[np.ndarray, " k"]) -> frozenset[str]:
        """Targets observed six times, or at all their points, or never to come again.

        seen : points so far, in order
        """
        count = len(self.names)
        often = np.bincount(self.target[seen], minlength=count)
        of_all = np.bincount(self.target, minlength=count)
        last = (
            len(self.target)
            - 1
            - np.array([np.argmax(self.target[::-1] == k) for k in range(count)])
        )
        enough = (often >= np.minimum(_SETTLED, of_all)) | (last < seen[-1])
        return frozenset(n for n, e in zip(self.names, enough, strict=True) if e)

    def select(self, places: slice | Int64[np.ndarray, " k"]) -> Seating:
        return replace(self, target=self.target[places], frame=self.frame[places])

    def max_distance_change_mm(self) -> Float64[np.ndarray, "w w"]:
        flat = self.frame.reshape(len(self.frame), 9)
        turned = np.sqrt(np.maximum(6.0 - 2.0 * flat @ flat.T, 0.0) / 2.0)
        same = self.target[:, None] == self.target
        reach = self.reach_mm
        return np.where(same, turned * reach, reach[:, None] + reach)

    def fit(
        self,
        waypoint: Int64[np.ndarray, " k"],
        place_mm: Float64[np.ndarray, "k 3"],
        rest_mm: Float64[np.ndarray, "k 3"],
    ) -> Float64[np.ndarray, "t 3"]:
        """Shifts that, with a small motion of all, best explain the residuals.

        place_mm, rest_mm : nominal, and measured less nominal, in one frame
        """
        k, t = len(waypoint), len(self.names)
        A = np.zeros((k, 3, 6 + 3 * t))
        A[:, :, :3] = np.eye(3)
        A[:, :, 3:6] = cross_matrix(place_mm - place_mm.mean(axis=0)) / 100.0
        for number in range(t):
            mine = self.target[waypoint] == number
            own = slice(6 + 3 * number, 9 + 3 * number)
            A[mine, :, own] = self.frame[waypoint[mine]]
        flat = A.reshape(3 * k, -1)
        known = np.concatenate([np.full(6, 1e-12), np.repeat(self.sigma_mm**-2, 3)])
        normal = flat.T @ flat / _ROUGH_MM**2 + np.diag(known)
        solved = np.linalg.solve(normal, flat.T @ rest_mm.ravel() / _ROUGH_MM**2)
        return solved[6:].reshape(t, 3)

    def move(
        self, place_mm: Float64[np.ndarray, "w 3"], seat_mm: Float64[np.ndarray, "t 3"]
    ) -> Float64[np.ndarray, "w 3"]:
        return place_mm + np.einsum("wij,wj->wi", self.frame, seat_mm[self.target])


def compute_seating(
    machine: Machine, commanded: Commanded, rows: Int64[np.ndarray, " w"]
) -> Seating | None:
    """None where the pose absorbs all shifts."""
    names = [commanded.target[int(r)] if commanded.target else "" for r in rows]
    each = [machine.target(name) for name in names]
    used = [target for target in machine.targets if target in each]
    at = observe_targets(machine, commanded.position[rows], each)
    frame = at.chain.tool_frame + at.chain.workpiece_frame
    if len(used) == 1 and float(np.ptp(frame, axis=0).max()) < _SAME_TURN:
        return None
    return Seating(
        tuple(target.name for target in used),
        np.array([target.seat_sigma_mm for target in used]),
        np.array([used.index(target) for target in each], np.int64),
        frame,
    )


def refer_to_first(machine: Machine, seats: Seats) -> Seats:
    """Shifts on the tool relative to that of the first target there.

    The volumetric error refers to that target at its seat.
    """
    tools = [target.name for target in machine.targets if target.on == "tool"]
    if not tools or tools[0] not in seats:
        return seats
    nothing, first = np.zeros(3), seats[tools[0]]
    on_tool = {name: seats.get(name, nothing) - first for name in tools}
    return {**seats, **on_tool}


def seat_targets(machine: Machine, seats: Seats) -> Machine:
    moved = [
        replace(t, offset_mm=(x, y, z))
        for t in machine.targets
        for x, y, z in [(np.array(t.offset_mm) + seats.get(t.name, 0.0)).tolist()]
    ]
    return replace(machine, targets=tuple(moved))
