"""State of the machine at which effects are evaluated."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.kinematics.machine.chain import NominalChain
from truepath.kinematics.machine.machine import Axis, Machine, Target
from truepath.kinematics.splines import CubicSpline


@dataclass(frozen=True, slots=True)
class RecordedState:
    """Recorded state of the machine at n moments, in addition to the commanded one.

    rate : (n, axes) mm/s or deg/s of each axis, 0 at a standstill
    span_s : (n,) how long the moment lasts: the time over which samples were averaged
    since_reversal : (n, axes) mm or deg since the axis last changed its direction, inf
        where it has not
    tracker_mm : (n, 3) point in the tracker's frame
    rotation : (3, 3) frame of the workpiece, or base, to that of the tracker
    temperature_degc : (n, sensors) of the named sensors
    lock : (n,) how often the beam was lost and found before; 0 if None
    set_up : of the tracker, named by `name_set_up`
    """

    rate: Float64[np.ndarray, "n a"]
    span_s: Float64[np.ndarray, " n"]
    since_reversal: Float64[np.ndarray, "n a"]
    tracker_mm: Float64[np.ndarray, "n 3"]
    rotation: Float64[np.ndarray, "3 3"]
    sensors: tuple[str, ...] = ()
    temperature_degc: Float64[np.ndarray, "n s"] | None = None
    lock: Int64[np.ndarray, " n"] | None = None
    set_up: str = ""

    def select(self, rows: Int64[np.ndarray, " m"]) -> RecordedState:
        """Rows of all arrays; the rotation stays."""
        celsius, lock = self.temperature_degc, self.lock
        return replace(
            self,
            rate=self.rate[rows],
            span_s=self.span_s[rows],
            since_reversal=self.since_reversal[rows],
            tracker_mm=self.tracker_mm[rows],
            temperature_degc=None if celsius is None else celsius[rows],
            lock=None if lock is None else lock[rows],
        )


@dataclass(frozen=True)
class Conditions:
    """The state of the machine at n moments.

    position_mm : (n, axes) nominal axis positions, in the machine's column order
    offset_mm : (n, 3) offset of the measured target as in the machine file
    seat_mm : (n, 3) known deviation of the target from that; 0 if None
    time_s : (n,) the tracker's clock
    line : (n,) row of the path that the machine moves towards, -1 at a standstill
    line_time_s : (n,) time from the middle of that line
    velocity_mm_s : (n, 3) commanded velocity, 0 at a standstill
    approach : (n, axes) sign of each axis' last motion, 0 where it has not moved yet
    observer : side of the observer, `workpiece` or `base`; the volumetric error
        is that of the tool seen from the workpiece
    on_workpiece : (n,) the target is on the workpiece; False if None
    line_speed_mm_s : (n,) mean speed along that line where it differs from the velocity
        because the line is an arc
    run : which of the Runs of an estimate, for effects that belong to one of them
    recorded : added by a recording; an effect that needs it is 0 without it
    acceleration : (n, axes) mm/s² of each axis, as measured; 0 if None
    """

    machine: Machine
    position_mm: Float64[np.ndarray, "n a"]
    offset_mm: Float64[np.ndarray, "n 3"]
    time_s: Float64[np.ndarray, " n"]
    line: Int64[np.ndarray, " n"]
    line_time_s: Float64[np.ndarray, " n"]
    velocity_mm_s: Float64[np.ndarray, "n 3"]
    approach: Float64[np.ndarray, "n a"]
    observer: str = "workpiece"
    on_workpiece: Bool[np.ndarray, " n"] | None = None
    line_speed_mm_s: Float64[np.ndarray, " n"] | None = None
    run: int = 0
    recorded: RecordedState | None = None
    seat_mm: Float64[np.ndarray, "n 3"] | None = None
    acceleration: Float64[np.ndarray, "n a"] | None = None

    def __len__(self) -> int:
        return len(self.position_mm)

    @cached_property
    def point_mm(self) -> Float64[np.ndarray, "n 3"]:
        """Nominal target point in the observer's frame, (n, 3)."""
        return self.chain.point_mm

    @cached_property
    def chain(self) -> NominalChain:
        """Nominal chain; the target's offset includes its seat."""
        on_workpiece = self.on_workpiece
        if on_workpiece is None:
            on_workpiece = np.zeros(len(self), bool)
        offset = self.offset_mm
        if self.seat_mm is not None:
            offset = offset + self.seat_mm
        return NominalChain(
            self.machine, self.position_mm, offset, on_workpiece, self.observer
        )

    def select(self, rows: Int64[np.ndarray, " m"]) -> Conditions:
        """Rows of all arrays, of what is recorded as well."""
        return Conditions(
            self.machine,
            self.position_mm[rows],
            self.offset_mm[rows],
            self.time_s[rows],
            self.line[rows],
            self.line_time_s[rows],
            self.velocity_mm_s[rows],
            self.approach[rows],
            self.observer,
            None if self.on_workpiece is None else self.on_workpiece[rows],
            None if self.line_speed_mm_s is None else self.line_speed_mm_s[rows],
            self.run,
            None if self.recorded is None else self.recorded.select(rows),
            None if self.seat_mm is None else self.seat_mm[rows],
            None if self.acceleration is None else self.acceleration[rows],
        )

    def view_from(
        self, observer: str, on_workpiece: Bool[np.ndarray, " n"]
    ) -> Conditions:
        """Same moments for a target and an observer on other sides of the machine."""
        return replace(self, observer=observer, on_workpiece=on_workpiece)

    def axis_mm(self, axis: str) -> Float64[np.ndarray, " n"]:
        """Positions of one axis; deg for a rotary axis."""
        return self.position_mm[:, self.machine.axis_names.index(axis)]

    def axis_share(self, axis: Axis) -> Float64[np.ndarray, " n"]:
        """Positions of one axis within its travel, from 0 to 1."""
        return (self.axis_mm(axis.name) - axis.low) / (axis.high - axis.low)

    @property
    def middle_s(self) -> float:
        """Halfway between the first moment and the last."""
        return 0.5 * float(self.time_s.min() + self.time_s.max())

    def spline_rows(self, axis: str, spline: CubicSpline) -> Float64[np.ndarray, "n k"]:
        """Rows at the positions of an axis, computed once per spline."""
        key = axis, spline.knots.tobytes(), spline.period
        if key not in self._spline_rows:
            self._spline_rows[key] = spline.basis(self.axis_mm(axis))
        return self._spline_rows[key]

    @cached_property
    def _spline_rows(self) -> dict[Hashable, Float64[np.ndarray, "n k"]]:
        return {}

    def axis_rate(self, axis: str) -> Float64[np.ndarray, " n"]:
        """mm/s or deg/s; 0 where nothing is recorded."""
        if self.recorded is None:
            return np.zeros(len(self))
        return self.recorded.rate[:, self.machine.axis_names.index(axis)]

    @property
    def span_s(self) -> Float64[np.ndarray, " n"]:
        """How long each moment lasts; 0 where nothing is recorded."""
        return np.zeros(len(self)) if self.recorded is None else self.recorded.span_s

    def sensor_degc(self, name: str) -> Float64[np.ndarray, " n"] | None:
        """Temperatures of a sensor; None where nothing records it."""
        recorded = self.recorded
        if recorded is None or recorded.temperature_degc is None:
            return None
        if name not in recorded.sensors:
            return None
        return recorded.temperature_degc[:, recorded.sensors.index(name)]

    def axis_acceleration(self, axis: str) -> Float64[np.ndarray, " n"]:
        """mm/s²; 0 where it is not measured."""
        if self.acceleration is None:
            return np.zeros(len(self))
        return self.acceleration[:, self.machine.axis_names.index(axis)]


def make_standstill(
    machine: Machine,
    position_mm: Float64[np.ndarray, "n a"],
    offset_mm: Float64[np.ndarray, "n 3"] | None = None,
) -> Conditions:
    """Conditions at rest at these positions; offset of the first target if None."""
    n, a = len(position_mm), len(machine.axes)
    if offset_mm is None:
        offset_mm = np.tile(np.array(machine.target().offset_mm, float), (n, 1))
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


def observe_targets(
    machine: Machine, position_mm: Float64[np.ndarray, "n a"], targets: Sequence[Target]
) -> Conditions:
    """Conditions of targets at a standstill, seen from where the tracker stands.

    targets : in turn, one at each position
    """
    turns = len(position_mm) // len(targets)
    offset = np.array([target.offset_mm for target in targets], np.float64)
    aside = np.array([target.on == "workpiece" for target in targets])
    at = make_standstill(machine, position_mm, np.tile(offset, (turns, 1)))
    return at.view_from(machine.tracker.stands_on, np.tile(aside, turns))
