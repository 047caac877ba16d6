"""A path as lines of GRBL that take a twentieth of a second each.

The last line of a row waits until the axes stand and the dwell is over (`G4`), which is
the exact stop that GRBL has no word for; its reply says that the row is done.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.cnc.grbl.protocol import AXES, Settings
from truepath_drivers.interfaces.records import Path

START = b"G21G90G94G17G40G49G80\n"
DECIMALS = 4
_PIECE_S = 0.06
_AHEAD = 12  # pieces in which a motion can come to a stand; GRBL plans 15


@dataclass(frozen=True, slots=True)
class Block:
    """A line, and what its reply means.

    ends_row : the row has been driven, the dwell is over
    wait_s : longest that GRBL may be idle over it
    """

    text: bytes
    ends_row: bool = False
    wait_s: float = 0.0


def write_blocks(
    path: Path, begin: Sequence[float], settings: Settings
) -> Iterator[Block]:
    """Write a path from where the machine stands, as it is asked for."""
    yield Block(START)
    here = np.asarray(begin, np.float64)
    for row, there in enumerate(path.position):
        feed = float(path.feed_mm_min[row])
        count = _count_pieces(there - here, feed, settings)
        for piece in range(1, count + 1):
            at = there if piece == count else here + (there - here) * (piece / count)
            words = "".join(
                f"{axis}{value:.{DECIMALS}f}"
                for axis, value in zip(AXES, at, strict=True)
            )
            speed = f"F{feed:.2f}" if piece == 1 else ""
            yield Block(f"G53G1{words}{speed}\n".encode())
        dwell_s = float(path.dwell_s[row])
        yield Block(f"G4P{dwell_s:.3f}\n".encode(), True, dwell_s)
        here = there


def _count_pieces(
    step: NDArray[np.float64], feed_mm_min: float, settings: Settings
) -> int:
    """Return in how many pieces a row is sent.

    Pieces are short, so that little is left to drive when nobody asks any more, and
    long enough for GRBL to plan the way to a stand at full feed.
    """
    length = float(np.linalg.norm(step))
    if length == 0.0:
        return 1
    share = np.abs(step) / length
    moves = share > 0.0
    rate = float((settings.rate_mm_min[moves] / share[moves]).min())
    limit = float((settings.acceleration_mm_s2[moves] / share[moves]).min())
    speed = min(feed_mm_min, rate) / 60.0
    piece_s = max(_PIECE_S, speed / (2.0 * limit * _AHEAD))
    return max(1, int(np.ceil(length / (speed * piece_s))))
