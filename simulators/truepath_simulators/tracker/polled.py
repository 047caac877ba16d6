"""Instruments that are asked point by point: GeoCOM and T2SA. No I/O.

The total station speaks GeoCOM as far as a point measurement needs it, tested with
geocompy 1.0.0 as its client. It has no second face and no compensator. T2SA is as
implied by its public client, with one tracker behind it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np

from truepath_drivers.tracker.streaming.codec import StatusBit
from truepath_drivers.tracker.t2sa.driver import ErrorCode
from truepath_simulators.faults import Schedule
from truepath_simulators.machine.tracker_head import (
    SampleNoise,
    to_cartesian,
)
from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.tracker_sight import TrackerParts, TrackerSight

SHOT_S = 0.4  # for a distance, by the machine's clock


MakeReply = Callable[[Timeline, float], bytes]
"""Makes a reply at the machine's time at which it is due."""


class LineInstrument(ABC):
    """Splits bytes into lines, and sends each reply when it is due.

    It measures the point that the streaming tracker would, a shot at a time.
    """

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        self.sight = TrackerSight(parts, faults)
        self.serial_number = f"{parts.seed:06d}"
        self._faults = faults
        self._noise = SampleNoise(parts.seed, 1.0 / SHOT_S, parts.air)
        self._shots = 0
        self._rest = b""
        self._lines: list[bytes] = []
        self._due: list[tuple[float, MakeReply]] = []

    @property
    def streaming(self) -> bool:
        """Whether a reply or a line is pending."""
        return bool(self._due or self._lines)

    def read_state(self) -> dict[str, Any]:
        return {"streaming": False, "shots": self._shots, "replies": len(self._due)}

    def receive(self, data: bytes, true_s: float, wall_s: float) -> bytes:
        """Take bytes of the host; every reply comes by `due`."""
        del wall_s
        self._faults.begin(true_s)
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        self._lines += [line.strip() for line in lines if line.strip()]
        return b""

    def due(
        self, timeline: Timeline, true_s: float, wall_s: float, waiting_bytes: int = 0
    ) -> bytes:
        del wall_s, waiting_bytes
        for line in self._lines:
            self.answer(line, timeline, true_s)
        self._lines = []
        ready = [make for due_s, make in self._due if due_s <= true_s]
        self._due = [(due_s, make) for due_s, make in self._due if due_s > true_s]
        said = b"".join(make(timeline, true_s) for make in ready)
        return b"" if self._faults.strikes("silence", true_s) else said

    def shoot(self, timeline: Timeline, true_s: float) -> np.ndarray | None:
        """Range (mm), azimuth and elevation (rad); None without a target."""
        self._shots += 1
        number, moment_s = np.array([self._shots]), np.array([true_s])
        polar, status = self.sight.read(timeline, moment_s, number, self._noise.draw(1))
        return None if status[0] & StatusBit.BEAM_BROKEN else polar[0]

    def reply(self, line: bytes, due_s: float = 0.0) -> None:
        """Send a line, at once or when it is due."""
        self.reply_later(lambda *_: line, due_s)

    def reply_later(self, make: MakeReply, due_s: float) -> None:
        """Make a line when it is due, and send it."""
        self._due.append((due_s, lambda *at: make(*at) + b"\r\n"))

    def forget_host(self) -> None:
        """Discard lines and replies: the connection has gone."""
        self._rest, self._lines, self._due = b"", [], []

    @abstractmethod
    def answer(self, line: bytes, timeline: Timeline, true_s: float) -> None:
        """Process a line of the host; replies by `reply`."""


_OK, _NOT_IMPLEMENTED, _ANGLE_ONLY, _NO_TARGET, _NO_LOCK = 0, 5, 1285, 8710, 8725
_FIELD_RAD = 0.01  # off the sight, in which a prism is still seen
_TURN_S = 0.5
Values = list[bytes]


class GeoComStation(LineInstrument):
    """Measures, follows and seeks the prism."""

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        super().__init__(parts, faults)
        self._aim: tuple[float, float] | None = None  # azimuth, elevation
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
            5003: lambda *_: f"0,{int(self.serial_number)}",
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
            self.reply_later(
                lambda *at: f"%R1P,0,{number}:{self._measure(*at)}".encode(), due_s
            )
            return
        make = self._procedures.get(procedure, lambda *_: f"{_NOT_IMPLEMENTED}")
        reply = f"%R1P,0,{number}:{make(given, timeline, true_s)}".encode()
        moves = procedure in (9027, 9029)
        self.reply(reply, true_s + _TURN_S * moves)

    def _measure(self, timeline: Timeline, true_s: float) -> str:
        seen = self._see(timeline, true_s)
        if seen is None:
            self._is_locked = False
            azimuth, elevation = self._aim or (0.0, 0.0)
            return f"{_ANGLE_ONLY},{_angles(azimuth, elevation)},0.0"
        if self._ready_s is None:
            return f"{_ANGLE_ONLY},{_angles(seen[1], seen[2])},0.0"
        self._ready_s = None
        distance_m = 1e-3 * (seen[0] + self._prism_mm)
        return f"{_OK},{_angles(seen[1], seen[2])},{distance_m:.9f}"

    def _see(self, timeline: Timeline, true_s: float) -> np.ndarray | None:
        """None if the prism is not in the field of view; a lock keeps it there."""
        shot = self.shoot(timeline, true_s)
        if shot is None:
            return None
        if self._aim is None or self._is_locked:
            self._aim = float(shot[1]), float(shot[2])
        away = math.hypot(
            math.remainder(shot[1] - self._aim[0], 2.0 * math.pi),
            shot[2] - self._aim[1],
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
        self._aim = 0.5 * math.pi - hz, 0.5 * math.pi - v
        self._is_locked = False
        return f"{_OK}"

    def _search(self, values: Values, timeline: Timeline, true_s: float) -> str:
        shot = self.shoot(timeline, true_s)
        if shot is None or self._aim is None:
            return f"{_NO_TARGET}"
        aside = abs(math.remainder(shot[1] - self._aim[0], 2.0 * math.pi))
        above = abs(shot[2] - self._aim[1])
        if 2.0 * aside > float(values[0]) or 2.0 * above > float(values[1]):
            return f"{_NO_TARGET}"
        self._aim = float(shot[1]), float(shot[2])
        return f"{_OK}"


def _angles(azimuth_rad: float, elevation_rad: float) -> str:
    hz = (0.5 * math.pi - azimuth_rad) % (2.0 * math.pi)
    return f"{hz:.12f},{0.5 * math.pi - elevation_rad:.12f}"


_TIME = "11/23/2026 02:00:00"


class T2saApplication(LineInstrument):
    """Measures a point of any name, or a plan with that one point."""

    def __init__(self, parts: TrackerParts, faults: Schedule) -> None:
        super().__init__(parts, faults)
        self._is_laser_on = True
        self._busy_until_s = 0.0
        self._frames: dict[str, str] = {}

    def answer(self, line: bytes, timeline: Timeline, true_s: float) -> None:
        del timeline
        text = line.decode("utf-8", "replace")
        command, _, given = text.partition(":")
        if text == "!HALT":
            self._due.clear()
            self._busy_until_s = 0.0
            self._acknowledge("READY")
        elif true_s < self._busy_until_s:
            self._reject(ErrorCode.BUSY, "Command rejected. SA is busy.")
        elif text == "?STAT":
            self._acknowledge("Instrument is connected")
        elif text == "?LSTA":
            self._acknowledge("LON" if self._is_laser_on else "LOFF")
        elif command == "!LST":
            self._is_laser_on = given == "1"
            self._acknowledge("Tracker Interface Started: True")
        elif command == "!MEAS_SINGLE_POINT" and given.count(";") == 2:
            self._begin(true_s, given.split(";")[2], is_plan=False)
        elif command == "!CMDEXE" and given:
            self._begin(true_s, given, is_plan=True)
        elif text.startswith("?POS "):
            self._report_frame(text.removeprefix("?POS "))
        else:
            self._reject(ErrorCode.REJECTED, f"Command rejected: {text}")

    def _begin(self, true_s: float, name: str, *, is_plan: bool) -> None:
        if not self._is_laser_on:
            self._reject(ErrorCode.NOT_READY, "Laser status LOFF. Should be 'LON'.")
            return
        self._busy_until_s = true_s + SHOT_S

        def measure(timeline: Timeline, now_s: float) -> bytes:
            shot = self.shoot(timeline, now_s)
            if shot is None:
                code = ErrorCode.GROUP_FAILED if is_plan else ErrorCode.POINT_FAILED
                return f"ERR-{int(code)} Measurement of {name} failed".encode()
            x, y, z = to_cartesian(shot[None])[0]
            self._frames[name] = f"X:{x:.6f};Y:{y:.6f};Z:{z:.6f};Rx:0;Ry:0;Rz:0"
            if is_plan:
                return f"ACK-106 Successfully ran CMD {name}".encode()
            place = f"{x:.6f},{y:.6f},{z:.6f}"
            return (
                f"ACK-300 Single Point Measurement {name} result {place} {_TIME} True"
            ).encode()

        self.reply_later(measure, self._busy_until_s)

    def _report_frame(self, name: str) -> None:
        if name not in self._frames:
            self._reject(ErrorCode.GROUP_FAILED, f"No point group {name}.")
        else:
            report = f"Object Offset Report Frame{name}_1;{self._frames[name]};{_TIME}"
            self._acknowledge(report)

    def _acknowledge(self, text: str) -> None:
        self.reply(f"ACK-300 {text}".encode())

    def _reject(self, code: ErrorCode, text: str) -> None:
        self.reply(f"ERR-{int(code)} {text}".encode())
