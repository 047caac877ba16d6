"""Pose, timing and targets' seats: part of every estimate of a Run.

The position of a nest on tool or workpiece is known to a millimetre, never to a
micrometre, and differs between Runs. A shift of one target on the tool is part of the
pose, and of the locations of the rotary axes: the volumetric error is that of this
target as it sits, and locations of rotary axes are given relative to it. Every other
target may be off its nominal position in three directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import (
    Effect,
    Parameter,
    QuadraticPrior,
    Role,
    name_in_run,
)
from truepath.kinematics.machine.machine import SAME_TARGET_MM, Target
from truepath.numerics.rigid import RigidTransform, cross_matrix


@dataclass(frozen=True)
class TrackerPose(Effect):
    """A small shift, and a small turn about a centre, of all measured points."""

    kind = "tracker-pose"
    role = Role.NUISANCE
    centre_mm: tuple[float, float, float]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        shifts = [Parameter(f"pose-shift-{d}", "mm") for d in "xyz"]
        turns = [Parameter(f"pose-turn-{d}", "rad") for d in "xyz"]
        return tuple(shifts + turns)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        columns = np.zeros((len(at), 3, 6))
        columns[:, :, :3] = np.eye(3)
        columns[:, :, 3:] = cross_matrix(at.point_mm - np.array(self.centre_mm))
        return columns

    def correct(
        self, pose: RigidTransform, theta: Float64[np.ndarray, " p"]
    ) -> RigidTransform:
        translation, rotation = theta[:3], theta[3:]
        centre = np.array(self.centre_mm)
        return pose.precede_small(rotation, translation - np.cross(rotation, centre))


@dataclass(frozen=True)
class TimingLaw(Effect):
    """On each line the machine has a constant lag and a constant speed error.

    No clock is shared, so time along the line has an unknown phase and rate.
    """

    kind = "timing-law"
    role = Role.NUISANCE
    lines: tuple[int, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"line-{line}-{what}", unit)
            for line in self.lines
            for what, unit in (("phase", "mm"), ("speed", "mm/s"))
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        columns = np.zeros((len(at), 3, 2 * len(self.lines)))
        # On an arc the target's own speed changes along the line; a ramp has no speed.
        typical = at.line_speed_mm_s
        if typical is None:
            typical = np.linalg.norm(at.velocity_mm_s, axis=1)
        moving = np.flatnonzero(typical)
        column = np.searchsorted(np.array(self.lines), at.line[moving])
        direction = at.velocity_mm_s[moving] / typical[moving, None]
        columns[moving, :, 2 * column] = direction
        columns[moving, :, 2 * column + 1] = direction * at.line_time_s[moving, None]
        return columns


@dataclass(frozen=True)
class TargetSeat(Effect):
    """Deviation of a target from its position in the machine file, in one Run.

    The volumetric error is given for the first target on the tool as it sits: the
    others sit relative to that one.

    target : whose rows it moves, by its offset; run : the Run that it belongs to
    """

    role = Role.NUISANCE
    target: Target
    run: int = 0

    def compose_name(self, digits: str) -> str:
        offset = ",".join(f"{value:g}" for value in self.target.offset_mm)
        return name_in_run(f"seat-{self.target.name or offset}", self.run)

    @property
    def own_run(self) -> int:
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Three shifts, along the directions of tool or workpiece at rotary zero."""
        return tuple(Parameter(f"{self.name}-{d}", "mm") for d in "xyz")

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        is_tool = self.target.on == "tool"
        frame = at.chain.tool_frame if is_tool else at.chain.workpiece_frame
        return frame * self.select(at)[:, None, None]

    def select(self, at: Conditions) -> Bool[np.ndarray, " n"]:
        away = np.abs(at.offset_mm - np.array(self.target.offset_mm)).max(axis=1)
        return (away < SAME_TARGET_MM) & (at.run == self.run)

    def prior(self) -> QuadraticPrior:
        form = np.eye(3) / self.target.seat_sigma_mm**2
        return QuadraticPrior(form, 3, 3.0, is_known=True)


def list_target_seats(runs: Sequence[Sequence[Target]]) -> list[TargetSeat]:
    """Seats of all targets but the one for which the error is given.

    runs : the targets of each Run, in the order of the machine
    """
    seats = [TargetSeat(t, run) for run, targets in enumerate(runs) for t in targets]
    stated = next((seat for seat in seats if seat.target.on == "tool"), None)
    return [seat for seat in seats if seat is not stated]
