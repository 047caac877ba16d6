"""A line or network between a host and a device that does harm, by a seed.

It works between any driver and any device, simulated or real: the host opens a
pseudo-terminal or a TCP port here, the bytes go on to the device and back. The harm may
change at any moment.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
import time
import tty
from collections import deque
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from truepath_simulators.links.links import Port, PtyPort, TcpPort

_PERIOD_S = 0.02
_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True)
class Harm:
    """Damage to the bytes of one direction; shares are of the pieces read.

    latency_s, jitter_s : every piece comes later, by up to the jitter more; in order
    pause_s : between any two bytes, which then come one by one
    most_bytes : passed on at once; 0 as they came
    flip, drop, double, swap : one bit, the whole piece, twice, after the next piece
    halve, renumber : every piece loses its second half, has another first byte
    noise, noise_bytes : share of pieces with so many random bytes before them
    is_hole : nothing passes
    """

    latency_s: float = 0.0
    jitter_s: float = 0.0
    pause_s: float = 0.0
    most_bytes: int = 0
    flip: float = 0.0
    drop: float = 0.0
    double: float = 0.0
    swap: float = 0.0
    halve: bool = False
    renumber: bool = False
    noise: float = 0.0
    noise_bytes: int = 0
    is_hole: bool = False


class _Direction:
    def __init__(self, rng: np.random.Generator) -> None:
        self.harm = Harm()
        self.harmed = 0
        self._rng, self._kept = rng, b""
        self._ahead: deque[tuple[float, bytes]] = deque()

    def offer(self, piece: bytes, now_s: float) -> None:
        harm, chance = self.harm, self._rng.random(5)
        hit = chance < (harm.flip, harm.drop, harm.double, harm.swap, harm.noise)
        self.harmed += int(hit.any() or harm.is_hole)
        if harm.is_hole or hit[1]:
            return
        if harm.halve:
            piece = piece[: len(piece) // 2]
        if harm.renumber:
            piece = bytes([piece[0] ^ 1]) + piece[1:]
        if hit[0]:
            piece = self._flip_bit(piece)
        if hit[2]:
            piece += piece
        if hit[4]:
            piece = self._rng.bytes(harm.noise_bytes) + piece
        if hit[3] and not self._kept:
            self._kept = piece
            return
        piece, self._kept = piece + self._kept, b""
        due_s = now_s + harm.latency_s + harm.jitter_s * float(self._rng.random())
        size = 1 if harm.pause_s else harm.most_bytes or len(piece)
        for begin in range(0, len(piece), max(size, 1)):
            if self._ahead:
                due_s = max(due_s, self._ahead[-1][0] + harm.pause_s)
            self._ahead.append((due_s, piece[begin : begin + size]))

    def take(self, now_s: float) -> list[bytes]:
        arrived: list[bytes] = []
        while self._ahead and self._ahead[0][0] <= now_s:
            arrived.append(self._ahead.popleft()[1])
        return arrived

    def wait_s(self, now_s: float) -> float:
        if not self._ahead:
            return _PERIOD_S
        return min(max(self._ahead[0][0] - now_s, 0.0), _PERIOD_S)

    def forget(self) -> None:
        self._ahead.clear()
        self._kept = b""

    def _flip_bit(self, piece: bytes) -> bytes:
        place, bit = int(self._rng.integers(len(piece))), int(self._rng.integers(8))
        return piece[:place] + bytes([piece[place] ^ 1 << bit]) + piece[place + 1 :]


class LinkProxy:
    """A link between a host and a device that does harm by a seed.

    device : options of a driver, `host` and `port`, or `port` alone (a terminal)

    `sent_by_device` keeps what came before any harm; `connections` counts those made.
    """

    def __init__(self, device: dict[str, Any], seed: int = 1) -> None:
        self._device = dict(device)
        self._is_tcp = "host" in device
        self._port: Port = TcpPort("127.0.0.1", 0) if self._is_tcp else PtyPort()
        self._far: socket.socket | int | None = None
        rng = np.random.default_rng(seed)
        self._to_device, self._to_host = (_Direction(child) for child in rng.spawn(2))
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link-proxy")
        self.connections = 0
        self.sent_by_device = bytearray()

    @property
    def options(self) -> dict[str, Any]:
        """Options of the driver, with this link in place of the device's."""
        return {**self._device, **self._port.address}

    @property
    def harmed(self) -> int:
        """Number of damaged pieces."""
        with self._lock:
            return self._to_device.harmed + self._to_host.harmed

    def harm(
        self, *, to_host: Harm | None = None, to_device: Harm | None = None
    ) -> None:
        """Damage from now on; None is an intact direction."""
        with self._lock:
            self._to_host.harm = to_host or Harm()
            self._to_device.harm = to_device or Harm()

    def reset(self) -> None:
        """End the connection at once, as RST does; another may come."""
        with self._lock:
            self._hang_up(reset=True)

    def __enter__(self) -> Self:
        if not self._is_tcp:
            self._reach_device()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._hang_up()
        self._port.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            with self._lock:
                self._pass_on()
                now_s = time.monotonic()
                wait_s = min(
                    one.wait_s(now_s) for one in (self._to_device, self._to_host)
                )
                near, far = self._port.descriptors(), self._far_descriptors()
            with contextlib.suppress(OSError, ValueError):  # closed meanwhile
                select.select([*near, *far], [], [], wait_s)

    def _pass_on(self) -> None:
        now_s = time.monotonic()
        sent = self._port.receive()
        if sent is None and self._is_tcp:  # a host has come or gone
            self._close_far()
            if len(self._port.descriptors()) > 1:
                self._reach_device()
        elif sent:
            self._to_device.offer(sent, now_s)
        if (answer := self._read_far()) is not None:
            self.sent_by_device += answer
            self._to_host.offer(answer, now_s)
        now_s = time.monotonic()
        for piece in self._to_device.take(now_s):
            self._write_far(piece)
        for piece in self._to_host.take(now_s):
            self._port.send(piece)

    def _reach_device(self) -> None:
        self.connections += 1
        if not self._is_tcp:
            self._far = os.open(self._device["port"], os.O_RDWR | os.O_NOCTTY)
            tty.setraw(self._far)
            os.set_blocking(self._far, False)
            return
        address = self._device["host"], int(self._device["port"])
        try:
            self._far = socket.create_connection(address, timeout=1.0)
        except OSError:
            self._hang_up()
            return
        self._far.setblocking(False)
        self._far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _far_descriptors(self) -> list[int]:
        if self._far is None:
            return []
        return [self._far if isinstance(self._far, int) else self._far.fileno()]

    def _read_far(self) -> bytes | None:
        try:
            match self._far:
                case None:
                    return None
                case int():
                    return os.read(self._far, _BLOCK) or None
                case _:
                    data = self._far.recv(_BLOCK)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:  # the device has closed
            self._hang_up()
        return data or None

    def _write_far(self, piece: bytes) -> None:
        with contextlib.suppress(OSError):
            if isinstance(self._far, int):
                os.write(self._far, piece)
            elif self._far is not None:
                self._far.sendall(piece)

    def _hang_up(self, *, reset: bool = False) -> None:
        if reset and isinstance(self._port, TcpPort):
            self._port.linger(struct.pack("ii", 1, 0))
        if self._is_tcp:
            self._port.disconnect()
        self._close_far()

    def _close_far(self) -> None:
        far, self._far = self._far, None
        if isinstance(far, int):
            os.close(far)
        elif far is not None:
            far.close()
        for direction in (self._to_device, self._to_host):
            direction.forget()
