"""Interface of a hidden effect, and all effects together as the tracker sees them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from truepath_simulators.hidden.motion import Motion
from truepath_simulators.machine.tracker_head import TrackerClock
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import MachineFile

Value = float | tuple[float, ...]
Motions = dict[str, np.ndarray]
"""Error motions (n, 6) by axis: along X, Y, Z in mm, about X, Y, Z in rad."""


@dataclass(frozen=True, slots=True)
class Occasion:
    """Recording for which an effect is sampled.

    size_um : largest motion of the measured point about its mean
    duration_s : of the recording; feed_mm_s : typical one
    distance_mm : typical distance from tracker to target
    """

    machine: MachineFile
    size_um: float
    duration_s: float
    feed_mm_s: float
    distance_mm: float

    @classmethod
    def usual(cls, machine: MachineFile, size_um: float) -> Self:
        """A recording of three minutes at 6 m/min, the tracker next to the machine."""
        low, high = machine.low_mm, machine.high_mm
        reach_mm = float(np.linalg.norm(0.5 * (high - low)[:2]))
        return cls(machine, size_um, 180.0, 100.0, reach_mm + 350.0)

    def axis(self, rng: np.random.Generator) -> str:
        return str(rng.choice([axis.name for axis in self.machine.linear_axes]))

    def travel_mm(self, axis: str) -> float:
        found = self.machine.axes[self.machine.axis_names.index(axis)]
        return found.high - found.low


@dataclass(frozen=True, slots=True)
class HiddenEffect(ABC):
    """One physical cause outside of the nominal machine with its error motions.

    name : that of the catalogue of effects; a separate name if it is not in it
    needs_model : only an earlier model shows it; one fitted to the same recording
        contains it
    on_ramps_alone : it has no effect at constant feed
    unstated : numbers that files leave out, in addition to those with a default
    """

    name: ClassVar[str]
    in_catalogue: ClassVar[bool] = True
    needs_model: ClassVar[bool] = False
    on_ramps_alone: ClassVar[bool] = False
    unstated: ClassVar[tuple[str, ...]] = ()

    @classmethod
    @abstractmethod
    def draw(cls, rng: np.random.Generator, occasion: Occasion) -> Self:
        """Random effect of the requested size."""

    @property
    def keys(self) -> dict[str, str]:
        """Its text fields, as axis and direction, distinguish it within its name."""
        return {
            name: text for name, text in asdict(self).items() if isinstance(text, str)
        }

    def parameters(self, clock: TrackerClock) -> Mapping[str, Value]:
        """Its numbers as in files, times on the tracker's clock."""
        del clock
        usual = {field.name for field in fields(self) if field.default is not MISSING}
        return {
            name: value
            for name, value in asdict(self).items()
            if name not in {*usual, *self.unstated} and not isinstance(value, str)
        }

    def truth(self, clock: TrackerClock) -> dict[str, Any]:
        """Name, keys and parameters in the form of `discovery.json`."""
        values = {
            name: {"value": list(value) if isinstance(value, tuple) else value}
            for name, value in self.parameters(clock).items()
        }
        return {"name": self.name, **self.keys, "parameters": values}

    def added_error_motions(self, motion: Motion, time_s: np.ndarray) -> Motions:
        """Additions to the error motions of joints."""
        del motion, time_s
        return {}

    def common_shift_mm(self, motion: Motion, time_s: np.ndarray) -> np.ndarray:
        """Common shift of all points, in the tracker's base frame, (n, 3)."""
        del motion
        return np.zeros((len(time_s), 3))

    def reading_error(self, polar: np.ndarray) -> np.ndarray:
        """Error of range (mm), azimuth and elevation (rad), (n, 3)."""
        return np.zeros_like(polar)

    def warming_degc(self, axis: str, time_s: np.ndarray) -> np.ndarray:
        """Reading of an axis' sensor above its start, (n,)."""
        del axis
        return np.zeros(len(time_s))


class _Sum(Motions):
    """Error motions whose `|` adds those of an axis that both have."""

    def __or__(self, other: Motions) -> _Sum:  # type: ignore[override]
        total = _Sum(self)
        for axis, value in other.items():
            total[axis] = total[axis] + value if axis in total else value
        return total

    __ior__ = __or__  # type: ignore[assignment]


_COLUMNS = {letter: column for column, letter in enumerate("XYZABC")}


def error_motion(symbol: str, value: np.ndarray) -> Motions:
    """Values (n,) of one error motion, as `added_error_motions` has them.

    `|` adds two, of one axis too.
    """
    motions = np.zeros((len(value), 6))
    motions[:, _COLUMNS[symbol[1]]] = value
    return _Sum({symbol[2]: motions})


def along(direction: str, value: np.ndarray) -> np.ndarray:
    """Values (n,) as vectors (n, 3) along X, Y or Z."""
    shift = np.zeros((len(value), 3))
    shift[:, _COLUMNS[direction]] = value
    return shift


def locate_target_mm(
    truth: TruthMachine,
    motion: Motion,
    time_s: np.ndarray,
    target: Sequence[str],
    hidden: Sequence[HiddenEffect],
) -> np.ndarray:
    """Target at each time in the frame on which the tracker stands, (n, 3).

    target : (n,) its name at each time
    """
    position = motion.corrected_positions(time_s)
    carry = carry_all(motion, time_s, hidden)
    names = np.array(target)
    point = np.empty((len(time_s), 3))
    for name in set(target):
        mine = names == name
        part = {axis: value[mine] for axis, value in carry.items()}
        point[mine] = truth.locate_target_mm(position[mine], name, part)
    for effect in hidden:
        point += effect.common_shift_mm(motion, time_s)
    return point


def carry_all(
    motion: Motion, time_s: np.ndarray, hidden: Sequence[HiddenEffect]
) -> Motions:
    """Sum of all additions to the error motions of joints, (n, 6) by axis."""
    total = _Sum()
    for effect in hidden:
        total |= effect.added_error_motions(motion, time_s)
    return total


def apply_reading_errors(
    polar: np.ndarray, hidden: Sequence[HiddenEffect]
) -> np.ndarray:
    """Readings (n, 3) with all effects."""
    return polar + sum((e.reading_error(polar) for e in hidden), np.zeros_like(polar))
