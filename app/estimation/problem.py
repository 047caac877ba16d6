"""Observations as a linear problem in θ: measured minus nominal, in the beam frame.

The pose is linearised about its latest value and solved jointly with the errors, never
by fitting points to the closest point of the path, which drags errors into the pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import NDArray

from app.alignment.observations import Observations
from app.alignment.reduction import beam_frame
from app.kinematics.effects.base import Effect
from app.kinematics.effects.timing_law import TimingLaw
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.model import MachineModel
from app.numerics.rigid import RigidTransform

_CELLS = 500  # of a part: few enough for the processor's cache, enough for its BLAS


@dataclass(frozen=True, slots=True)
class Part:
    """Cells of whole lines or standstills.

    frame : (n, 3, 3) workpiece to beam frame
    rows : (n, 3, p + 1 + 2 l) over machine and pose, then the data, then phase and
        speed of the l lines in it; in the beam frame
    data : p, the column of the data
    """

    seen: Observations
    frame: Float64[np.ndarray, "n 3 3"]
    rows: Float64[np.ndarray, "n 3 q"]
    data: int

    @property
    def off(self) -> Float64[np.ndarray, "n 3"]:
        """Measured less nominal."""
        return self.rows[:, :, self.data]

    @property
    def timing(self) -> Float64[np.ndarray, "n 3 t"]:
        """Rows over phase and speed of the lines."""
        return self.rows[:, :, self.data + 1 :]


@dataclass(frozen=True, slots=True)
class Problem:
    """A linear problem in machine and pose; its rows are made part by part.

    Phase and speed of a line are parameters too, but of the cells of that line alone:
    they are integrated out with their part, so that the problem's size does not grow
    with the number of lines.

    model : machine effects, then pose
    machine_model : the machine effects alone, whose parameters come first
    timing : whether timing is told: not where nothing along the travel is used
    """

    seen: Observations
    model: MachineModel
    machine_model: MachineModel
    pose: RigidTransform
    timing: bool

    def parts(self) -> Iterator[Part]:
        """Yield the cells in their order, some whole lines at a time."""
        seen = self.seen
        new = (np.diff(seen.at.line) != 0) | (np.diff(seen.row) != 0)
        begins = np.flatnonzero(np.concatenate([[True], new]))
        first = 0
        for last in [*begins[1:].tolist(), len(seen)]:
            if last - first >= _CELLS or last == len(seen):
                yield self.part(seen.taken(np.arange(first, last)))
                first = last

    def part(self, seen: Observations, *, merge: int = 1) -> Part:
        """Return the rows of cells, which hold whole lines or standstills.

        merge : so many neighbouring cells of a line are made one
        """
        p = self.model.size
        lines = np.unique(seen.at.line[seen.at.line >= 0]).tolist()
        timing = TimingLaw(tuple(lines if self.timing else ()))
        local = np.empty((len(seen), 3, p + 1 + len(timing.parameters)))
        for effect in self.model.effects:
            local[:, :, self.model.slices[effect.name]] = effect.jacobian(seen.at)
        off = self.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
        local[:, :, p] = off
        if timing.lines:
            local[:, :, p + 1 :] = timing.jacobian(seen.at)
        if merge > 1:
            seen, local = _coarser(seen, local, merge)
        frame = beam_frame(seen.tracker_mm) @ self.pose.rotation
        return Part(seen, frame, frame @ local, p)


def pose_problem(
    seen: Observations,
    machine_model: MachineModel,
    pose: RigidTransform,
    *,
    timing: bool = True,
) -> Problem:
    """Return the problem of machine effects and pose about the given pose.

    timing : False where nothing along the travel is used, so that no timing is told
    """
    model = machine_model.with_effects(TrackerPose(_centre(seen)))
    return Problem(seen, model, machine_model, pose, timing)


def with_machine_effects(problem: Problem, effects: Sequence[Effect]) -> Problem:
    """Return the problem with some of its machine effects only."""
    machine = MachineModel(problem.model.machine, tuple(effects))
    pose = problem.model.effects[len(problem.machine_model.effects) :]
    return replace(problem, model=machine.with_effects(*pose), machine_model=machine)


def columns_with(problem: Problem, effects: Sequence[Effect]) -> Bool[np.ndarray, " p"]:
    """Tell which columns stay where only some of the machine's effects do."""
    names = {effect.name for effect in effects}
    keep = np.ones(problem.model.size, bool)
    for effect in problem.machine_model.effects:
        keep[problem.model.slices[effect.name]] = effect.name in names
    return keep


def refined_pose(problem: Problem, theta: Float64[np.ndarray, " p"]) -> RigidTransform:
    """Return the pose with its correction: shift + turn × (p − centre)."""
    part = problem.model.slices["tracker-pose"]
    translation, rotation = theta[part][:3], theta[part][3:]
    centre = problem.seen.at.point_mm.mean(axis=0)
    return problem.pose.precede_small(
        rotation, translation - np.cross(rotation, centre)
    )


def _coarser(
    seen: Observations, local: Float64[np.ndarray, "n 3 q"], merge: int
) -> tuple[Observations, Float64[np.ndarray, "m 3 q"]]:
    """Return up to `merge` neighbouring cells of a line made one, and their rows.

    Averaged in the workpiece frame, where a line keeps its direction.
    """
    breaks = (np.diff(seen.at.line) != 0) | (np.diff(seen.row) != 0)
    begin = np.flatnonzero(np.concatenate([[True], breaks]))
    size = np.diff(np.append(begin, len(seen)))
    within = np.arange(len(seen)) - np.repeat(begin, size)
    starts = np.flatnonzero(within % merge == 0)
    count = np.add.reduceat(seen.count, starts)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = (-1,) + (1,) * (values.ndim - 1)
        total = np.add.reduceat(values * seen.count.reshape(shape), starts, axis=0)
        return total / count.reshape(shape)

    firsts = seen.taken(starts)
    at = replace(
        firsts.at, time_s=mean(seen.at.time_s), line_time_s=mean(seen.at.line_time_s)
    )
    travel = mean(seen.direction)  # on an arc it turns on the way
    speed = np.linalg.norm(travel, axis=1, keepdims=True)
    merged = replace(
        firsts,
        at=at,
        tracker_mm=mean(seen.tracker_mm),
        count=count,
        direction=travel / np.maximum(speed, 1e-12),
    )
    return merged, mean(local)


def _centre(seen: Observations) -> tuple[float, float, float]:
    x, y, z = seen.at.point_mm.mean(axis=0)
    return float(x), float(y), float(z)
