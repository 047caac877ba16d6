"""LinuxCNC (RS-274/NGC).

`G53` holds in its block: positions are machine coordinates whatever offsets are set.
The exact stop is `G61.1`: `G61` follows the path exactly but runs through rows that lie
on one line (measured on LinuxCNC 2.9). F is the feed of X, Y, Z where one of them
moves, else that of the rotary axes, in deg/min.
Source: LinuxCNC documentation, G-code reference (G53, G61.1, G94), and its interpreter.
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

_SAFE_START = ("G21", "G17 G40 G49 G80 G90 G94", "G61.1")


class LinuxCnc(Dialect):
    """Programs of LinuxCNC, `.ngc`."""

    control: ClassVar[str] = "LinuxCNC"
    suffix: ClassVar[str] = ".ngc"
    frame: ClassVar[str] = "WITHOUT ANY OFFSET IN EACH BLOCK - G53"

    def write(self, order: Order) -> str:
        """Return the program; its name is that of its file and stands in a comment."""
        return "\n".join(_blocks(order)) + "\n"

    def read(self, text: str) -> ProgrammedMotion:
        """Return what the control would do."""
        return _Reader(text).motion()


def _blocks(order: Order) -> Iterator[str]:
    yield f"(PROGRAM {order.name})"
    yield from (f"({line})" for line in order.header)
    yield from _SAFE_START
    yield from _wait(WAY_FREE)
    for step in order.steps:
        if step.change:
            yield from _wait(step.change)
        yield _motion(order, step)
        if step.row == 1:
            yield from _wait(RECORD)
        if step.dwell_s > 0:
            yield f"G4 P{step.dwell_s:.3f}"
    yield f"(MSG, {THE_END})"
    yield "M2"


def _motion(order: Order, step: Step) -> str:
    ends = zip(order.axes, step.position, strict=True)
    return (
        f"N{step.row} G53 G1 "
        + " ".join(f"{name}{value:.4f}" for name, value in ends)
        + f" F{step.feed:.3f}"
    )


def _wait(message: str) -> tuple[str, ...]:
    return f"(MSG, {message})", "M0"


_GROUPS: Groups = {
    "the unit": ("G21", "G20"),
    "the plane": ("G17", "G18", "G19"),
    "radius compensation": ("G40", "G41", "G42"),
    "the tool length": ("G49", "G43", "G43.1"),
    "the cycle": ("G80", "G81", "G82", "G83"),
    "the dimension": ("G90", "G91"),
    "the feed": ("G94", "G93", "G95"),
}
_PATH_MODE = ("G61.1", "G61", "G64")
_NAME = re.compile(r"^\(PROGRAM (\w+)\)$", re.MULTILINE)
_COMMENT = re.compile(r"\([^()]*\)")


class _Reader:
    def __init__(self, text: str) -> None:
        self._control = Control(text, counts_degrees=False)
        named = _NAME.search(text)
        self._control.name = named.group(1) if named else ""
        self._modes = Modes(_GROUPS, _PATH_MODE)
        self._feed: float | None = None
        self._ended = False
        for number, line in enumerate(text.splitlines(), 1):
            if not self._ended:
                self._block(number, _COMMENT.sub(" ", line))

    def motion(self) -> ProgrammedMotion:
        if not self._ended:
            raise fault(0, "it has no M2 at its end")
        return self._control.motion()

    def _block(self, line: int, block: str) -> None:
        words = words_of(line, block)
        values = {w.letter: w.value for w in words}
        codes = {w.code for w in words if w.letter in "GM"}
        self._feed = values.get("F", self._feed)
        for code in codes - {"G1", "G4", "G53"}:
            self._take(line, code)
        if "G4" in codes:
            self._control.dwell(line, values.get("P", -1.0))
        ends = {letter: v for letter, v in values.items() if letter in AXES}
        if ends:
            self._drive(line, ends, codes, int(values.get("N", 0)))

    def _take(self, line: int, code: str) -> None:
        if code == "M2":
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
        if "G53" not in codes:
            raise fault(line, "a position in a work offset; G53 is needed")
        self._modes.require(line)
        self._control.move(
            line, ends, self._feed, exact_stop=self._modes.exact_stop, row=row
        )
