"""Fanuc series 0i, 16i, 18i, 30i and later, milling (G-code system A of mills).

Every number of a position, feed or dwell has a decimal point: without one a control of
this make counts in its least increment, so that `X10` is 0.010 mm. Three decimals are
what increment system IS-B takes. `G53` moves at rapid traverse only, so positions are
in `G54`, and the control itself checks before it moves that no work offset is in the
way: it compares the machine position (#5021 …) of each axis with the work position
(#5041 …) and raises an alarm where they differ; this takes custom macro B. `G61` stops
exactly. F is the feed of all axes together, a degree counted as a millimetre.
Source: FANUC series 0i and 30i operator's manuals (decimal point programming; G61;
feed per minute with rotary axes; system variables of the current position).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import ClassVar

from app.motion.nc_programs.control import AXES, Control, fault
from app.motion.nc_programs.dialect import Dialect
from app.motion.nc_programs.iso_words import Groups, Modes, Word, words_of
from app.motion.nc_programs.motion import ProgrammedMotion
from app.motion.nc_programs.order import RECORD, THE_END, WAY_FREE, Order, Step

_SAFE_START = ("G21", "G17 G40 G49 G80 G90 G94", "G54", "G61")
_MACHINE, _WORK = 5021, 5041  # position of the first axis; the others follow
_LARGEST_NUMBER = 7999  # those above may be protected


class Fanuc(Dialect):
    """Programs between two `%`, called by an O-number."""

    control: ClassVar[str] = "Fanuc"
    suffix: ClassVar[str] = ".nc"
    decimals: ClassVar[int] = 3
    most_rows: ClassVar[int] = 9999
    longest_dwell_s: ClassVar[float] = 9999.0
    counts_degrees: ClassVar[bool] = True
    frame: ClassVar[str] = "G54 AND EXTERNAL OFFSET MUST BE ZERO - CHECKED BEFORE ROW 1"

    def program_name(self, wanted: str, checksum: str) -> str:
        """Return an O-number out of the checksum: other paths have other numbers."""
        return f"O{1 + int(checksum, 16) % _LARGEST_NUMBER:04d}"

    def write(self, order: Order) -> str:
        """Return the program from `%` to `%`."""
        return "\n".join(_blocks(order)) + "\n"

    def read(self, text: str) -> ProgrammedMotion:
        """Return what the control would do."""
        return _Reader(text).motion()


def _blocks(order: Order) -> Iterator[str]:
    yield "%"
    yield f"{order.name} (TRUEPATH)"
    yield from (f"({line})" for line in order.header)
    yield from _SAFE_START
    yield from _wait(WAY_FREE)
    for index, name in enumerate(order.axes):
        yield _guard(index, name)
    for step in order.steps:
        if step.change:
            yield from _wait(step.change)
        yield _motion(order, step)
        if step.row == 1:
            yield from _wait(RECORD)
        if step.dwell_s > 0:
            yield f"G4 X{step.dwell_s:.3f}"
    yield f"({THE_END})"
    yield "M30"
    yield "%"


def _guard(index: int, name: str) -> str:
    """Raise an alarm where work and machine position of an axis differ."""
    machine, work = _MACHINE + index, _WORK + index
    return (
        f"IF [ABS[#{machine}-#{work}] GT 0.001] "
        f"THEN #3000={index + 1} (AXIS {index + 1} {name} HAS AN OFFSET)"
    )


def _motion(order: Order, step: Step) -> str:
    ends = zip(order.axes, step.position, strict=True)
    return (
        f"N{step.row} G1 "
        + " ".join(f"{name}{value:.3f}" for name, value in ends)
        + f" F{step.path_feed:.3f}"
    )


def _wait(message: str) -> tuple[str, ...]:
    return f"({message})", "M0"


_GROUPS: Groups = {
    "the unit": ("G21", "G20"),
    "the plane": ("G17", "G18", "G19"),
    "radius compensation": ("G40", "G41", "G42"),
    "the tool length": ("G49", "G43", "G44"),
    "the cycle": ("G80", "G81", "G82", "G83"),
    "the dimension": ("G90", "G91"),
    "the feed": ("G94", "G93", "G95"),
    "the work offset": ("G54", "G55", "G56", "G57", "G58", "G59"),
}
_PATH_MODE = ("G61", "G62", "G64")
_COMMENT = re.compile(r"\([^()]*\)")
_NUMBER = re.compile(r"O(\d{1,8})")
_CHECK = re.compile(r"IF\s*\[ABS\[#(\d+)-#(\d+)\]\s*GT\s*0?\.\d+\]\s*THEN\s*#3000=\d+")
_INCREMENT = 0.001  # mm or deg; of a dwell in X, s


class _Reader:
    def __init__(self, text: str) -> None:
        self._control = Control(text, counts_degrees=True)
        self._modes = Modes(_GROUPS, _PATH_MODE)
        self._feed: float | None = None
        self._checked: set[int] = set()  # axes, from 0, whose offset was checked
        lines = text.split("\n")
        while lines and not lines[-1].strip():
            lines.pop()
        if len(lines) < 3 or lines[0].strip() != "%" or lines[-1].strip() != "%":
            raise fault(1, "a program stands between two lines of %")
        self._name(_COMMENT.sub("", lines[1]).strip())
        blocks = [(n, _COMMENT.sub(" ", s).strip()) for n, s in enumerate(lines, 1)]
        self._run([(n, block) for n, block in blocks[2:-1] if block])

    def motion(self) -> ProgrammedMotion:
        return self._control.motion()

    def _name(self, block: str) -> None:
        number = _NUMBER.fullmatch(block)
        if number is None or int(number.group(1)) == 0:
            raise fault(2, "an O-number is needed after the first %")
        self._control.name = block

    def _run(self, blocks: list[tuple[int, str]]) -> None:
        if not blocks or words_of(*blocks[-1])[-1].code != "M30":
            raise fault(0, "it has no M30 before its last %")
        for line, block in blocks[:-1]:
            check = _CHECK.fullmatch(block)
            if check:
                self._note(line, int(check.group(1)), int(check.group(2)))
            else:
                self._block(line, words_of(line, block))

    def _note(self, line: int, machine: int, work: int) -> None:
        if machine - _MACHINE != work - _WORK:
            raise fault(line, f"#{machine} and #{work} belong to different axes")
        self._checked.add(machine - _MACHINE)

    def _block(self, line: int, words: list[Word]) -> None:
        codes = {w.code for w in words if w.letter in "GM"}
        for code in codes - {"G1", "G4"}:
            self._take(line, code)
        values = {w.letter: w for w in words if w.letter not in "GM"}
        if "F" in values:
            self._feed = values["F"].value  # with or without a point, mm/min
        if "G4" in codes:
            self._control.dwell(line, _dwell_s(line, values))
            return
        ends = {n: _in_millimetres(w) for n, w in values.items() if n in AXES}
        if ends:
            row = int(values["N"].value) if "N" in values else 0
            self._drive(line, ends, codes, row)

    def _take(self, line: int, code: str) -> None:
        if code == "M0":
            self._control.halt()
        else:
            self._modes.take(line, code)

    def _drive(
        self, line: int, ends: dict[str, float], codes: set[str], row: int
    ) -> None:
        if "G1" not in codes:
            raise fault(line, "a motion without G1")
        if not set(range(len(ends))) <= self._checked:
            raise fault(line, "a position in G54 whose offset is not checked")
        self._modes.require(line)
        self._control.move(
            line, ends, self._feed, exact_stop=self._modes.exact_stop, row=row
        )


def _in_millimetres(word: Word) -> float:
    """Without a decimal point a number counts least increments."""
    return word.value * (1.0 if "." in word.digits else _INCREMENT)


def _dwell_s(line: int, values: dict[str, Word]) -> float:
    if "X" in values:
        return _in_millimetres(values["X"])
    if "P" in values and "." not in values["P"].digits:
        return values["P"].value * 1e-3
    raise fault(line, "a dwell needs X in seconds with a point, or P in milliseconds")
