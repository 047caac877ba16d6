"""Actual tool position of an imperfect machine: exact homogeneous transforms.

A joint gives the transform from its tool-side carriage to its workpiece-side carriage,
whichever of the two moves; the chain multiplies them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from truepath_simulators.machine import error_motions
from truepath_simulators.machine.error_motions import (
    ErrorMotion,
    JointedMotion,
    TurningMotion,
)
from truepath_simulators.machine.joints import Joint, LinearJoint, RotaryJoint
from truepath_simulators.machine_file import (
    DIRECTIONS,
    MachineFile,
    Reflector,
)

# Squareness of an axis: the rotation of its direction of travel about another.
SQUARENESS = {"C0Y": ("Y", "Z"), "B0Z": ("Z", "Y"), "A0Z": ("Z", "X")}
_CHUNK = 20_000
Carried = Mapping[str, np.ndarray]
_TURN_ABOUT = {"X": "A", "Y": "B", "Z": "C"}


@dataclass(frozen=True, slots=True)
class TruthMachine:
    """A nominal machine and its joints, keyed by axis."""

    machine: MachineFile
    joints: Mapping[str, Joint]
    squareness_rad: Mapping[str, float] = field(default_factory=dict)

    def error_motions(self) -> dict[str, ErrorMotion | JointedMotion | TurningMotion]:
        """Every error motion by its symbol, `EXX` … `ECC`, in mm and rad."""
        return {
            f"E{letter}{name}": motion
            for name, joint in self.joints.items()
            if isinstance(joint, LinearJoint | RotaryJoint)
            for letter, motion in zip(
                "XYZABC", joint.translation + joint.rotation, strict=True
            )
        }

    def locations(self) -> dict[str, float]:
        """Location errors of every rotary axis, `XOC` … `BOC`, in mm and rad."""
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
        """Actual minus nominal tool point in the workpiece frame, (n, 3).

        q : (n, axes) axis positions in column order
        """
        reflector = self.machine.reflector(target)
        return self.point_mm(q, reflector) - self.nominal_point_mm(q, reflector)

    def locate_target_mm(
        self, q: np.ndarray, target: str = "", carry: Carried | None = None
    ) -> np.ndarray:
        """Actual target in the frame on which the tracker stands, (n, 3)."""
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
        """Actual reflector in the frame `workpiece` or `base`, (n, 3).

        carry : further error motions of joints at each of the positions
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
        """Nominal reflector in the frame `workpiece` or `base`, (n, 3)."""
        point = np.empty((len(q), 3))
        for start in range(0, len(q), _CHUNK):
            part = slice(start, start + _CHUNK)
            point[part] = self._place(q[part], reflector, frame, None)
        return point

    def _place(
        self, q: np.ndarray, reflector: Reflector, frame: str, carry: Carried | None
    ) -> np.ndarray:
        """Point p = T_wb T_bt t in the workpiece, T_bt t in the base.

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
