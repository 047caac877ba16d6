"""What every estimate of a Run has beside the machine: pose, timing, seat of targets.

How the measured targets of a Run sit on tool and workpiece is its own in every Run. On
the tool: a turn of their offsets as a whole. With one target this is a shift, which
the tracker's pose takes; with several, the turn of the last axis at its zero shows, and
the gauge of the tables has no place for it. On the workpiece, seen by a tracker on the
base: at the axis zero they need not be where the file says to a micrometre; relative to
the tool they may be shifted and turned as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role, name_in_run
from app.kinematics.machine import Machine
from app.numerics.rigid import RigidTransform, cross_matrix


@dataclass(frozen=True)
class TrackerPose(Effect):
    """A small shift, and a small turn about a centre, of all measured points."""

    kind = "tracker-pose"
    role = Role.NUISANCE
    centre_mm: tuple[float, float, float]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Three shifts, three turns."""
        shifts = [Parameter(f"pose-shift-{d}", "mm") for d in "xyz"]
        turns = [Parameter(f"pose-turn-{d}", "rad") for d in "xyz"]
        return tuple(shifts + turns)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return shift + turn × (point − centre)."""
        columns = np.zeros((len(at), 3, 6))
        columns[:, :, :3] = np.eye(3)
        columns[:, :, 3:] = cross_matrix(at.point_mm - np.array(self.centre_mm))
        return columns

    def correct(
        self, pose: RigidTransform, theta: Float64[np.ndarray, " p"]
    ) -> RigidTransform:
        """Return a pose with these parameters in it."""
        translation, rotation = theta[:3], theta[3:]
        centre = np.array(self.centre_mm)
        return pose.precede_small(rotation, translation - np.cross(rotation, centre))


@dataclass(frozen=True)
class TimingLaw(Effect):
    """Along each line the machine is late by a constant, off its speed by another.

    No clock is shared: when it was where is a phase and a speed.
    """

    kind = "timing-law"
    role = Role.NUISANCE
    lines: tuple[int, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Phase and speed of the first line, of the second, ..."""
        return tuple(
            Parameter(f"line-{line}-{what}", unit)
            for line in self.lines
            for what, unit in (("phase", "mm"), ("speed", "mm/s"))
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the direction of travel, and the same times the time from mid line."""
        columns = np.zeros((len(at), 3, 2 * len(self.lines)))
        speed = np.linalg.norm(at.velocity_mm_s, axis=1)
        moving = np.flatnonzero(speed)
        column = np.searchsorted(np.array(self.lines), at.line[moving])
        # On an arc the target's own speed changes along the line.
        usual = speed if at.line_speed_mm_s is None else at.line_speed_mm_s
        direction = at.velocity_mm_s[moving] / usual[moving, None]
        columns[moving, :, 2 * column] = direction
        columns[moving, :, 2 * column + 1] = direction * at.line_time_s[moving, None]
        return columns


@dataclass(frozen=True)
class ToolOrientation(Effect):
    """A small turn of all offsets about the machine's first target on the tool.

    The volumetric error is stated for that target: how the others sit is none of it.

    about_mm : offset of the first target
    turns : (3, p) turns that the offsets can show; p = 2 where they lie on one line
    run : the Run that it belongs to; the targets of others are not moved
    """

    role = Role.NUISANCE
    about_mm: tuple[float, float, float]
    turns: Float64[np.ndarray, "3 p"]
    run: int = 0

    def compose_name(self, digits: str) -> str:
        """Return the kind with its Run."""
        del digits
        return name_in_run("tool-orientation", self.run)

    @property
    def own_run(self) -> int:
        """The Run of these targets."""
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Two or three angles."""
        count = self.turns.shape[1]
        return tuple(Parameter(f"tool-turn-{i}", "rad") for i in range(count))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return turn × (offset − first offset)."""
        if at.run != self.run:
            return np.zeros((len(at), 3, self.turns.shape[1]))
        columns = cross_matrix(at.offset_mm - np.array(self.about_mm)) @ self.turns
        return at.chain.tool_frame @ columns


def find_tool_orientation(
    machine: Machine, offsets_mm: Float64[np.ndarray, "t 3"], run: int = 0
) -> tuple[ToolOrientation, ...]:
    """Return the effect for the offsets of a Run; none where there is but one."""
    _, size, direction = np.linalg.svd(offsets_mm - offsets_mm[0])
    if size[0] < 1e-6:
        return ()
    on_a_line = len(size) < 2 or size[1] < 1e-6 * size[0]
    turns = direction[1:].T if on_a_line else direction.T
    first = next(t for t in machine.targets if t.on == "tool")
    return (ToolOrientation(first.offset_mm, turns, run),)


@dataclass(frozen=True)
class WorkpiecePlacement(Effect):
    """A small shift (k = 0, 1, 2) or turn (3, 4, 5) of all targets on the workpiece.

    centre_mm : about which they turn
    run : the Run that it belongs to; the targets of others are not moved
    """

    role = Role.NUISANCE
    k: int
    centre_mm: tuple[float, float, float]
    run: int = 0

    def compose_name(self, digits: str) -> str:
        """Return shift or turn, direction and Run."""
        del digits
        kind = "shift" if self.k < 3 else "turn"
        return name_in_run(f"workpiece-{kind}-{'xyz'[self.k % 3]}", self.run)

    @property
    def own_run(self) -> int:
        """The Run of these targets."""
        return self.run

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The shift or the angle."""
        return (Parameter(self.name, "mm" if self.k < 3 else "rad"),)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return R d, or R (d × arm), R the turn of the workpiece in the base."""
        if at.run != self.run:
            return np.zeros((len(at), 3, 1))
        unit = np.eye(3)[:, self.k % 3]
        arm = np.tile(unit, (len(at), 1))
        if self.k >= 3:
            arm = cross_matrix(at.offset_mm - np.array(self.centre_mm)) @ unit
        return np.einsum("nij,nj->ni", at.chain.workpiece_frame, arm)[:, :, None]


def list_workpiece_placements(
    offsets_mm: Float64[np.ndarray, "t 3"], run: int = 0
) -> tuple[WorkpiecePlacement, ...]:
    """Return the six effects for the targets of a Run on the workpiece."""
    x, y, z = (float(v) for v in offsets_mm.mean(axis=0))
    return tuple(WorkpiecePlacement(k, (x, y, z), run) for k in range(6))
