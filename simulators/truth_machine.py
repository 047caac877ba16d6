"""Where the tool of an imperfect machine really is: exact homogeneous transforms.

A joint answers with the transform from its tool-side carriage to its workpiece-side
carriage, whichever of the two is the one that moves; the chain multiplies them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from simulators import error_motions
from simulators.error_motions import ErrorMotion, JointedMotion
from simulators.joint import Joint, rotation_matrices
from simulators.machine_file import (
    DIRECTIONS,
    ROTARY_DIRECTIONS,
    LinearAxis,
    MachineFile,
    Reflector,
    RotaryAxis,
)
from simulators.randomness import generator
from simulators.rotary_joint import RotaryJoint
from simulators.turning_motions import (
    TurningMotion,
    across_the_axis,
    along_the_axis,
)

# Squareness of an axis: the rotation of its direction of travel about another.
SQUARENESS = {"C0Y": ("Y", "Z"), "B0Z": ("Z", "Y"), "A0Z": ("Z", "X")}
_CHUNK = 20_000
Carried = Mapping[str, np.ndarray]
_TURN_ABOUT = {"X": "A", "Y": "B", "Z": "C"}


# Smallest and largest peak of the random errors, as machine tools have them.
_POSITIONING_UM = (5.0, 40.0)
_STRAIGHTNESS_UM = (2.0, 15.0)
_ANGULAR_URAD = (5.0, 40.0)
_SQUARENESS_URAD = (5.0, 60.0)
_LOCATION_UM = (5.0, 60.0)


@dataclass(frozen=True, slots=True)
class LinearJoint(Joint):
    """A straight axis with six error motions.

    axis : its letter
    nominal_direction, direction : unit vectors of travel, as it should be and as it is
    translation : error motions along X, Y, Z, in mm
    rotation : error motions about X, Y, Z, in rad
    """

    axis: str
    nominal_direction: tuple[float, ...]
    direction: tuple[float, ...]
    translation: tuple[ErrorMotion | JointedMotion, ...]
    rotation: tuple[ErrorMotion, ...]

    @property
    def name(self) -> str:
        """Letter of the axis."""
        return self.axis

    def actual(self, position: np.ndarray) -> np.ndarray:
        """Return Trans(s d) Trans(E) Rz(EC) Ry(EB) Rx(EA)."""
        transform = np.zeros((len(position), 4, 4))
        transform[:, :3, :3] = rotation_matrices(
            *(motion.at(position) for motion in self.rotation)
        )
        transform[:, :3, 3] = np.outer(position, self.direction)
        for k, motion in enumerate(self.translation):
            transform[:, k, 3] += motion.at(position)
        transform[:, 3, 3] = 1.0
        return transform

    def nominal(self, position: np.ndarray) -> np.ndarray:
        """Return Trans(s e)."""
        transform = np.broadcast_to(np.eye(4), (len(position), 4, 4)).copy()
        transform[:, :3, 3] = np.outer(position, self.nominal_direction)
        return transform

    def carry(self, transform: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Return transforms with further error motions: shifts before, turns after."""
        moved = transform.copy()
        moved[:, :3, :3] = moved[:, :3, :3] @ rotation_matrices(*motions[:, 3:].T)
        moved[:, :3, 3] += motions[:, :3]
        return moved


@dataclass(frozen=True, slots=True)
class TruthMachine:
    """A nominal machine and its joints, keyed by axis."""

    machine: MachineFile
    joints: Mapping[str, Joint]
    squareness_rad: Mapping[str, float] = field(default_factory=dict)

    def error_motions(self) -> dict[str, ErrorMotion | JointedMotion | TurningMotion]:
        """Return every error motion by its symbol, `EXX` … `ECC`, in mm and rad."""
        return {
            f"E{letter}{name}": motion
            for name, joint in self.joints.items()
            if isinstance(joint, LinearJoint | RotaryJoint)
            for letter, motion in zip(
                "XYZABC", joint.translation + joint.rotation, strict=True
            )
        }

    def locations(self) -> dict[str, float]:
        """Return the location of every rotary axis, `XOC` … `BOC`, in mm and rad."""
        return {
            f"{letter}O{name}": value
            for name, joint in self.joints.items()
            if isinstance(joint, RotaryJoint)
            for letter, value in zip(
                "XYZABC", joint.shift_mm + joint.tilt_rad, strict=True
            )
            if name not in (letter, _TURN_ABOUT.get(letter))
        }

    def deviation_mm(self, q: np.ndarray, target: str = "") -> np.ndarray:
        """Return actual minus nominal tool point in the workpiece frame, (n, 3).

        q : (n, axes) axis positions in column order
        """
        reflector = self.machine.reflector(target)
        return self.point_mm(q, reflector) - self.nominal_point_mm(q, reflector)

    def locate_target_mm(
        self, q: np.ndarray, target: str = "", carry: Carried | None = None
    ) -> np.ndarray:
        """Return where a target is in the frame that the tracker stands on, (n, 3)."""
        return self.point_mm(
            q, self.machine.reflector(target), self.machine.tracker.stands_on, carry
        )

    def point_mm(
        self,
        q: np.ndarray,
        reflector: Reflector,
        frame: str = "workpiece",
        carry: Carried | None = None,
    ) -> np.ndarray:
        """Return where a reflector is, in the frame `workpiece` or `base`, (n, 3).

        carry : what joints do beyond their error motions at each of the positions
        """
        point = np.empty((len(q), 3))
        for start in range(0, len(q), _CHUNK):
            part = slice(start, start + _CHUNK)
            more = {axis: value[part] for axis, value in (carry or {}).items()}
            point[part] = self._place(q[part], reflector, frame, more)
        return point

    def nominal_point_mm(
        self, q: np.ndarray, reflector: Reflector, frame: str = "workpiece"
    ) -> np.ndarray:
        """Return where it should be, in the frame `workpiece` or `base`, (n, 3)."""
        point = np.empty((len(q), 3))
        for start in range(0, len(q), _CHUNK):
            part = slice(start, start + _CHUNK)
            point[part] = self._place(q[part], reflector, frame, None)
        return point

    def _place(
        self, q: np.ndarray, reflector: Reflector, frame: str, carry: Carried | None
    ) -> np.ndarray:
        """Return p = T_wb T_bt t in the workpiece, T_bt t in the base.

        A reflector on the workpiece is T_wb^-1 t in the base.
        """
        point = np.empty((len(q), 4, 1))
        point[:, :, 0] = (*reflector.offset_mm, 1.0)
        if reflector.on == "workpiece":
            if frame == "base":
                side = self.machine.workpiece_side
                table = self._product(side, q, np.eye(4), carry)
                point = np.linalg.solve(table, point)
            return point[:, :3, 0]
        side = self.machine.tool_side
        if frame == "workpiece":
            side = self.machine.workpiece_side + side
        return self._product(side, q, point, carry)[:, :3, 0]

    def _product(
        self,
        side: tuple[str, ...],
        q: np.ndarray,
        last: np.ndarray,
        carry: Carried | None,
    ) -> np.ndarray:
        """Multiply the joints as they are, or as they should be without `carry`."""
        product = np.broadcast_to(last, (len(q), *last.shape[-2:]))
        for name in reversed(side):
            joint = self.joints[name]
            position = q[:, self.machine.axis_names.index(name)]
            if carry is None:
                step = joint.nominal(position)
            else:
                step = joint.actual(position)
                if name in carry:
                    step = joint.carry(step, carry[name])
            product = step @ product
        return product


def perfect(machine: MachineFile) -> TruthMachine:
    """Return the machine without any error."""
    joints: dict[str, Joint] = {}
    for axis in machine.linear_axes:
        still = error_motions.none(axis)
        direction = DIRECTIONS[axis.name]
        joints[axis.name] = LinearJoint(
            axis.name, direction, direction, (still,) * 3, (still,) * 3
        )
    for turning in machine.rotary_axes:
        none = (TurningMotion(turning),) * 3
        side = turning.name in machine.workpiece_side
        joints[turning.name] = RotaryJoint(turning, side, none, none)
    return TruthMachine(machine, joints, dict.fromkeys(SQUARENESS, 0.0))


def random_machine(
    machine: MachineFile,
    seed: int,
    scale: float = 1.0,
) -> TruthMachine:
    """Draw error motions and squareness; `scale` multiplies every one of them."""
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
    """Return the machine with a rack of pieces: its positioning steps at each joint."""
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
