"""Axis motion of a program: a simulated control runs it row by row."""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from jaxtyping import Bool, Float64, Int64

from truepath.errors import PlanningError
from truepath_drivers.interfaces.records import Arc, Path

AXES = "XYZABC"
_LINEAR = "XYZ"
# The row in the comment of a motion: other comments may hold the same words.
_ROW = re.compile(
    r"^[^;(]*[XYZABC]\s*[-+]?\.?\d[^;(]*[;(]\s*ROW (\d+)\b", re.IGNORECASE
)
_CHECKSUM = re.compile(r"PATH CHECKSUM ([0-9A-F]{12})\b")
_DECIMALS = 6  # of ends that are sums, mm
_SAME_RADIUS_MM = 3e-3  # both ends and the centre are rounded
_DIGITS = 12  # of a checksum: short enough to compare by eye


@dataclass(frozen=True, slots=True)
class ApproachMotion:
    """A motion of the named axes only, on the way to the first row."""

    ends: Mapping[str, float]
    feed_mm_min: float


@dataclass(frozen=True, slots=True)
class Circle:
    """A circular motion as a block states it.

    axes : of its plane; centre : from the begin; turns : whole ones before the rest
    is_positive : from the first axis towards the second
    """

    axes: str
    centre: tuple[float, float]
    is_positive: bool
    turns: int = 0


@dataclass(frozen=True, slots=True)
class ProgrammedMotion:
    """Motions of a program, as a control would execute them.

    name : of the program, as the control lists it
    position : (n, axes) ends of the motions in machine coordinates, mm and deg
    feed_mm_min : (n,) of the linear axes; deg/min where rotary axes move alone
    dwell_s : (n,) after each motion
    exact_stop : (n,) True if the axes stop at the end of the motion
    row : (n,) row of the path, from 1; 0 where the program gives none
    stated_checksum : of the original path, empty if not given
    approach : motions before the first numbered row
    arc : of each motion, None where it is straight; blocks of one row are one arc
    """

    name: str
    axes: tuple[str, ...]
    position: Float64[np.ndarray, "n a"]
    feed_mm_min: Float64[np.ndarray, " n"]
    dwell_s: Float64[np.ndarray, " n"]
    exact_stop: Bool[np.ndarray, " n"]
    row: Int64[np.ndarray, " n"]
    stated_checksum: str = ""
    approach: tuple[ApproachMotion, ...] = ()
    arc: tuple[Arc | None, ...] = ()

    def __len__(self) -> int:
        return len(self.position)

    @property
    def checksum(self) -> str:
        return compute_checksum(self.axes, self.position)

    @property
    def path(self) -> Path:
        """The motion as a path, for `path.csv` of a bundle."""
        arc = self.arc if any(self.arc) else ()
        feeds = self.feed_mm_min, self.dwell_s
        return Path(self.axes, self.position, *feeds, arc=arc)


def compute_checksum(axes: Sequence[str], position: Float64[np.ndarray, "n a"]) -> str:
    """Twelve hexadecimal digits of positions, to 0.1 µm, in order.

    Feeds and dwells do not count: the analysis does not use them, and an operator may
    change them at the control.
    """
    rows = [",".join(f"{v:.4f}" for v in row) for row in np.round(position, 4) + 0.0]
    text = "\n".join([",".join(axes), *rows])
    return sha256(text.encode()).hexdigest()[:_DIGITS].upper()


class SimulatedControl:
    """Records motions and dwells in order. The first row names every axis.

    The comment of a motion gives its row. Where some do, motions before the first of
    them are the approach.

    counts_degrees : the rule of the control for the feed of all axes together
    """

    def __init__(
        self, text: str, name: str = "", *, counts_degrees: bool = False
    ) -> None:
        self._counts_degrees = counts_degrees
        stated = _CHECKSUM.search(text)
        self._stated = stated.group(1) if stated else ""
        found = ((n, _ROW.search(s)) for n, s in enumerate(text.splitlines(), 1))
        self._row_in = {n: int(row.group(1)) for n, row in found if row}
        self._approach: list[ApproachMotion] = []
        self._here: dict[str, float] = {}
        self._axes: tuple[str, ...] = ()
        self._rows: list[tuple[float, ...]] = []
        self._feed: list[float] = []
        self._dwell_s: list[float] = []
        self._exact: list[bool] = []
        self._row: list[int] = []
        self._arc: list[Arc | None] = []
        self.name = name

    def move(
        self,
        line: int,
        words: Mapping[str, float],
        feed: float | None,
        *,
        exact_stop: bool,
        circle: Circle | None = None,
    ) -> None:
        """Move to `words`; axes that are not named stay. Raises PlanningError."""
        if feed is None or not feed > 0:
            raise line_error(line, "a motion without a feed; state F")
        self._here |= words
        if line < min(self._row_in, default=0):
            self._approach.append(ApproachMotion(words, feed))
            return
        if not self._axes:
            self._axes = tuple(name for name in AXES if name in words)
        unknown = [name for name in words if name not in self._axes]
        if unknown:
            raise line_error(
                line, f"{unknown[0]} moves first here; the first row names all axes"
            )
        before = self._rows[-1] if self._rows else None
        values = before or (0.0,) * len(self._axes)
        end = tuple(words.get(n, v) for n, v in zip(self._axes, values, strict=True))
        arc = self._find_arc(line, circle, before, end) if circle else None
        row, last = self._row_in.get(line, 0), self._arc[-1] if self._arc else None
        if arc and last and row and row == self._row[-1]:
            self._rows[-1], self._exact[-1] = end, exact_stop
            self._arc[-1] = replace(last, turn_deg=last.turn_deg + arc.turn_deg)
            return
        self._arc.append(arc)
        self._feed.append(feed * self._divide_linear_by_whole(before, end))
        self._rows.append(end)
        self._dwell_s.append(0.0)
        self._exact.append(exact_stop)
        self._row.append(row)

    def turn(
        self,
        line: int,
        step: tuple[float, float],
        circle: Circle,
        feed: float | None,
    ) -> None:
        """A circle to an end that counts from its begin; to its last digit."""
        here = self._here
        begin = [here.get(name, math.nan) for name in circle.axes]
        ends = {
            name: round(a + d, _DECIMALS)
            for name, a, d in zip(circle.axes, begin, step, strict=True)
        }
        self.move(line, ends, feed, exact_stop=False, circle=circle)

    def _find_arc(
        self,
        line: int,
        circle: Circle,
        before: tuple[float, ...] | None,
        end: tuple[float, ...],
    ) -> Arc:
        columns = [self._axes.index(n) for n in circle.axes if n in self._axes]
        if before is None or len(columns) != 2:
            raise line_error(line, "a circle without a place where it begins")
        centre = [before[c] + d for c, d in zip(columns, circle.centre, strict=True)]
        ends = [
            complex(*(place[c] - m for c, m in zip(columns, centre, strict=True)))
            for place in (before, end)
        ]
        if abs(abs(ends[0]) - abs(ends[1])) > _SAME_RADIUS_MM or abs(ends[0]) < 1.0:
            raise line_error(line, "a circle that does not lead to its end")
        sense = 1.0 if circle.is_positive else -1.0
        rest = math.degrees(sense * cmath.phase(ends[1] / ends[0])) % 360.0
        if all(before[column] == end[column] for column in columns):
            rest = 360.0
        turn_deg = sense * (rest + 360.0 * circle.turns)
        return Arc(circle.axes, (centre[0], centre[1]), turn_deg)

    def dwell(self, line: int, seconds: float) -> None:
        """Dwell after the last motion; ignored before the first."""
        if not (math.isfinite(seconds) and seconds >= 0):
            raise line_error(line, f"a dwell of {seconds:g} s")
        if self._rows:
            self._dwell_s[-1] += seconds
            self._exact[-1] = self._exact[-1] or seconds > 0

    def halt(self) -> None:
        if self._rows:
            self._exact[-1] = True

    def finish(self) -> ProgrammedMotion:
        """The recorded motion. Raises PlanningError if no axis moved."""
        if not self._rows:
            raise PlanningError("the program moves no axis")
        return ProgrammedMotion(
            self.name,
            self._axes,
            np.array(self._rows),
            np.array(self._feed),
            np.array(self._dwell_s),
            np.array(self._exact),
            np.array(self._row, np.int64),
            self._stated,
            tuple(self._approach),
            tuple(self._arc),
        )

    def moves_rotary_only(self, words: Mapping[str, float]) -> bool:
        """True if a motion to `words` leaves every linear axis in place."""
        moving = {n for n, v in words.items() if self._here.get(n) != v}
        return bool(moving) and not any(n in _LINEAR for n in moving)

    def _divide_linear_by_whole(
        self, before: tuple[float, ...] | None, end: tuple[float, ...]
    ) -> float:
        if before is None or not self._counts_degrees:
            return 1.0
        step = [(n, b - a) for n, a, b in zip(self._axes, before, end, strict=True)]
        whole = math.hypot(*(d for _, d in step))
        straight = math.hypot(*(d for n, d in step if n in _LINEAR))
        return straight / whole if straight > 0 else 1.0


def line_error(line: int, problem: str) -> PlanningError:
    """Lines of a program count from 1; 0 for the whole program."""
    return PlanningError(f"line {line} of the program: {problem}")
