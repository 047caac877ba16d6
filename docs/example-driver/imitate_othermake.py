"""A device like Othermake's LT-50 that looks at the machine of a rig.

python imitate_othermake.py CONTROL [SHARE]: prints its TCP port; SHARE of its sample
lines are damaged. It has a frame, a clock and a numbering of its own.
"""

import select
import sys

import numpy as np

from truepath_simulators.bench.rig import Rig
from truepath_simulators.links.links import TcpPort

PLACE_MM = np.array([-700.0, -600.0, 150.0])
TURN = 0.4
EPOCH_MS = 3_600_000
NOISE_MM = 0.002


def line(text: str) -> bytes:
    """Return a line with its sum, as it goes over the wire."""
    return f"{text}*{sum(text.encode()) % 256:02X}\n".encode()


class Instrument:
    """Streams where the target is, as seen from its own place, by its own clock."""

    def __init__(self, rig: Rig, share: float) -> None:
        self.rig, self.share = rig, share
        self.rng = np.random.default_rng(5)
        self.rate_hz, self.begin_s, self.taken = 0.0, 0.0, 0

    def obey(self, order: str) -> bytes:
        """Return the reply to an order."""
        verb, _, rate = order.rpartition("*")[0].partition(" ")
        if line(order.rpartition("*")[0]) != f"{order}\n".encode():
            return line("NO wrong sum")
        if verb == "WHO":
            return line("ME Othermake;LT-50;4711;2.1")
        if verb == "HALT":
            self.rate_hz = 0.0
            taken, self.taken = self.taken, 0
            return line(f"HALT {taken}")
        if verb == "GO" and not self.rate_hz:
            self.rate_hz, self.taken = float(rate), 0
            now_s = self.rig.read_position()["time_s"][0]
            self.begin_s = np.ceil(1e3 * now_s) / 1e3
            return line(f"GO {rate} {EPOCH_MS + round(1e3 * self.begin_s)}")
        return line(f"NO {verb}")

    def due(self) -> bytes:
        """Return the lines of samples that are due by now."""
        if not self.rate_hz:
            return b""
        now_s = self.rig.read_position()["time_s"][0]
        until = int((now_s - self.begin_s) * self.rate_hz)
        numbers = np.arange(self.taken, until)
        if not len(numbers):
            return b""
        self.taken = until
        times = self.begin_s + numbers / self.rate_hz
        target = np.array(self.rig.read_position(times.tolist())["target_mm"])
        away = target - PLACE_MM + self.rng.normal(0.0, NOISE_MM, target.shape)
        c, s = np.cos(TURN), np.sin(TURN)
        forward, left = away[:, 0] * c + away[:, 1] * s, away[:, 1] * c - away[:, 0] * s
        return b"".join(
            self.wear(
                line(f"S {n} {1e3 * n / self.rate_hz:g} {x:.5f} {-y:.5f} {z:.5f} 1")
            )
            for n, x, y, z in zip(numbers, forward, left, away[:, 2], strict=True)
        )

    def wear(self, text: bytes) -> bytes:
        """Damage a share of the lines."""
        if self.rng.random() >= self.share:
            return text
        at = int(self.rng.integers(len(text) - 1))
        return text[:at] + bytes([text[at] ^ 0x11]) + text[at + 1 :]


def main() -> None:
    """Serve one host after the other."""
    instrument = Instrument(Rig(sys.argv[1]), float([*sys.argv, 0.0][2]))
    port, rest = TcpPort("127.0.0.1", 0), b""
    print(port.address["port"], flush=True)
    while True:
        select.select(port.descriptors(), [], [], 0.02)
        data = port.receive()
        if data is None:  # the host has gone, or a new one come
            instrument.rate_hz, data, rest = 0.0, b"", b""
        *orders, rest = (rest + data).split(b"\n")
        said = [instrument.obey(order.decode()) for order in orders]
        port.send(b"".join([*said, instrument.due()]))


if __name__ == "__main__":
    main()
