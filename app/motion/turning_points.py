"""Standstill points of machines with rotary axes: all axes, every target in turn."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.errors import PlanningError
from app.kinematics.machine import Machine, Target
from app.motion.configurations import Configurations
from app.motion.travel import DECIMALS, inner_travel

_LEAST_TURN_DEG = 10.0  # or a tenth of the travel


def turning_points(
    machine: Machine, *, count: int, dwell_s: float, seed: int
) -> Configurations:
    """Return random points inside the travel of all axes, a block of them a target.

    From one to the next every rotary axis turns, so that a target on the table moves
    and its standstills are told apart. The same seed gives the same points.
    """
    rng = np.random.default_rng(seed)
    targets = [t.name for t in moving_targets(machine)]
    names = [targets[k * len(targets) // count] for k in range(count)]
    places = [_anywhere(rng, machine)]
    while len(places) < count:
        place = _anywhere(rng, machine)
        turn = np.abs(place - places[-1])[len(machine.linear_axes) :]
        if turn.min() > _least_turn_deg(machine):
            places.append(place)
    return Configurations(
        machine.axis_names,
        np.round(places, DECIMALS),
        np.full(count, dwell_s),
        tuple(names) if any(names) else (),
    )


def moving_targets(machine: Machine) -> tuple[Target, ...]:
    """Return the targets that move where the tracker stands.

    Raises PlanningError if there is none.
    """
    targets = tuple(t for t in machine.targets if moves_where_seen(machine, t))
    if not targets:
        raise PlanningError(
            f"no target of {machine.name} moves where the tracker stands; "
            "state one on the tool in machine.json"
        )
    return targets


def _least_turn_deg(machine: Machine) -> float:
    travel = min(axis.high - axis.low for axis in machine.rotary_axes)
    return min(_LEAST_TURN_DEG, 0.1 * travel)


def moves_where_seen(machine: Machine, target: Target) -> bool:
    """Tell whether a target moves where the tracker stands."""
    from_base = machine.tracker.stands_on == "base"
    if target.on == "workpiece":
        return from_base and bool(machine.workpiece_side)
    return bool(machine.tool_side) or not from_base


def _anywhere(rng: np.random.Generator, machine: Machine) -> Float64[np.ndarray, " a"]:
    low, high = inner_travel(machine)
    return rng.uniform(low, high)
