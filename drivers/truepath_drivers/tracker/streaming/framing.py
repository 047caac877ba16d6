"""Frames on a byte stream: COBS between zero bytes, closed by a CRC-32.

On the wire a frame is `00 | COBS(body | crc32) | 00`. COBS leaves no zero inside, so a
zero always ends a frame: after any loss the reader is in step again at the next one.
The delimiter is at both ends, so that any one damaged or lost byte costs at most one
frame; with a single delimiter its loss would cost two.

The CRC is zlib's (CRC-32/ISO-HDLC) over the whole body. Sixteen bits would let one
damaged frame in 65 536 through: a wrong sample every few noisy runs.

Cheshire and Baker, "Consistent overhead byte stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

from __future__ import annotations

import zlib

MAX_BODY = 500
# Overhead: one code byte per 254, the CRC. Anything longer between two zeros is noise.
MAX_FRAME = MAX_BODY + 4 + 3

_CRC_BYTES = 4
_LONGEST_RUN = 254


def encode_frame(body: bytes) -> bytes:
    """Bytes that carry `body` over the wire, delimiters included."""
    if len(body) > MAX_BODY:
        raise ValueError(f"a body holds at most {MAX_BODY} bytes, not {len(body)}")
    crc = zlib.crc32(body).to_bytes(_CRC_BYTES, "little")
    return b"\0" + cobs_encode(body + crc) + b"\0"


def cobs_encode(data: bytes) -> bytes:
    """Replace the zeros of `data`, which grows by one byte in 254, at least by one."""
    out = bytearray()
    for run in data.split(b"\0"):
        while len(run) >= _LONGEST_RUN:
            out.append(_LONGEST_RUN + 1)
            out += run[:_LONGEST_RUN]
            run = run[_LONGEST_RUN:]
        out.append(len(run) + 1)
        out += run
    return bytes(out)


def cobs_decode(data: bytes) -> bytes | None:
    """The decoded data; None where `data` ends too early or holds a zero."""
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        code = data[at]
        following = at + code
        if code == 0 or following > end:
            return None
        out += data[at + 1 : following]
        at = following
        if code <= _LONGEST_RUN and at < end:
            out.append(0)
    return bytes(out)


def check_frame(piece: bytes) -> bytes | None:
    """Body of a frame without delimiters; None if its CRC does not match."""
    decoded = cobs_decode(piece)
    if decoded is None or len(decoded) <= _CRC_BYTES:
        return None
    body = decoded[:-_CRC_BYTES]
    if zlib.crc32(body) != int.from_bytes(decoded[-_CRC_BYTES:], "little"):
        return None
    return body


class FrameReader:
    """Cuts a stream into bodies. Any split of the stream gives the same bodies.

    frames, crc_errors : frames that passed and pieces that did not
    skipped_bytes : bytes between delimiters that belong to no good frame

    Bytes before the first delimiter may be the tail of a frame that began before the
    start of reading: they are skipped, but are no CRC error.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.crc_errors = 0
        self.skipped_bytes = 0
        self._rest = b""
        self._in_step = False
        self._overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; gives the bodies complete now, in order."""
        *pieces, rest = (self._rest + data).split(b"\0")
        bodies: list[bytes] = []
        for piece in pieces:
            body = self._close(piece)
            if body is not None:
                bodies.append(body)
        self._keep(rest)
        return bodies

    def _close(self, piece: bytes) -> bytes | None:
        in_step, self._in_step = self._in_step, True
        overlong, self._overlong = self._overlong, False
        if not piece and not overlong:
            return None
        body = None if overlong or len(piece) > MAX_FRAME else check_frame(piece)
        if body is None:
            self.skipped_bytes += len(piece)
            self.crc_errors += in_step
            return None
        self.frames += 1
        return body

    def _keep(self, rest: bytes) -> None:
        if self._overlong or len(rest) > MAX_FRAME:
            self._overlong = True
            self.skipped_bytes += len(rest)
            rest = b""
        self._rest = rest
