"""Motion of the target by an error at one axis, to first order, seen from the tracker.

The chain is p = T_1 … T_n t from the workpiece to the tool. An error sits at the side
of its joint that faces the base for a rotary axis (about the axis' origin), behind the
joint for a linear one; it is of the tool relative to the workpiece. A displacement E
and a turn ω there move the target by F (E + ω × L): L from the error's point to it, F
the nominal turn of everything between the error and the observer. The tracker on the
workpiece sees all axes move the tool; on the base it sees those of the tool side move
the tool and those of the workpiece side move the workpiece, backwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from truepath.kinematics.machine.machine import Machine, compute_turns
from truepath.kinematics.machine.symbols import LINEAR


@dataclass(frozen=True)
class AxisLever:
    """Lever and turn of one axis' errors at n moments.

    lever_mm : (n, 3) L; frame : (n, 3, 3) F, 0 where the error has no effect
    """

    lever_mm: Float64[np.ndarray, "n 3"]
    frame: Float64[np.ndarray, "n 3 3"]

    def displace(
        self, direction: Float64[np.ndarray, "*n 3"], *, is_turn: bool
    ) -> Float64[np.ndarray, "n 3"]:
        """F d, or F (d × L) for a turn.

        direction : one for each moment, or one for all
        """
        arm = np.cross(direction, self.lever_mm) if is_turn else direction
        arm = np.broadcast_to(arm, self.lever_mm.shape)
        return np.einsum("nij,nj->ni", self.frame, arm)


@dataclass(frozen=True)
class NominalChain:
    """The nominal machine at n moments, as seen from where the tracker stands.

    on_workpiece : (n,) the target is on the workpiece; observer : on workpiece or base
    """

    machine: Machine
    position: Float64[np.ndarray, "n a"]
    offset_mm: Float64[np.ndarray, "n 3"]
    on_workpiece: Bool[np.ndarray, " n"]
    observer: str

    @property
    def point_mm(self) -> Float64[np.ndarray, "n 3"]:
        """The target, mm, in the observer's frame."""
        if self.observer == "base":
            return self._base_mm
        seen = self._through(self.machine.workpiece_side, self._base_mm)
        return np.where(self.on_workpiece[:, None], self.offset_mm, seen)

    def lever(self, name: str) -> AxisLever:
        """Lever of the errors of an axis; computed once."""
        if name not in self._levers:  # the same for every error of the axis
            self._levers[name] = self._find_lever(name)
        return self._levers[name]

    @cached_property
    def _levers(self) -> dict[str, AxisLever]:
        return {}

    @cached_property
    def arms(self) -> dict[str, Float64[np.ndarray, "n 3"]]:
        """Displacement of the target per unit of error; filled by `compute_arm`."""
        return {}

    def _find_lever(self, name: str) -> AxisLever:
        machine = self.machine
        if name in machine.workpiece_side:
            side = machine.workpiece_side
            begin = side.index(name) + 1
            lever = self._through(side[begin:], self._base_mm) - self._origin(name)
            frame = self._compose_turns(side[:begin])
            if self.observer == "base":
                frame = -np.swapaxes(self._compose_turns(side[begin:]), 1, 2)
            return AxisLever(lever, self._where(frame, self.observer == "base"))
        side = machine.tool_side
        begin = side.index(name)
        behind = side[begin + (0 if name in self.turns else 1) :]
        lever = self._through(behind, self.offset_mm) - self._origin(name)
        frame = self._to_observer(self._compose_turns(side[:begin]))
        return AxisLever(lever, self._where(frame, False))

    @cached_property
    def tool_frame(self) -> Float64[np.ndarray, "n 3 3"]:
        """Turn of the tool; 0 where the target is not on it."""
        turned = self._compose_turns(self.machine.tool_side)
        return self._where(self._to_observer(turned), False)

    @cached_property
    def workpiece_frame(self) -> Float64[np.ndarray, "n 3 3"]:
        """Turn of the workpiece for the observer; 0 where the target is not on it."""
        if self.observer != "base":
            return self._where(np.eye(3)[None], True)
        turned = np.swapaxes(self._compose_turns(self.machine.workpiece_side), 1, 2)
        return self._where(turned, True)

    @cached_property
    def _base_mm(self) -> Float64[np.ndarray, "n 3"]:
        tool = self._through(self.machine.tool_side, self.offset_mm)
        if not self.on_workpiece.any():
            return tool
        part = self._through(self.machine.workpiece_side, self.offset_mm, back=True)
        return np.where(self.on_workpiece[:, None], part, tool)

    def _where(
        self, frame: Float64[np.ndarray, "n 3 3"], on_workpiece: bool
    ) -> Float64[np.ndarray, "n 3 3"]:
        shows = self.on_workpiece == on_workpiece
        return frame * shows[:, None, None]

    def _to_observer(
        self, frame: Float64[np.ndarray, "n 3 3"]
    ) -> Float64[np.ndarray, "n 3 3"]:
        if self.observer == "base":
            return frame
        return self._compose_turns(self.machine.workpiece_side) @ frame

    def _column(self, name: str) -> Float64[np.ndarray, " n"]:
        return self.position[:, self.machine.axis_names.index(name)]

    @cached_property
    def turns(self) -> dict[str, Float64[np.ndarray, "n 3 3"]]:
        """Nominal turn of each rotary axis, from tool to workpiece."""
        sign = dict.fromkeys(self.machine.workpiece_side, -1.0)
        return {
            axis.name: compute_turns(
                axis, np.radians(self._column(axis.name)) * sign.get(axis.name, 1.0)
            )
            for axis in self.machine.rotary_axes
        }

    def _compose_turns(self, names: tuple[str, ...]) -> Float64[np.ndarray, "n 3 3"]:
        product = np.broadcast_to(np.eye(3), (len(self.position), 3, 3))
        for name in names:
            if name in self.turns:
                product = product @ self.turns[name]
        return product

    def _through(
        self,
        names: tuple[str, ...],
        point_mm: Float64[np.ndarray, "n 3"],
        *,
        back: bool = False,
    ) -> Float64[np.ndarray, "n 3"]:
        """The last joint first.

        back : through the inverse of the joints
        """
        point = point_mm.copy()
        for name in names if back else reversed(names):
            if name in self.turns:
                origin = self._origin(name)
                form = "nji,nj->ni" if back else "nij,nj->ni"
                point = origin + np.einsum(form, self.turns[name], point - origin)
            else:
                way = self._column(name)
                point[:, LINEAR.index(name)] += -way if back else way
        return point

    def _origin(self, name: str) -> Float64[np.ndarray, "3"]:
        """The point about which errors of an axis turn, in its own frame."""
        origins = {axis.name: axis.origin_mm for axis in self.machine.rotary_axes}
        return np.array(origins.get(name, (0.0, 0.0, 0.0)))
