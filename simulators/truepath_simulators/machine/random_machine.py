"""Random machines with typical errors of machine tools, and one on a rack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from truepath_simulators.machine import error_motions
from truepath_simulators.machine.error_motions import (
    JointedMotion,
    TurningMotion,
    across_the_axis,
    along_the_axis,
)
from truepath_simulators.machine.joints import (
    Joint,
    LinearJoint,
    RotaryJoint,
    rotation_matrices,
)
from truepath_simulators.machine.truth_machine import SQUARENESS, TruthMachine
from truepath_simulators.machine_file import (
    DIRECTIONS,
    ROTARY_DIRECTIONS,
    LinearAxis,
    MachineFile,
    RotaryAxis,
)
from truepath_simulators.randomness import generator

# Smallest and largest peak of the random errors, as machine tools have them.
_POSITIONING_UM = (5.0, 40.0)
_STRAIGHTNESS_UM = (2.0, 15.0)
_ANGULAR_URAD = (5.0, 40.0)
_SQUARENESS_URAD = (5.0, 60.0)
_LOCATION_UM = (5.0, 60.0)


def random_machine(
    machine: MachineFile,
    seed: int,
    scale: float = 1.0,
) -> TruthMachine:
    """Random error motions and squareness; `scale` multiplies every one of them."""
    rng = generator(seed, "errors of the machine")
    squareness = {
        name: scale * 1e-6 * _peak(rng, _SQUARENESS_URAD) * rng.choice([-1, 1])
        for name in SQUARENESS
    }
    joints: dict[str, Joint] = {
        axis.name: _random_joint(rng, axis, squareness, scale)
        for axis in machine.linear_axes
    }
    for turning in machine.rotary_axes:
        joints[turning.name] = _random_rotary_joint(
            rng, turning, turning.name in machine.workpiece_side, scale
        )
    return TruthMachine(machine, joints, squareness)


def join_rack(
    truth: TruthMachine,
    axis: str,
    seed: int,
    step_mm: float,
    piece_mm: float = 1000.0,
    width_mm: float = 40.0,
) -> TruthMachine:
    """The machine with a rack of pieces: its positioning steps at each joint."""
    joint = truth.joints[axis]
    if not isinstance(joint, LinearJoint):
        raise TypeError(f"{axis} does not run on a rack")
    travel = truth.machine.axes[truth.machine.axis_names.index(axis)]
    places = np.arange(travel.low + 0.5 * piece_mm, travel.high, piece_mm)
    signs = generator(seed, "joints of the rack").choice([-1.0, 1.0], len(places))
    own = list(DIRECTIONS).index(axis)
    motions = list(joint.translation)
    smooth = motions[own]
    if isinstance(smooth, JointedMotion):
        raise TypeError(f"{axis} runs on a rack already")
    steps = tuple((step_mm * signs).tolist())
    motions[own] = JointedMotion(smooth, tuple(places.tolist()), steps, width_mm)
    jointed = replace(joint, translation=tuple(motions))
    return replace(truth, joints={**truth.joints, axis: jointed})


def _random_joint(
    rng: np.random.Generator,
    axis: LinearAxis,
    squareness: Mapping[str, float],
    scale: float,
) -> LinearJoint:
    translation = [
        error_motions.positioning(rng, axis, 1e-3 * _peak(rng, _POSITIONING_UM))
        if name == axis.name
        else error_motions.straightness(rng, axis, 1e-3 * _peak(rng, _STRAIGHTNESS_UM))
        for name in DIRECTIONS
    ]
    rotation = [
        error_motions.angular(rng, axis, 1e-6 * _peak(rng, _ANGULAR_URAD))
        for _ in DIRECTIONS
    ]
    return LinearJoint(
        axis.name,
        DIRECTIONS[axis.name],
        _travel_direction(axis.name, squareness),
        tuple(motion.scale(scale) for motion in translation),
        tuple(motion.scale(scale) for motion in rotation),
    )


def _random_rotary_joint(
    rng: np.random.Generator,
    axis: RotaryAxis,
    on_workpiece: bool,
    scale: float,
) -> RotaryJoint:
    own = [value != 0.0 for value in ROTARY_DIRECTIONS[axis.name]]

    def motions(unit: float, limits: tuple[float, float]) -> tuple[TurningMotion, ...]:
        drawn = [
            (along_the_axis if along else across_the_axis)(
                rng, axis, unit * _peak(rng, limits)
            )
            for along in own
        ]
        return tuple(motion.scale(scale) for motion in drawn)

    def location(unit: float, limits: tuple[float, float]) -> tuple[float, ...]:
        drawn = [scale * unit * _peak(rng, limits) * rng.choice([-1, 1]) for _ in own]
        return tuple(
            0.0 if along else float(value)
            for along, value in zip(own, drawn, strict=True)
        )

    return RotaryJoint(
        axis,
        on_workpiece,
        motions(1e-3, _STRAIGHTNESS_UM),
        motions(1e-6, _ANGULAR_URAD),
        location(1e-3, _LOCATION_UM),
        location(1e-6, _SQUARENESS_URAD),
    )


def _peak(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(rng.uniform(*limits))


def _travel_direction(axis: str, squareness: Mapping[str, float]) -> tuple[float, ...]:
    about = dict.fromkeys(DIRECTIONS, 0.0)
    for name, (turned, around) in SQUARENESS.items():
        if turned == axis:
            about[around] = squareness[name]
    turn = rotation_matrices(*(np.array([about[name]]) for name in DIRECTIONS))[0]
    return tuple((turn @ DIRECTIONS[axis]).tolist())
