"""A total station that speaks GeoCOM, as far as a point measurement needs it.

Tested with geocompy 1.0.0 as its client. It has no second face and no compensator.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.line_instrument import LineInstrument
from truepath_simulators.tracker.polled_head import SHOT_S, PolledHead

_OK, _NOT_IMPLEMENTED, _ANGLE_ONLY, _NO_TARGET, _NO_LOCK = 0, 5, 1285, 8710, 8725
_FIELD_RAD = 0.01  # off the sight, in which a prism is still seen
_TURN_S = 0.5
Values = list[bytes]


class GeoComStation(LineInstrument):
    """Measures, follows and seeks the prism."""

    def __init__(self, head: PolledHead) -> None:
        super().__init__(head)
        self._sight: tuple[float, float] | None = None  # azimuth, elevation
        self._is_following = self._is_locked = False
        self._ready_s: float | None = None  # of the distance in progress
        self._prism_mm = 0.0
        self._atmosphere = [658.0e-9, 1013.25, 20.0, 14.0]
        self._procedures: dict[int, Callable[[Values, Timeline, float], str]] = {
            2008: self._do_measure,
            2023: lambda *_: f"0,{self._prism_mm:.6f}",
            2024: self._set_prism,
            2028: self._set_atmosphere,
            2029: lambda *_: ",".join(["0", *map(repr, self._atmosphere)]),
            5003: lambda *_: f"0,{int(head.serial_number)}",
            5004: lambda *_: '0,"Simulated station"',
            5034: lambda *_: "0,1,0,0",
            110: lambda *_: "0,1,0,0",
            108: lambda *_: "0,15",
            0: lambda *_: "0",
            9013: self._lock_in,
            9018: lambda *_: "0",
            9020: self._set_following,
            9027: self._turn_to,
            9029: self._search,
        }

    def answer(self, line: bytes, timeline: Timeline, true_s: float) -> None:
        """Answer a request; other lines are ignored, as on a noisy line."""
        head, colon, values = line.partition(b":")
        fields = head.split(b",")
        if (
            not colon
            or fields[0] != b"%R1Q"
            or not all(f.isdigit() for f in fields[1:])
        ):
            return
        procedure = int(fields[1])
        number = fields[2].decode() if len(fields) > 2 else "0"
        given = values.split(b",") if values else []
        if procedure == 2108:
            due_s = true_s if self._ready_s is None else max(self._ready_s, true_s)
            self.say_later(
                lambda *at: f"%R1P,0,{number}:{self._measure(*at)}".encode(), due_s
            )
            return
        make = self._procedures.get(procedure, lambda *_: f"{_NOT_IMPLEMENTED}")
        reply = f"%R1P,0,{number}:{make(given, timeline, true_s)}".encode()
        moves = procedure in (9027, 9029)
        self.say(reply, true_s + _TURN_S * moves)

    def _measure(self, timeline: Timeline, true_s: float) -> str:
        seen = self._see(timeline, true_s)
        if seen is None:
            self._is_locked = False
            azimuth, elevation = self._sight or (0.0, 0.0)
            return f"{_ANGLE_ONLY},{_angles(azimuth, elevation)},0.0"
        if self._ready_s is None:
            return f"{_ANGLE_ONLY},{_angles(seen[1], seen[2])},0.0"
        self._ready_s = None
        distance_m = 1e-3 * (seen[0] + self._prism_mm)
        return f"{_OK},{_angles(seen[1], seen[2])},{distance_m:.9f}"

    def _see(self, timeline: Timeline, true_s: float) -> np.ndarray | None:
        """None if the prism is not in the field of view; a lock keeps it there."""
        shot = self.head.shoot(timeline, true_s)
        if shot is None:
            return None
        if self._sight is None or self._is_locked:
            self._sight = float(shot[1]), float(shot[2])
        away = math.hypot(
            math.remainder(shot[1] - self._sight[0], 2.0 * math.pi),
            shot[2] - self._sight[1],
        )
        return shot if away < _FIELD_RAD else None

    def _do_measure(self, values: Values, _: Timeline, true_s: float) -> str:
        self._ready_s = true_s + SHOT_S if values[0] == b"1" else None
        return f"{_OK}"

    def _set_prism(self, values: Values, _: Timeline, __: float) -> str:
        self._prism_mm = float(values[0])
        return f"{_OK}"

    def _set_atmosphere(self, values: Values, _: Timeline, __: float) -> str:
        self._atmosphere = [float(value) for value in values]
        return f"{_OK}"

    def _set_following(self, values: Values, _: Timeline, __: float) -> str:
        self._is_following = values[0] == b"1"
        self._is_locked = self._is_locked and self._is_following
        return f"{_OK}"

    def _lock_in(self, _: Values, timeline: Timeline, true_s: float) -> str:
        if not self._is_following:
            return f"{_NO_LOCK}"
        self._is_locked = self._see(timeline, true_s) is not None
        return f"{_OK if self._is_locked else _NO_TARGET}"

    def _turn_to(self, values: Values, _: Timeline, __: float) -> str:
        hz, v = float(values[0]), float(values[1])
        self._sight = 0.5 * math.pi - hz, 0.5 * math.pi - v
        self._is_locked = False
        return f"{_OK}"

    def _search(self, values: Values, timeline: Timeline, true_s: float) -> str:
        shot = self.head.shoot(timeline, true_s)
        if shot is None or self._sight is None:
            return f"{_NO_TARGET}"
        aside = abs(math.remainder(shot[1] - self._sight[0], 2.0 * math.pi))
        above = abs(shot[2] - self._sight[1])
        if 2.0 * aside > float(values[0]) or 2.0 * above > float(values[1]):
            return f"{_NO_TARGET}"
        self._sight = float(shot[1]), float(shot[2])
        return f"{_OK}"


def _angles(azimuth_rad: float, elevation_rad: float) -> str:
    hz = (0.5 * math.pi - azimuth_rad) % (2.0 * math.pi)
    return f"{hz:.12f},{0.5 * math.pi - elevation_rad:.12f}"
