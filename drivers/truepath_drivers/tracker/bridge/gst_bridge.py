"""GST/1, the device's side: output of a tracker, in one file of plain Python.

A bridge is a small program beside a maker's SDK: it passes samples of the SDK on as
GST/1 frames, over serial or TCP. This file needs the standard library alone and may be
copied. `python gst_bridge.py 4711` serves an example: a target on a circle.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import sys
import time
import zlib

_PATIENCE_US = 5_000_000
_STATUS_US = 500_000
_LONGEST = 508


class GstBridge:
    """Commands of a host to replies, samples to frames; no I/O.

    streaming, rate_hz : requested by the host; set the SDK so
    """

    def __init__(
        self,
        maker: str,
        model: str,
        serial_number: str,
        firmware: str,
        max_rate_hz: float,
    ) -> None:
        self._texts = (maker, model, serial_number, firmware)
        self._max_rate_hz = max_rate_hz
        self.streaming = False
        self.rate_hz = 0.0
        self._sequence = self._sent = self._dropped = 0
        self._heard_us = self._told_us = 0
        self._piece = b""

    def sample(
        self,
        clock_us: int,
        range_m: float,
        azimuth_rad: float,
        elevation_rad: float,
        status: int = 0,
        signal: int = 255,
    ) -> bytes:
        """Frame of a sample; empty without an active stream.

        clock_us : of the instrument, when it was taken, never when it arrived
        """
        if not self.streaming:
            return b""
        fields = (clock_us, range_m, azimuth_rad, elevation_rad, status, signal, 0)
        body = struct.pack("<BBHQdddHBB", 1, 0x14, self._sequence, *fields)
        self.skip(1)
        self._dropped, self._sent = self._dropped - 1, self._sent + 1
        return encode_frame(body)

    def sample_xyz(
        self, clock_us: int, x_mm: float, y_mm: float, z_mm: float, status: int = 0
    ) -> bytes:
        """Frame of a right-handed position, z up."""
        level = math.hypot(x_mm, y_mm)
        distance_m = math.hypot(level, z_mm) / 1e3
        angles = math.atan2(y_mm, x_mm), math.atan2(z_mm, level)
        return self.sample(clock_us, distance_m, *angles, status)

    def skip(self, samples: int) -> None:
        """Count samples that the SDK has lost before the next one."""
        self._sequence = (self._sequence + samples) & 0xFFFF
        self._dropped += samples

    def receive(self, data: bytes, clock_us: int) -> bytes:
        """Replies to data from the host."""
        *pieces, self._piece = (self._piece + data).split(b"\0")
        self._piece = self._piece[-_LONGEST:]
        bodies = [body for piece in pieces if (body := _open_frame(piece))]
        return b"".join(self._obey(body, clock_us) for body in bodies)

    def tick(self, clock_us: int) -> bytes:
        """STATUS twice per second; ends a stream without keep-alive."""
        if self.streaming and clock_us - self._heard_us > _PATIENCE_US:
            self.streaming = False
            return encode_frame(struct.pack("<BBBQ", 1, 0x13, 3, clock_us))
        if clock_us - self._told_us < _STATUS_US:
            return b""
        self._told_us = clock_us
        counts = (self._sent & 0xFFFFFFFF, self._dropped & 0xFFFFFFFF, 0)
        body = struct.pack("<BBBQIII", 1, 0x12, self.streaming, clock_us, *counts)
        return encode_frame(body)

    def forget_host(self) -> None:
        """End the stream: the host has disconnected."""
        self.streaming, self._piece = False, b""

    def _obey(self, body: bytes, clock_us: int) -> bytes:
        kind, transaction = body[1], body[2]
        head = struct.pack("<BBBB", 1, 0x30, transaction, kind)
        if kind == 0x20:
            if body[3:] != b"\x01":
                return _reject(body, 6, "version 1 only")
            texts = [text.encode()[:60] for text in self._texts]
            info = struct.pack("<BI", 1, round(self._max_rate_hz * 1e3))
            info += b"".join(bytes([len(text)]) + text for text in texts)
            return encode_frame(head + info)
        if kind == 0x21:
            return self._start(body, head, clock_us)
        if kind == 0x22:
            self.streaming = False
        elif kind == 0x23:
            self._heard_us = clock_us
        else:
            return _reject(body, 1, "unknown command")
        return encode_frame(head)

    def _start(self, body: bytes, head: bytes, clock_us: int) -> bytes:
        if len(body) != 8 or body[7] != 0:
            return _reject(body, 2, "MEAS64 only")
        rate_hz = int.from_bytes(body[3:7], "little") / 1e3
        if not 0 < rate_hz <= self._max_rate_hz:
            return _reject(body, 3, "rate not possible")
        if self.streaming and rate_hz != self.rate_hz:
            return _reject(body, 4, "streams at another rate")
        self.streaming, self.rate_hz, self._heard_us = True, rate_hz, clock_us
        info = struct.pack("<IHQ", round(rate_hz * 1e3), self._sequence, clock_us)
        return encode_frame(head + info)


def encode_frame(body: bytes) -> bytes:
    """A body with its CRC, without zeros (COBS), between zeros."""
    out = bytearray(b"\0")
    for run in (body + zlib.crc32(body).to_bytes(4, "little")).split(b"\0"):
        rest = run
        while len(rest) >= 254:
            out += b"\xff" + rest[:254]
            rest = rest[254:]
        out += bytes([len(rest) + 1]) + rest
    return bytes(out) + b"\0"


def _open_frame(piece: bytes) -> bytes:
    """Empty if it is damaged or of another version."""
    out, at = bytearray(), 0
    while at < len(piece):
        code = piece[at]
        out += piece[at + 1 : at + code]
        at += code
        if code < 255 and at < len(piece):
            out.append(0)
    body, crc = bytes(out[:-4]), bytes(out[-4:])
    good = at == len(piece) and len(body) >= 3 and body[0] == 1
    return body if good and zlib.crc32(body).to_bytes(4, "little") == crc else b""


def _reject(body: bytes, code: int, text: str) -> bytes:
    head = struct.pack("<BBBBB", 1, 0x31, body[2], body[1], code)
    return encode_frame(head + bytes([len(text)]) + text.encode())


def _clock_us() -> int:
    return time.monotonic_ns() // 1000


def _serve(bridge: GstBridge, host: socket.socket) -> None:
    next_us = 0
    while True:
        was_streaming = bridge.streaming
        if select.select([host], [], [], 0.002)[0]:
            data = host.recv(4096)
            if not data:
                return
            host.sendall(bridge.receive(data, _clock_us()))
        if bridge.streaming and not was_streaming:
            next_us = _clock_us()  # set the SDK to bridge.rate_hz
        while bridge.streaming and next_us <= _clock_us():
            # HERE GOES THE SDK: the time of the instrument, and a position.
            angle = next_us % 10_000_000 * 2e-7 * math.pi
            x_mm, y_mm = 2000.0 + 100.0 * math.cos(angle), 100.0 * math.sin(angle)
            host.sendall(bridge.sample_xyz(next_us, x_mm, y_mm, 300.0))
            next_us += round(1e6 / bridge.rate_hz)
        host.sendall(bridge.tick(_clock_us()))


def main() -> None:
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    bridge = GstBridge("Example", "Python bridge", "0001", "1.0", 1000.0)
    with socket.create_server(("127.0.0.1", port)) as server:
        print(server.getsockname()[1], flush=True)
        while True:
            host, _ = server.accept()
            with host:
                try:
                    _serve(bridge, host)
                except OSError as error:
                    print(f"host has gone: {error}", file=sys.stderr)
            bridge.forget_host()


if __name__ == "__main__":
    main()
