"""Drivers that hang, lie or break: at one call, from when on a file is there."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from measurement_fixtures import FakeMotion, FakeTracker
from truepath_drivers.interfaces import errors, records
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers

LONG_S = 300
POINTS = {
    "trackers": {"hostile": f"{__name__}:HostileTracker"},
    "motion_controllers": {"hostile": f"{__name__}:HostileMotion"},
    "thermometers": {"hostile": f"{__name__}:HostileThermometers"},
}
"""What an installation of them offers."""


class OwnError(errors.ConnectionLost):
    """Of a driver's own, which nobody else can import."""


@dataclass(frozen=True, slots=True)
class OwnStatus(records.MotionStatus):
    own: Any = threading.Lock


def lie(fault: str, usual: Any) -> Any:
    """Return something beside what was agreed, in place of the usual answer."""
    match fault:
        case "hang":
            threading.Event().wait(LONG_S)
        case "hang-alone":
            ctypes.PyDLL(None).sleep(LONG_S)  # no other thread runs meanwhile
        case "raise":
            raise KeyError("no such register")
        case "exit":
            sys.exit(3)
        case "own-error":
            raise OwnError("the cable is out")
        case "own-class":
            return OwnStatus(usual.state, usual.position, usual.line)
        case "two-axes":
            return replace(usual, position=(1.0, 2.0))
        case "texts":
            return replace(usual, position=("here", "there", "nowhere"))
        case "unpicklable":
            return replace(usual, firmware=threading.Lock())
        case "flat":
            return records.TrackerSamples(
                usual.sequence, usual.device_time_s, np.zeros(3), usual.status
            )
        case "tuple":
            return (1, 2, 3)
    return None


class Hostile:
    """Mixed in before a driver. `at` is the file that has to be there."""

    def __init__(self, verb: str = "", fault: str = "", at: str = "/") -> None:
        self._verb, self._fault, self._at = verb, fault, Path(at)
        super().__init__()

    def __getattribute__(self, name: str) -> Any:
        known = super().__getattribute__
        if name.startswith("_") or name != known("_verb") or not known("_at").exists():
            return known(name)
        return lambda *given: lie(
            known("_fault"),
            known(name)(*given) if known("_fault") not in ("hang", "exit") else None,
        )


class HostileTracker(Hostile, FakeTracker):
    """A tracker."""


class HostileMotion(Hostile, FakeMotion):
    """A controller that writes down when it was held, and its beats."""

    def __init__(
        self,
        verb: str = "",
        fault: str = "",
        at: str = "/",
        diary: str = "/dev/null",
        watched: bool = True,
    ) -> None:
        super().__init__(verb, fault, at)
        self.has_watchdog, self._diary = watched, Path(diary)
        self.speed = 1.0

    def hold(self) -> None:
        super().hold()
        self._note("hold")

    def move_to(self, position: Any, feed_mm_min: float) -> None:
        super().move_to(position, feed_mm_min)
        self._note("move")

    def _note(self, what: str) -> None:
        with self._diary.open("a") as diary:
            diary.write(f"{what} {time.monotonic()}\n")


class HostileThermometers(Hostile, Thermometers):
    channels = (Channel("air_degC"),)
    period_s = 0.1

    def connect(self) -> records.Identity:
        return records.Identity("Us", "thermometer", "T", "0")

    def close(self) -> None:
        """Nothing is open."""

    def read(self) -> tuple[Reading, ...]:
        return (Reading("air_degC", time.monotonic(), 20.0),)
