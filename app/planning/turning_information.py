"""What one line tells about a machine with rotary axes, measured on the fly.

As `line_information`, for any chain and any target: the line may be an arc, whose
tangent turns on the way, and the standstill at its end is measured as well.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions, standstill
from app.kinematics.effects.axis_location import axis_locations
from app.kinematics.effects.base import Effect
from app.kinematics.effects.error_motion import error_motion
from app.kinematics.effects.squareness import squareness_between
from app.kinematics.effects.tool_orientation import tool_orientation
from app.kinematics.effects.tracker_pose import TrackerPose
from app.kinematics.effects.workpiece_placement import workpiece_placement
from app.kinematics.machine import Axis, Machine, RotaryAxis, Target
from app.kinematics.model import MachineModel
from app.kinematics.symbols import error_motions
from app.numerics.design_criteria import Belief
from app.planning.line_information import SIGMA_MM, Knowledge, prior_covariance

POINTS_A_LINE = 12  # an arc bends: more than a straight line takes
_VOLUME = 400  # configurations that stand for the volume
_INTERVALS, _INTERVALS_TURNING = 3, 6  # of the knots: enough to choose by


def nothing_known_of_turning(machine: Machine) -> Knowledge:
    """Return the state before the first line, all axes looked at."""
    low = np.array([axis.low for axis in machine.axes])
    high = np.array([axis.high for axis in machine.axes])
    anywhere = np.random.default_rng(0).uniform(low, high, (_VOLUME, len(low)))
    volume = standstill(machine, anywhere)
    x, y, z = (float(v) for v in volume.point_mm.mean(axis=0))
    model = MachineModel(machine, (*_effects(machine), TrackerPose((x, y, z))))
    columns = model.jacobian(volume).reshape(3 * len(volume), -1)
    pose = columns[:, model.slices["tracker-pose"]]
    columns = columns - pose @ (np.linalg.pinv(pose) @ columns)
    gram = columns.T @ columns / len(volume)
    return Knowledge(model, Belief(prior_covariance(model), gram))


def turning_conditions(
    machine: Machine,
    target: Target,
    begin: Float64[np.ndarray, "m a"],
    end: Float64[np.ndarray, "m a"],
) -> Conditions:
    """Return the conditions at evenly spread points of m lines, ends included."""
    share = np.linspace(0.0, 1.0, POINTS_A_LINE)
    at = begin[:, None] + share[None, :, None] * (end - begin)[:, None]
    position = at.reshape(-1, begin.shape[1])
    offset = np.tile(np.array(target.offset_mm, np.float64), (len(position), 1))
    aside = np.full(len(position), target.on == "workpiece")
    still = standstill(machine, position, offset)
    return still.view_from(machine.tracker.stands_on, aside)


def turning_rows(
    known: Knowledge, at: Conditions, slope_mm: Float64[np.ndarray, "m k 3"]
) -> Float64[np.ndarray, "m r p"]:
    """Return the rows of m lines, in units of the noise.

    at : from `turning_conditions`
    slope_mm : change of the target's place with the share of the line
    """
    m, k = slope_mm.shape[:2]
    columns = known.model.jacobian(at).reshape(m, k, 3, -1)
    pace = np.linalg.norm(slope_mm, axis=2)
    direction = slope_mm / np.maximum(pace, 1e-9)[:, :, None]
    along = np.einsum("mkd,mkdp->mkp", direction, columns)
    across = columns - direction[:, :, :, None] * along[:, :, None, :]
    share = np.linspace(0.0, 1.0, k)
    law = np.stack([pace, pace * share], axis=2)  # late by a phase, and by a speed
    along = along - law @ (np.linalg.pinv(law) @ along)
    rows = np.concatenate([across, along[:, :, None]], axis=2).reshape(m, 4 * k, -1)
    return np.concatenate([rows, columns[:, -1]], axis=1) / SIGMA_MM


def slopes_mm(at: Conditions) -> Float64[np.ndarray, "m k 3"]:
    """Return how the target's place changes with the share of each line."""
    place = at.point_mm.reshape(-1, POINTS_A_LINE, 3)
    return np.asarray(np.gradient(place, 1.0 / (POINTS_A_LINE - 1), axis=1), np.float64)


def _effects(machine: Machine) -> tuple[Effect, ...]:
    found: list[Effect] = [
        error_motion(symbol, axis, _intervals(axis))
        for axis in machine.axes
        for symbol in error_motions(axis.name)
    ]
    found += squareness_between(machine.axis_names)
    for axis in machine.rotary_axes:
        found += axis_locations(axis)

    def offsets(side: str) -> Float64[np.ndarray, "t 3"]:
        rows = [t.offset_mm for t in machine.targets if t.on == side]
        return np.array(rows, np.float64).reshape(-1, 3)

    tool, part = offsets("tool"), offsets("workpiece")
    if len(tool):
        found += tool_orientation(machine, tool)
    if len(part) and machine.tracker.stands_on == "base":
        found += workpiece_placement(part)
    return tuple(found)


def _intervals(axis: Axis) -> int:
    return _INTERVALS_TURNING if isinstance(axis, RotaryAxis) else _INTERVALS
