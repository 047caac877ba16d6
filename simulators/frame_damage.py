"""What a bad line does to frames: loses, flips, repeats, delays."""

from __future__ import annotations

import numpy as np

from truepath.simulators.faults import Fault, Schedule


class FrameDamage:
    """Applies the faults of a line to blocks of frames, one frame a sample."""

    def __init__(self, faults: Schedule, rng: np.random.Generator) -> None:
        self._faults = faults
        self._rng = rng
        self._kept_back = b""

    def damage(self, data: bytes, time_s: np.ndarray, number: np.ndarray) -> bytes:
        """Return what comes out of the line for whole frames taken at `time_s` (n,)."""
        frames = [b"\0" + piece + b"\0" for piece in data.split(b"\0") if piece]
        struck = False
        for kind in ("lost-bytes", "bit-flip", "duplicate", "noise", "drop", "silence"):
            for fault, mask in self._faults.struck(kind, time_s, number):
                struck = True
                for i in np.flatnonzero(mask & self._lot(fault, len(mask))):
                    frames[i] = self._damage_frame(kind, fault, frames[i])
        out = b"".join(frames) if struck else data
        return self._delay(out, time_s, number)

    def _lot(self, fault: Fault, n: int) -> np.ndarray:
        """Draw which frames are struck, where the amount of the fault is a share."""
        share = fault.amount if fault.kind in _SHARES else 1.0
        return self._rng.uniform(size=n) < share

    def _damage_frame(self, kind: str, fault: Fault, frame: bytes) -> bytes:
        match kind:
            case "lost-bytes":
                at = int(self._rng.integers(len(frame)))
                return frame[:at] + frame[at + 1 :]
            case "bit-flip":
                return self._flip_bits(frame)
            case "duplicate":
                return frame + frame
            case "noise":
                return self._rng.bytes(int(fault.amount)) + frame
            case _:
                return b""

    def _flip_bits(self, frame: bytes) -> bytes:
        at, bit = int(self._rng.integers(len(frame))), int(self._rng.integers(8))
        flipped = bytearray(frame)
        flipped[at] ^= 1 << bit
        return bytes(flipped)

    def _delay(self, data: bytes, time_s: np.ndarray, number: np.ndarray) -> bytes:
        for _, mask in self._faults.struck("delay", time_s, number):
            if mask[-1]:
                self._kept_back += data
                return b""
        data, self._kept_back = self._kept_back + data, b""
        return data


_SHARES = frozenset({"lost-bytes", "bit-flip", "duplicate", "drop"})
