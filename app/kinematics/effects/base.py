"""What an effect answers, and under which conditions it is asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from app.kinematics.chain import nominal_point_mm
from app.kinematics.machine import Machine
from app.kinematics.reach import NominalChain
from app.kinematics.symbols import DIRECTION


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a recording tells of n moments beside the state of the machine.

    rate : (n, axes) mm/s or deg/s of each axis, 0 at a standstill
    span_s : (n,) how long the moment lasts: the time over which samples were averaged
    since_reversal : (n, axes) mm or deg since the axis last changed its direction, inf
        where it has not
    tracker_mm : (n, 3) point in the tracker's frame
    rotation : (3, 3) frame of the workpiece, or base, to that of the tracker
    temperature_degc : (n, sensors) of the named sensors
    """

    rate: Float64[np.ndarray, "n a"]
    span_s: Float64[np.ndarray, " n"]
    since_reversal: Float64[np.ndarray, "n a"]
    tracker_mm: Float64[np.ndarray, "n 3"]
    rotation: Float64[np.ndarray, "3 3"]
    sensors: tuple[str, ...] = ()
    temperature_degc: Float64[np.ndarray, "n s"] | None = None

    def taken(self, rows: Int64[np.ndarray, " m"]) -> Surroundings:
        """Return those of some of the moments."""
        celsius = self.temperature_degc
        return replace(
            self,
            rate=self.rate[rows],
            span_s=self.span_s[rows],
            since_reversal=self.since_reversal[rows],
            tracker_mm=self.tracker_mm[rows],
            temperature_degc=None if celsius is None else celsius[rows],
        )


@dataclass(frozen=True)
class Conditions:
    """The state of the machine at n moments.

    position_mm : (n, axes) nominal axis positions, in the machine's column order
    offset_mm : (n, 3) offset of the measured target
    time_s : (n,) the tracker's clock
    line : (n,) row of the path that the machine moves towards, -1 at a standstill
    line_time_s : (n,) time from the middle of that line
    velocity_mm_s : (n, 3) commanded velocity, 0 at a standstill
    approach : (n, axes) sign of each axis' last motion, 0 where it has not moved yet
    seen_from : what the observer stands on, `workpiece` or `base`; the volumetric error
        is that of the tool seen from the workpiece
    on_workpiece : (n,) the target is on the workpiece; nowhere where left out
    line_speed_mm_s : (n,) mean speed along that line where it differs from the velocity
        because the line is an arc
    run : which of the Runs of an estimate, for effects that belong to one of them
    around : what the recording tells beside; effects that need it are nothing without
    """

    machine: Machine
    position_mm: Float64[np.ndarray, "n a"]
    offset_mm: Float64[np.ndarray, "n 3"]
    time_s: Float64[np.ndarray, " n"]
    line: Int64[np.ndarray, " n"]
    line_time_s: Float64[np.ndarray, " n"]
    velocity_mm_s: Float64[np.ndarray, "n 3"]
    approach: Float64[np.ndarray, "n a"]
    seen_from: str = "workpiece"
    on_workpiece: Bool[np.ndarray, " n"] | None = None
    line_speed_mm_s: Float64[np.ndarray, " n"] | None = None
    run: int = 0
    around: Surroundings | None = None

    def __len__(self) -> int:
        return len(self.position_mm)

    @cached_property
    def point_mm(self) -> Float64[np.ndarray, "n 3"]:
        """Nominal target point where the observer stands, (n, 3)."""
        if self.is_plain:
            return nominal_point_mm(self.machine, self.position_mm, self.offset_mm)
        return self.chain.point_mm

    @property
    def is_plain(self) -> bool:
        """Whether straight axes move a tool that is seen from the workpiece."""
        aside = self.on_workpiece is not None and bool(self.on_workpiece.any())
        return (
            self.seen_from == "workpiece" and not aside and not self.machine.rotary_axes
        )

    @cached_property
    def chain(self) -> NominalChain:
        """The nominal machine at these moments."""
        on_workpiece = self.on_workpiece
        if on_workpiece is None:
            on_workpiece = np.zeros(len(self), bool)
        return NominalChain(
            self.machine, self.position_mm, self.offset_mm, on_workpiece, self.seen_from
        )

    def taken(self, rows: Int64[np.ndarray, " m"]) -> Conditions:
        """Return the conditions at some of the moments."""
        return Conditions(
            self.machine,
            self.position_mm[rows],
            self.offset_mm[rows],
            self.time_s[rows],
            self.line[rows],
            self.line_time_s[rows],
            self.velocity_mm_s[rows],
            self.approach[rows],
            self.seen_from,
            None if self.on_workpiece is None else self.on_workpiece[rows],
            None if self.line_speed_mm_s is None else self.line_speed_mm_s[rows],
            self.run,
            None if self.around is None else self.around.taken(rows),
        )

    def seen_by(
        self, seen_from: str, on_workpiece: Bool[np.ndarray, " n"]
    ) -> Conditions:
        """Return the same moments for a target and an observer elsewhere."""
        return replace(self, seen_from=seen_from, on_workpiece=on_workpiece)

    def axis_mm(self, axis: str) -> Float64[np.ndarray, " n"]:
        """Return the positions of one axis."""
        return self.position_mm[:, self.machine.axis_names.index(axis)]


def standstill(
    machine: Machine,
    position_mm: Float64[np.ndarray, "n a"],
    offset_mm: Float64[np.ndarray, "n 3"] | None = None,
) -> Conditions:
    """Return conditions of a machine that stands at the given positions."""
    n, a = len(position_mm), len(machine.axes)
    if offset_mm is None:
        offset_mm = np.tile(np.array(machine.target().offset_mm), (n, 1))
    return Conditions(
        machine,
        position_mm,
        offset_mm,
        np.zeros(n),
        np.full(n, -1),
        np.zeros(n),
        np.zeros((n, 3)),
        np.zeros((n, a)),
    )


def along(
    direction: str, size: Float64[np.ndarray, "n p"]
) -> Float64[np.ndarray, "n 3 p"]:
    """Return columns of displacements along X, Y or Z, of given sizes."""
    return np.eye(3)[DIRECTION[direction]][:, None] * size[:, None, :]


def in_run(name: str, run: int) -> str:
    """Return the name of an effect of one Run; the first Run's needs no number."""
    return name if run == 0 else f"{name}-{run + 1}"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    unit : inside unit (mm, rad, s, 1)
    nuisance : belongs to the measurement (pose, timing), not to the machine
    """

    name: str
    unit: str
    nuisance: bool = False


@dataclass(frozen=True, slots=True)
class Charge:
    """A quadratic form θᵀKθ that a prior charges for.

    form : (p, p) K; rank : shapes that it charges; the others are free
    usual : θᵀKθ of an effect of usual size
    kind : effects of a kind are of like precision; empty for one on its own
    """

    form: Float64[np.ndarray, "p p"]
    rank: int
    usual: float
    kind: str = ""


@dataclass(frozen=True)
class Effect(ABC):
    """One physical cause that moves the measured point off its nominal, linear in θ."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The catalogue's name, or the ISO 230-1 symbol."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The p parameters, in the order of the Jacobian's columns."""

    @abstractmethod
    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return ∂(displacement where the observer stands, mm)/∂θ."""

    def displacement_mm(
        self, at: Conditions, theta: Float64[np.ndarray, " p"]
    ) -> Float64[np.ndarray, "n 3"]:
        """Return how far θ moves the measured point."""
        return self.jacobian(at) @ theta

    def charge(self) -> Charge | None:
        """Return what the prior charges for, or None for no prior."""
        return None

    def in_time(
        self, time_s: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, "n 3 p"] | None:
        """Return its columns at single moments if it is a fast function of time alone.

        Such an effect shows between the samples of a cell; others are None.
        """
        del time_s
        return None
