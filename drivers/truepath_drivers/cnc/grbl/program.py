"""A path as lines of GRBL that take a twentieth of a second each.

The last line of a row waits until the axes stand and the dwell is over (`G4`), which is
the exact stop that GRBL has no word for; its reply says that the row is done.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.cnc.grbl.protocol import AXES, Settings
from truepath_drivers.interfaces.records import Path
from truepath_drivers.streams.line_feeding import Line

START = b"G21G90G94G17G40G49G80\n"
_AHEAD_S = 0.9  # of motion in GRBL's queue, which is what it drives unasked
LASTS_S = (
    0.5  # that a full queue lasts at least: pieces of a row that begins are shorter
)
_BRAKING = 0.8  # share of the queue in which a motion can come to a stand
_DWELL_SHARE = 1.1  # of its clock, which is no quartz on every board


@dataclass(frozen=True, slots=True)
class Block(Line):
    """A line, and what its reply means.

    end : where it drives to; empty where it drives nowhere
    ends_row : the row has been driven, the dwell is over
    wait_s : longest that GRBL may be idle over it
    """

    end: tuple[float, ...] = ()
    ends_row: bool = False
    wait_s: float = 0.0


def write_blocks(
    path: Path,
    begin: Sequence[float],
    settings: Settings,
    find_override: Callable[[], float],
) -> Iterator[Block]:
    """Write a path from where the machine stands, as it is asked for."""
    yield Block(START, is_barrier=True)
    here = np.asarray(begin, np.float64)
    for row, there in enumerate(path.position):
        feed, step, done = float(path.feed_mm_min[row]), there - here, 0.0
        while done < 1.0:
            done += _find_piece(step, done, feed * find_override(), settings)
            at = there if done >= 1.0 else here + step * done
            ends = (f"{axis}{value:.4f}" for axis, value in zip(AXES, at, strict=True))
            line = f"G53G1{''.join(ends)}F{feed:.2f}\n".encode()
            yield Block(line, end=(float(at[0]), float(at[1]), float(at[2])))
        dwell_s = float(path.dwell_s[row])
        yield Block(
            f"G4P{dwell_s:.3f}\n".encode(),
            is_barrier=True,
            ends_row=True,
            wait_s=_DWELL_SHARE * dwell_s,
        )
        here = there


def find_least_feed(settings: Settings) -> float:
    """Lowest feed, mm/min, at which each line is a step of the motors or more.

    GRBL plans no others: its queue would last as long as it liked.
    """
    return 60.0 * float(settings.step_mm.max()) * settings.queue / _AHEAD_S


def _find_piece(
    step: NDArray[np.float64], done: float, feed_mm_min: float, settings: Settings
) -> float:
    """Share of a row that is sent as one line, behind the share `done`.

    It takes as long as any other at the speed that the axes have come to by then, so
    that little is left to drive when nobody asks any more. What they cannot stand from
    within the queue, GRBL does not reach.
    """
    length = float(np.linalg.norm(step))
    if length == 0.0:
        return 1.0
    share = np.maximum(np.abs(step) / length, 1e-9)
    limit = float((settings.acceleration_mm_s2 / share).min())
    speed = min(feed_mm_min, float((settings.rate_mm_min / share).min())) / 60.0
    piece_s = _AHEAD_S / settings.queue
    come_to = max(np.sqrt(2.0 * limit * done * length), limit * piece_s)
    speed = min(speed, come_to, 2.0 * _BRAKING * _AHEAD_S * limit)
    return speed * piece_s / length
