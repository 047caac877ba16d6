"""T2SA as implied by its public client, with one tracker behind it."""

from __future__ import annotations

from truepath_drivers.tracker.t2sa.codec import ErrorCode
from truepath_simulators.machine.tracker_head import to_cartesian
from truepath_simulators.timeline import Timeline
from truepath_simulators.tracker.line_instrument import LineInstrument
from truepath_simulators.tracker.polled_head import SHOT_S, PolledHead

_TIME = "11/23/2026 02:00:00"


class T2saApplication(LineInstrument):
    """Measures a point of any name, or a plan with that one point."""

    def __init__(self, head: PolledHead) -> None:
        super().__init__(head)
        self._is_laser_on = True
        self._busy_until_s = 0.0
        self._places: dict[str, str] = {}

    def answer(self, line: bytes, timeline: Timeline, true_s: float) -> None:
        """Answer a command."""
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
            self._tell_frame(text.removeprefix("?POS "))
        else:
            self._reject(ErrorCode.REJECTED, f"Command rejected: {text}")

    def _begin(self, true_s: float, name: str, *, is_plan: bool) -> None:
        if not self._is_laser_on:
            self._reject(ErrorCode.NOT_READY, "Laser status LOFF. Should be 'LON'.")
            return
        self._busy_until_s = true_s + SHOT_S

        def measure(timeline: Timeline, now_s: float) -> bytes:
            shot = self.head.shoot(timeline, now_s)
            if shot is None:
                code = ErrorCode.GROUP_FAILED if is_plan else ErrorCode.POINT_FAILED
                return f"ERR-{int(code)} Measurement of {name} failed".encode()
            x, y, z = to_cartesian(shot[None])[0]
            self._places[name] = f"X:{x:.6f};Y:{y:.6f};Z:{z:.6f};Rx:0;Ry:0;Rz:0"
            if is_plan:
                return f"ACK-106 Successfully ran CMD {name}".encode()
            place = f"{x:.6f},{y:.6f},{z:.6f}"
            return (
                f"ACK-300 Single Point Measurement {name} result {place} {_TIME} True"
            ).encode()

        self.say_later(measure, self._busy_until_s)

    def _tell_frame(self, name: str) -> None:
        if name not in self._places:
            self._reject(ErrorCode.GROUP_FAILED, f"No point group {name}.")
        else:
            report = f"Object Offset Report Frame{name}_1;{self._places[name]};{_TIME}"
            self._acknowledge(report)

    def _acknowledge(self, text: str) -> None:
        self.say(f"ACK-300 {text}".encode())

    def _reject(self, code: ErrorCode, text: str) -> None:
        self.say(f"ERR-{int(code)} {text}".encode())
