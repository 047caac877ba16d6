"""Siemens SINUMERIK 840D (powerline, sl, ONE).

`SUPA` suppresses every frame in its block, so positions are machine coordinates
whatever work offset is set; `D0` takes the tool away. `G60 G601` stops exactly, in the
fine window. `FGROUP` says whose feed F is: of the linear axes, or of the rotary axes
where they turn alone; a degree counts as a millimetre (`FGREF` as it is by default).
Source: SINUMERIK 840D sl programming manual, fundamentals (frames; feed control).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import ClassVar

from app.motion.nc_programs.control import AXES, Control, fault
from app.motion.nc_programs.dialect import Dialect
from app.motion.nc_programs.iso_words import Groups, Modes, words_of
from app.motion.nc_programs.motion import ProgrammedMotion
from app.motion.nc_programs.order import RECORD, THE_END, WAY_FREE, Order, Step

_SAFE_START = (
    "G17 G40 G90 G94",
    "G710",
    "G500 D0",
    "TRAFOOF",
    "TRANS",
    "G60 G601",
)


class Siemens(Dialect):
    """Main programs, `.MPF`."""

    control: ClassVar[str] = "Siemens 840D"
    suffix: ClassVar[str] = ".mpf"
    frame: ClassVar[str] = "FRAMES ARE SUPPRESSED IN EACH BLOCK - SUPA"

    def write(self, order: Order) -> str:
        """Return the program; its name is that of its file and stands in a comment."""
        return "\n".join(_blocks(order)) + "\n"

    def read(self, text: str) -> ProgrammedMotion:
        """Return what the control would do."""
        return _Reader(text).motion()


def _blocks(order: Order) -> Iterator[str]:
    yield f"; PROGRAM {order.name}"
    yield from (f"; {line}" for line in order.header)
    yield from _SAFE_START
    yield _feed_group(order.linear)
    yield from _wait(WAY_FREE)
    group = order.linear
    for step in order.steps:
        if step.change:
            yield from _wait(step.change)
        wanted = order.rotary if step.turns_only else order.linear
        if wanted != group:
            group = wanted
            yield _feed_group(group)
        yield _motion(order, step)
        if step.row == 1:
            yield from _wait(RECORD)
        if step.dwell_s > 0:
            yield f"G4 F{step.dwell_s:.3f}"
    yield f'MSG("{THE_END}")'
    yield "M30"


def _motion(order: Order, step: Step) -> str:
    ends = zip(order.axes, step.position, strict=True)
    return (
        f"N{step.row} G1 SUPA "
        + " ".join(f"{name}{value:.4f}" for name, value in ends)
        + f" F{step.feed:.3f}"
    )


def _feed_group(axes: tuple[str, ...]) -> str:
    return f"FGROUP({','.join(axes)})"


def _wait(message: str) -> tuple[str, ...]:
    return f'MSG("{message}")', "M0"


_GROUPS: Groups = {
    "the plane": ("G17", "G18", "G19"),
    "radius compensation": ("G40", "G41", "G42"),
    "the dimension": ("G90", "G91"),
    "the feed": ("G94", "G93", "G95", "G96"),
    "the unit": ("G710", "G71", "G70", "G700"),
    "the work offset": ("G500", "G54", "G55", "G56", "G57"),
    "the tool offset": ("D0", "D1", "D2"),
    "the transformation": ("TRAFOOF", "TRAORI"),
    "the programmable frame": ("TRANS",),
}
_PATH_MODE = ("G60", "G64", "G641", "G642")
_WINDOW = {"G601", "G602", "G603"}
_NAME = re.compile(r"^; PROGRAM (\w+)$", re.MULTILINE)
_MESSAGE = re.compile(r'MSG\s*\(("[^"]*")?\)')
_GROUP = re.compile(r"FGROUP\(([A-Z](?:,[A-Z])*)\)")
_WORDS = re.compile(r"\b(?:SUPA|TRAFOOF|TRAORI|TRANS)\b")


class _Reader:
    def __init__(self, text: str) -> None:
        self._control = Control(text, counts_degrees=False)
        named = _NAME.search(text)
        self._control.name = named.group(1) if named else ""
        self._modes = Modes(_GROUPS, _PATH_MODE)
        self._feed: float | None = None
        self._feed_group = ""
        self._ended = False
        for number, line in enumerate(text.upper().splitlines(), 1):
            self._block(number, _MESSAGE.sub("", line).partition(";")[0].strip())

    def motion(self) -> ProgrammedMotion:
        if not self._ended:
            raise fault(0, "it has no M30 at its end")
        return self._control.motion()

    def _block(self, line: int, block: str) -> None:
        if block and self._ended:
            raise fault(line, "a block after M30")
        group = _GROUP.fullmatch(block)
        if group:
            self._feed_group = group.group(1).replace(",", "")
            return
        keywords = set(_WORDS.findall(block))
        words = words_of(line, _WORDS.sub("", block))
        codes = {w.code for w in words if w.letter in "GMD"} | keywords
        ends = {w.letter: w.value for w in words if w.letter in AXES}
        feeds = [w.value for w in words if w.letter == "F"]
        if "G4" in codes:
            self._control.dwell(line, feeds[0] if feeds else -1.0)
            return
        self._feed = feeds[0] if feeds else self._feed
        self._take(line, codes)
        rows = [int(w.value) for w in words if w.letter == "N"]
        if ends:
            self._drive(line, ends, codes, rows[0] if rows else 0)

    def _take(self, line: int, codes: set[str]) -> None:
        for code in codes - {"SUPA", "G153", "G1"} - _WINDOW:
            if code == "M30":
                self._ended = True
            elif code == "M0":
                self._control.halt()
            else:
                self._modes.take(line, code)

    def _drive(
        self, line: int, ends: dict[str, float], codes: set[str], row: int
    ) -> None:
        if "G1" not in codes:
            raise fault(line, "a motion without G1")
        if not codes & {"SUPA", "G153"}:
            raise fault(line, "a position in a work offset; SUPA is needed")
        self._modes.require(line)
        turns_only = self._control.turns_only(ends)
        if not self._feed_group or turns_only == any(
            name in "XYZ" for name in self._feed_group
        ):
            raise fault(
                line, f"F belongs to FGROUP({self._feed_group}), which does not move"
            )
        self._control.move(
            line, ends, self._feed, exact_stop=self._modes.exact_stop, row=row
        )
