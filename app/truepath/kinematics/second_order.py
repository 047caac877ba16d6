"""Interaction of small motions: second order of the composed transforms.

The errors of an axis turn and shift all that is beyond it, seen from the observer. To
first order displacements add. To second order the turn Ω of an axis turns what axes
beyond it displace as well, and its own arc bends: Ω × (Σ d beyond + ½ Ω × arm). Errors
of 0.1 mm give some nanometres; errors of 1 mm and 1 mrad give a micrometre.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import MachineModel

_SMALL_MM = 1e-4
_FEW = 200
_ARM_MM = 100.0  # by which a target is moved to determine a turn


def compute_second_order_mm(
    model: MachineModel, at: Conditions, theta: Float64[np.ndarray, " p"]
) -> Float64[np.ndarray, "n 3"]:
    """Difference between the composed motions and their linear sum."""
    by_axis = _group_by_axis(model)
    added, beyond = np.zeros((len(at), 3)), np.zeros((len(at), 3))
    for axis in reversed(_order_from_observer(at.machine, at.observer)):
        if axis in by_axis:
            turn = _find_turn(model, by_axis[axis], at, theta)
            arc = np.cross(turn, _arm_mm(at, axis))
            added += np.cross(turn, beyond + 0.5 * arc)
            beyond += _displace(model, by_axis[axis], at, theta)
    return added


def is_nearly_linear(
    model: MachineModel, at: Conditions, theta: Float64[np.ndarray, " p"]
) -> bool:
    """Whether displacements add to 0.1 µm, checked at a few moments."""
    few = at.select(np.arange(0, len(at), max(1, len(at) // _FEW)))
    added_mm = compute_second_order_mm(model, few, theta)
    return bool(np.abs(added_mm).max(initial=0.0) < _SMALL_MM)


def _group_by_axis(model: MachineModel) -> dict[str, list[Effect]]:
    found: dict[str, list[Effect]] = {}
    for effect in model.effects:
        curve = effect.half_difference
        symbol = effect.iso_symbol or (curve.symbol if curve else "")
        if symbol:
            found.setdefault(symbol[2], []).append(effect)
    return found


def _order_from_observer(machine: Machine, observer: str) -> tuple[str, ...]:
    """From the base the chain goes to the tool, or backwards to the workpiece."""
    if observer == "base":
        return (*reversed(machine.workpiece_side), *machine.tool_side)
    return (*machine.workpiece_side, *machine.tool_side)


def _displace(
    model: MachineModel,
    effects: list[Effect],
    at: Conditions,
    theta: Float64[np.ndarray, " p"],
) -> Float64[np.ndarray, "n 3"]:
    moved = np.zeros((len(at), 3))
    for effect in effects:
        moved += effect.displacement_mm(at, theta[model.slices[effect.name]])
    return moved


def _arm_mm(at: Conditions, axis: str) -> Float64[np.ndarray, "n 3"]:
    lever = at.chain.lever(axis)
    # Seen from the base, the workpiece turns the other way.
    sign = np.sign(np.linalg.det(lever.frame))
    arm = np.einsum("nij,nj->ni", lever.frame, lever.lever_mm)
    return sign[:, None] * arm


def _find_turn(
    model: MachineModel,
    effects: list[Effect],
    at: Conditions,
    theta: Float64[np.ndarray, " p"],
) -> Float64[np.ndarray, "n 3"]:
    frame = at.chain.tool_frame + at.chain.workpiece_frame
    here = _displace(model, effects, at, theta)
    turn = np.zeros((len(at), 3))
    for k in range(3):
        farther = at.offset_mm + _ARM_MM * np.eye(3)[k]
        there = _displace(model, effects, replace(at, offset_mm=farther), theta)
        # Σ a × (Ω × a) = 2 Ω over three directions a that are square to each other.
        turn += 0.5 * np.cross(frame[:, :, k], (there - here) / _ARM_MM)
    return turn
