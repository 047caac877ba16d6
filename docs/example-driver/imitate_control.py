"""A control like Othermake's C7, whose axes are numbers.

python imitate_control.py [SPEED]: prints its TCP port; SPEED times faster than told.
"""

import select
import sys
import time

import numpy as np

from truepath_simulators.links.links import TcpPort

WATCHDOG_S = 1.0


class Control:
    """Constant feed along straight rows, and a stop without beats."""

    def __init__(self, speed: float) -> None:
        self.speed, self.left_s = speed, 0.0
        self.here = np.array([100.0, 100.0, -100.0])
        self.state, self.why, self.line = "idle", "", 0
        self.path: list[list[float]] = []
        self.rows: list[list[float]] = []
        self.at_s = self.beat_s = time.monotonic()

    def obey(self, order: str) -> str:
        """Return the reply to an order."""
        self.advance()
        verb, *words = order.split()
        numbers = [float(word) for word in words]
        rests = self.state not in ("running", "held")
        if verb == "WHO":
            return "OK Othermake;C7;4711;1.0;WATCHDOG"
        if verb == "AXES":
            return "OK X 0 500;Y 0 400;Z -300 0"
        if verb == "STATE":
            place = " ".join(f"{value:.4f}" for value in self.here)
            return f"OK {self.state} {self.line} {place};{self.why}"
        if verb == "CLEAR" and rests:
            self.path, self.state = [], "idle"
        elif verb == "ROW" and rests:
            self.path.append(numbers)
            self.state, self.line = "ready", 0
            return f"OK {order}"
        elif verb == "MOVE" and rests:
            self.run([numbers])
        elif verb == "GO" and rests and self.path:
            self.run(self.path)
        elif verb == "HOLD":
            self.hold("command")
        elif verb == "RESUME":
            if self.state == "held":
                self.state, self.why, self.beat_s = "running", "", self.at_s
        elif verb == "ABORT":
            self.path, self.state, self.why = [], "aborted", ""
        elif verb == "BEAT":
            self.beat_s = self.at_s
        else:
            return f"NO {verb} while {self.state}, with {len(self.path)} rows"
        return "OK"

    def run(self, rows: list[list[float]]) -> None:
        self.rows, self.line, self.left_s = rows, 0, 0.0
        self.state, self.beat_s = "running", self.at_s

    def hold(self, why: str) -> None:
        if self.state == "running":
            self.state, self.why = "held", why

    def advance(self) -> None:
        """Move for the time since the last call."""
        passed_s, self.at_s = time.monotonic() - self.at_s, time.monotonic()
        if self.at_s - self.beat_s > WATCHDOG_S:
            self.hold("watchdog")
        if self.state == "running":
            self.left_s += self.speed * passed_s
        while self.state == "running" and self.left_s > 0.0:
            feed, dwell_s, *place = self.rows[self.line]
            away = np.array(place) - self.here
            needed_s = float(np.linalg.norm(away)) / feed * 60.0
            if needed_s > self.left_s:
                self.here = self.here + away * self.left_s / needed_s
                self.left_s = 0.0
                return
            self.here = np.array(place)
            self.left_s -= needed_s + dwell_s
            if self.line + 1 == len(self.rows):
                self.state = "finished"
            else:
                self.line += 1


def main() -> None:
    """Serve one host after the other."""
    control = Control(float([*sys.argv, 1.0][1]))
    port, rest = TcpPort("127.0.0.1", 0), b""
    print(port.address["port"], flush=True)
    while True:
        select.select(port.descriptors(), [], [], 0.02)
        control.advance()
        data = port.receive()
        if data is None:  # the host has gone, or a new one come
            data, rest = b"", b""
        *orders, rest = (rest + data).split(b"\r\n")
        replies = [control.obey(order.decode()) + "\r\n" for order in orders]
        port.send("".join(replies).encode())


if __name__ == "__main__":
    main()
