"""A Run of a machine with large errors, as one whose small errors add.

The estimate is linear: error motions are taken where the command was, and their
displacements add. Of a machine that errs by a millimetre neither is good enough, to
micrometres. A first estimate tells both: where on its line the machine was, and what
its motions do to one another.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.app.alignment.observations import Observations
from truepath.app.estimation.information import Posterior
from truepath.app.estimation.runs import RunInformation
from truepath.app.kinematics.model import MachineModel
from truepath.app.kinematics.second_order import adds_up, compute_second_order_mm


def is_linear(seen: Observations, model: MachineModel, machine: Posterior) -> bool:
    """Tell whether the errors of the machine are small enough to add."""
    return adds_up(model, seen.at, machine.theta)


def linearise_about(
    seen: Observations, run: RunInformation, model: MachineModel, machine: Posterior
) -> Observations:
    """Return the Run with its cells at their places, and second order taken off.

    run : a first estimate of its own pose; machine : of the machine
    """
    theta = machine.theta
    pose = run.linearisation.correct_pose(run.own.restore(machine)[0])
    added_mm = compute_second_order_mm(model, seen.at, theta)
    moved_mm = added_mm + model.displacement_mm(seen.at, theta)
    rest_mm = pose.invert().apply(seen.tracker_mm) - seen.at.point_mm - moved_mm
    position = seen.at.position_mm + _find_lead(seen, rest_mm)
    return replace(
        seen,
        at=replace(seen.at, position_mm=position),
        tracker_mm=seen.tracker_mm - added_mm @ pose.rotation.T,
        pose=pose,
    )


def _find_lead(
    seen: Observations, rest_mm: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n a"]:
    """Return how far the axes were beyond where cells on straight lines were placed.

    rest_mm : measured less modelled. At constant feed a cell is ahead by a constant and
        by another every second; on ramps each by its own.
    """
    at, lead = seen.at, np.zeros_like(seen.at.position_mm)
    ahead = np.einsum("ni,ni->n", rest_mm, seen.direction)
    is_rotary = np.isin(at.machine.axis_names, [a.name for a in at.machine.rotary_axes])
    for first, last in seen.stretches:
        ends = [first, last - 1]
        moved = np.diff(at.position_mm[ends], axis=0)[0]
        way_mm = float(np.diff(at.point_mm[ends], axis=0)[0] @ seen.direction[first])
        if at.line[first] < 0 or last - first < 3 or moved[is_rotary].any():
            continue
        own: Float64[np.ndarray, " k"] = ahead[first:last]
        if not seen.is_ramp[first]:
            root = np.sqrt(seen.count[first:last])
            law = np.column_stack([np.ones(last - first), at.line_time_s[first:last]])
            own = law @ np.linalg.lstsq(law * root[:, None], own * root, rcond=None)[0]
        lead[first:last] = own[:, None] * moved / way_mm
    return lead
