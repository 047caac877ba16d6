"""What would separate confounded error motions: a longer tool, or a target to the side.

A turn of an axis that carries the target at a constant arm moves it like a displacement
of the same axis. Two arms separate them: the turn is the difference of both
displacements over the difference of the arms, so its standard uncertainty is √2 u / ΔL,
u that of the displacement found with one tool. ΔL follows from the requirement that the
turn is known as well as the turns that one tool determines; where no tool is long
enough for that, to half of a typical one (k = 2).

Arms of a rotary axis turn with it, and such a length means nothing: there a trial
target shows whether one more is enough, by the rank that it adds, and which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.effects.error_motion import ErrorMotion, get_typical_size
from truepath.kinematics.identifiable import Confounded, build_identifiable_model
from truepath.kinematics.machine.machine import Machine, Target
from truepath.kinematics.machine.symbols import DIRECTION, describe_symbol, is_turn
from truepath.kinematics.model import MachineModel

_ENOUGH_RAD = get_typical_size("EAX") / 4.0  # k = 1: half of a typical turn at k = 2
_STEP_MM = 10.0  # resolution of lengths in sentences
_TRIAL_MM = 93.7  # by which a trial target is farther: no target is likely there
_SHAPES = 4  # intervals of the knots: confounding does not depend on them
_GRID = 25  # positions of an axis, to average over
# Trials in this order: the first that separates is proposed.
_TRIALS = {
    "tool{} longer or shorter": (0.0, 0.0, 1.0),
    "target{} to the side, in X or Y,": (0.6, 0.8, 0.0),
}
_LONGEST_MM = 500.0  # longest proposal


def describe_confounded(
    offsets_mm: Float64[np.ndarray, "n 3"],
    merged: Sequence[Confounded],
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> tuple[str, ...]:
    """One sentence for each confounded motion: its partners and what separates them.

    offsets_mm : of the measured targets
    model, covariance : of the determined effects, to find the required length
    """
    measured = np.unique(offsets_mm, axis=0)
    still = {
        what: _find_still_merged(model.machine, measured, np.array(way))
        for what, way in (_TRIALS.items() if merged else ())
    }
    return tuple(_statement(m, len(measured), still, model, covariance) for m in merged)


def _find_still_merged(
    machine: Machine,
    measured: Float64[np.ndarray, "t 3"],
    way: Float64[np.ndarray, "3"],
) -> set[str]:
    on_tool = next((t for t in machine.targets if t.on == "tool"), None)
    added = np.array(on_tool.offset_mm if on_tool else (0.0, 0.0, 0.0))
    added = added + _TRIAL_MM * way
    x, y, z = (float(v) for v in added)
    second = Target("second", "tool", (x, y, z))
    tried = replace(machine, targets=(*machine.targets, second))
    _, merged = build_identifiable_model(
        tried, np.vstack([measured, added]), intervals=_SHAPES
    )
    return {m.symbol for m in merged}


def _statement(
    merged: Confounded,
    tools: int,
    still: dict[str, set[str]],
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> str:
    said = f"{merged.symbol} ({describe_symbol(merged.symbol)})"
    if merged.partners:
        with_what = "one tool length" if tools == 1 else "the measured tool offsets"
        partners = " and ".join(merged.partners)
        said += f" is not distinguishable from {partners} with {with_what}"
    else:
        said += " does not move the target"
    if _asks_for_the_table(merged.symbol, model.machine):
        return f"{said}; targets on the workpiece, three off one line, show it"
    cure = next((w for w, names in still.items() if merged.symbol not in names), "")
    if not cure:
        return f"{said}; other targets, off one line with these, separate it"
    asked = f"a {'second' if tools == 1 else 'further'} {cure}"
    does = "separates them" if merged.partners else "shows it"
    linear = {axis.name for axis in model.machine.linear_axes}
    if not is_turn(merged.symbol) or merged.symbol[2] not in linear:
        return f"{said}; {asked.format('')} {does}"
    way = np.array(_TRIALS[cure])
    for wanted in (min(_typical_turn(model, covariance), _ENOUGH_RAD), _ENOUGH_RAD):
        length_mm = _length_mm(merged.symbol, way, wanted, model, covariance)
        if length_mm <= _LONGEST_MM:
            return (
                f"{said}; {asked.format(f' at least {length_mm:.0f} mm')} {does} "
                f"(to {2e6 * wanted:.1f} µrad, k = 2, on the same path)"
            )
    return (
        f"{said}; the lines or points determine too little for any tool to change that"
    )


def _asks_for_the_table(symbol: str, machine: Machine) -> bool:
    """True if the axis moves the workpiece, which carries no target yet.

    A tracker on the base sees such an axis by targets on the workpiece alone.
    """
    from_base = machine.tracker.stands_on == "base"
    there = any(t.on == "workpiece" for t in machine.targets)
    return from_base and not there and symbol[2] in machine.workpiece_side


def _typical_turn(model: MachineModel, covariance: Float64[np.ndarray, "p p"]) -> float:
    turns = [motion for motion in model.error_motions if is_turn(motion.symbol)]
    return float(np.median([_sigma(m, model, covariance) for m in turns] or [np.inf]))


def _length_mm(
    symbol: str,
    way: Float64[np.ndarray, "3"],
    wanted_rad: float,
    model: MachineModel,
    covariance: Float64[np.ndarray, "p p"],
) -> float:
    """Required additional length, rounded up.

    Along each direction the turn is known to √2 u / ΔL; directions add information.
    """
    moves = np.cross(np.eye(3)[DIRECTION[symbol[1]]], way)
    information = sum(
        (float(moves[DIRECTION[m.symbol[1]]]) / _sigma(m, model, covariance)) ** 2
        for m in _displacements(model, symbol[2])
    )
    if information <= 0.0:
        return np.inf
    exact = np.sqrt(2.0 / information) / wanted_rad
    return float(max(_STEP_MM, _STEP_MM * np.ceil(exact / _STEP_MM)))


def _displacements(model: MachineModel, axis: str) -> list[ErrorMotion]:
    return [
        motion
        for motion in model.error_motions
        if motion.axis.name == axis and not is_turn(motion.symbol)
    ]


def _sigma(
    motion: ErrorMotion, model: MachineModel, covariance: Float64[np.ndarray, "p p"]
) -> float:
    part = model.slices[motion.name]
    rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, _GRID))
    variance = np.einsum("np,np->n", rows @ covariance[part, part], rows)
    return max(float(np.sqrt(np.maximum(variance, 0.0).mean())), 1e-9)
