"""What a program makes the axes do, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np
from jaxtyping import Bool, Float64, Int64

from drivers.interfaces.records import Path

_DIGITS = 12  # of a checksum: short enough to compare by eye


@dataclass(frozen=True, slots=True)
class ProgrammedMotion:
    """Straight motions of a program, as a control would drive them.

    name : of the program, as the control lists it
    position : (n, axes) ends of the motions in machine coordinates, mm and deg
    feed_mm_min : (n,) of the linear axes; deg/min where rotary axes move alone
    dwell_s : (n,) standing after each motion
    exact_stop : (n,) whether the axes come to a stand at the end of the motion
    row : (n,) row of the path, from 1; 0 where the program states none
    stated_checksum : of the path that the program was made from, empty if unstated
    """

    name: str
    axes: tuple[str, ...]
    position: Float64[np.ndarray, "n a"]
    feed_mm_min: Float64[np.ndarray, " n"]
    dwell_s: Float64[np.ndarray, " n"]
    exact_stop: Bool[np.ndarray, " n"]
    row: Int64[np.ndarray, " n"]
    stated_checksum: str = ""

    def __len__(self) -> int:
        return len(self.position)

    @property
    def checksum(self) -> str:
        """Checksum of the positions that the program commands."""
        return compute_checksum(self.axes, self.position)

    @property
    def path(self) -> Path:
        """The motion as a path, for `path.csv` of a bundle."""
        return Path(self.axes, self.position, self.feed_mm_min, self.dwell_s)


def compute_checksum(axes: Sequence[str], position: Float64[np.ndarray, "n a"]) -> str:
    """Return twelve hexadecimal digits of positions, to 0.1 µm, in order.

    Feeds and dwells do not count: the analysis does not use them, and an operator
    may change them at the control.
    """
    rows = [",".join(f"{v:.4f}" for v in row) for row in np.round(position, 4) + 0.0]
    text = "\n".join([",".join(axes), *rows])
    return sha256(text.encode()).hexdigest()[:_DIGITS].upper()
