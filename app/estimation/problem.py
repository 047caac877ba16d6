"""Observations as a linear problem in θ: measured minus nominal, in the beam frame.

The pose is linearised about its latest value and solved jointly with the errors, never
by fitting points to the closest point of the path, which drags errors into the pose.
"""

from __future__ import annotations

from collections.abc import Sequence
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


@dataclass(frozen=True, slots=True)
class Problem:
    """Rows of all cells, data in the last column.

    model : machine effects, then pose, then timing laws
    machine_model : the machine effects alone, whose parameters come first
    frame : (n, 3, 3) workpiece to beam frame
    rows : (n, 3, p + 1)
    """

    seen: Observations
    model: MachineModel
    machine_model: MachineModel
    pose: RigidTransform
    frame: Float64[np.ndarray, "n 3 3"]
    rows: Float64[np.ndarray, "n 3 q"]


def pose_problem(
    seen: Observations,
    machine_model: MachineModel,
    pose: RigidTransform,
    *,
    timing: bool = True,
) -> Problem:
    """Return the problem of all effects, pose and timing laws about the given pose.

    timing : False where nothing along the travel is used, so that no timing is told
    """
    nuisances: list[TrackerPose | TimingLaw] = [TrackerPose(_centre(seen))]
    lines = np.unique(seen.at.line[seen.at.line >= 0])
    if len(lines) and timing:
        nuisances.append(TimingLaw(tuple(int(line) for line in lines)))
    model = machine_model.with_effects(*nuisances)
    frame = beam_frame(seen.tracker_mm) @ pose.rotation
    off = pose.inverse().apply(seen.tracker_mm) - seen.at.point_mm
    local = np.concatenate([model.jacobian(seen.at), off[:, :, None]], axis=2)
    rows = np.matmul(frame, local)
    return Problem(seen, model, machine_model, pose, frame, rows)


def with_machine_effects(problem: Problem, effects: Sequence[Effect]) -> Problem:
    """Return the problem with some of its machine effects only."""
    keep = np.append(columns_with(problem, effects), True)
    machine = MachineModel(problem.model.machine, tuple(effects))
    nuisances = problem.model.effects[len(problem.machine_model.effects) :]
    return replace(
        problem,
        model=machine.with_effects(*nuisances),
        machine_model=machine,
        rows=problem.rows[:, :, keep],
    )


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
    shift, turn = theta[part][:3], theta[part][3:]
    centre = problem.seen.at.point_mm.mean(axis=0)
    return problem.pose.after_small(turn, shift - np.cross(turn, centre))


def coarser(problem: Problem, merge: int) -> Problem:
    """Return the problem with up to `merge` neighbouring cells of a line made one.

    The noise's slow part shows as well in the coarser cells, at a fraction of the cost.
    """
    seen = problem.seen
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
    # Averaged in the workpiece frame, where a line keeps its direction.
    local = mean(np.matmul(np.swapaxes(problem.frame, 1, 2), problem.rows))
    frame = beam_frame(merged.tracker_mm) @ problem.pose.rotation
    return replace(problem, seen=merged, frame=frame, rows=np.matmul(frame, local))


def _centre(seen: Observations) -> tuple[float, float, float]:
    x, y, z = seen.at.point_mm.mean(axis=0)
    return float(x), float(y), float(z)
