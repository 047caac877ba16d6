"""Fanuc series 0i, 16i, 18i, 30i and later, milling (G-code system A of mills).

Every number of a position, feed or dwell has a decimal point: without one a control of
this make counts in its least increment, so that `X10` is 0.010 mm. Three decimals are
the resolution of increment system IS-B. `G53` moves at rapid traverse only, so
positions are in `G54`, and the control itself checks before it moves that no work
offset is in the way: it compares the machine position (#5021 …) of each axis with the
work position (#5041 …) and raises an alarm where they differ; this takes custom macro
B. `G61` stops exactly. `G5.1 Q0` switches AI contour control off; a control without
that option skips the block by its switch for `/`. F is the feed of all axes together, a
degree counted as a millimetre. `G20` or `G21` outlasts the program on this control, so
the one that was active is kept (#4006) and set again before the end; where no value was
kept, `G#1` is ignored. A circle of several turns is a block a turn, in `G64` until the
last, so that the axes do not stop on it.

Source: FANUC series 0i and 30i operator's manuals (decimal point programming; G61; feed
per minute with rotary axes; system variables of the current position and of modal
information; variables as the number of a G code, undefined variables).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import ClassVar

from truepath.motion.nc_programs.dialect import (
    CENTRES,
    PLANES,
    BlockForms,
    Dialect,
    ProgramArc,
    ProgramContent,
    ProgramRow,
    number_blocks,
    write_words,
)
from truepath.motion.nc_programs.gcode import (
    ARCS,
    MILLING_GROUPS,
    GCodeReader,
    Groups,
    Word,
    split_words,
)
from truepath.motion.nc_programs.programmed_motion import (
    ProgrammedMotion,
    line_error,
)

_KEEP_UNIT, _RESTORE_UNIT = "#1=#4006", "G#1"
_SAFE_START = (_KEEP_UNIT, "G21", "G17 G40 G49 G80 G90 G94", "G54", "/G5.1 Q0", "G61")
_CONTINUOUS = "G64"
_FORMS = BlockForms(
    motion="G1 {ends} F{row.path_feed:.3f} ({row.label})",
    dwell=("G4 X{:.3f}",),
    message="({})",
    number=".3f",
)
_MACHINE, _WORK = 5021, 5041  # position of the first axis; the others follow
_LARGEST_NUMBER = 7999  # those above may be protected


class Fanuc(Dialect):
    """Programs between two `%`, called by an O-number."""

    control = "Fanuc"
    suffix = ".nc"
    decimals = 3
    longest_dwell_s = 9999.0
    counts_degrees = True
    frame = "G54 AND EXTERNAL OFFSET MUST BE ZERO - CHECKED BEFORE ROW 1"
    drives_arcs = True

    def program_name(self, wanted: str, checksum: str) -> str:
        """An O-number from the checksum: other paths have other numbers."""
        return f"O{1 + int(checksum, 16) % _LARGEST_NUMBER:04d}"

    def write(self, content: ProgramContent) -> str:
        """From `%` to `%`, with a guard against work offsets before row 1."""
        check_way, stop, *rows = _FORMS.write_rows(content, write_arc=_write_arc)
        guards = [_write_guard(*axis) for axis in enumerate(content.axes)]
        head = ["%", f"{content.name} (TRUEPATH)", *(f"({s})" for s in content.header)]
        end = [_CONTINUOUS, _RESTORE_UNIT, "M30"]
        blocks = [*_SAFE_START, check_way, stop, *guards, *rows, *end]
        return "\n".join([*head, *number_blocks(blocks), "%", ""])

    def read(self, text: str) -> ProgrammedMotion:
        """Requires the guards on all axes that move."""
        lines = text.rstrip().split("\n")
        if len(lines) < 3 or lines[0].strip() != "%" or lines[-1].strip() != "%":
            raise line_error(1, "a program stands between two lines of %")
        blocks = [_COMMENT.sub(" ", line).strip() for line in lines]
        reader = _Reader(text, _read_number(blocks[1]))
        path = [(n, s) for n, s in enumerate(blocks[2:-1], 3) if s]
        if not path or split_words(*path[-1])[-1].code != "M30":
            raise line_error(0, "it has no M30 before its last %")
        for line, block in path[:-1]:
            reader.read_block(line, block)
        return reader.control.finish()


def _write_arc(row: ProgramRow, arc: ProgramArc) -> Iterator[str]:
    columns = [row.axes.index(axis) for axis in arc.axes]
    centre = write_words((CENTRES[a] for a in arc.axes), arc.centre, ".3f")
    yield f"{PLANES[arc.axes]} {_CONTINUOUS}"
    for rest in range(arc.turns, -1, -1):
        place = [row.position[c] for c in columns] if rest == 0 else arc.begin
        ends = write_words(arc.axes, place, ".3f")
        stop = "" if rest else "G61 "
        yield f"{stop}{arc.code} {ends} {centre} F{row.feed:.3f} ({row.label})"
    yield "G17"


def _write_guard(index: int, name: str) -> str:
    machine, work = _MACHINE + index, _WORK + index
    return (
        f"IF [ABS[#{machine}-#{work}] GT 0.001] "
        f"THEN #3000={index + 1} (AXIS {index + 1} {name} HAS AN OFFSET)"
    )


_COMMENT = re.compile(r"\([^()]*\)")
_NUMBER = re.compile(r"O(\d{1,8})")
_NO_CONTOUR_CONTROL = re.compile(r"(?:N\d+ )?/?G0?5\.1\s*Q0")
_KEEPS_UNIT = re.compile(r"(?:N\d+ )?#1\s*=\s*#4006")
_RESTORES_UNIT = re.compile(r"(?:N\d+ )?G#1")
_GUARD = re.compile(
    r"(?:N\d+ )?IF\s*\[ABS\[#(\d+)-#(\d+)\]\s*GT\s*0?\.\d+\]\s*THEN\s*#3000=\d+"
)
_INCREMENT = 0.001  # mm or deg; of a dwell in X, s


class _Reader(GCodeReader):
    groups: ClassVar[Groups] = {
        **MILLING_GROUPS,
        "the tool length": ("G49", "G43", "G44"),
        "the work offset": ("G54", "G55", "G56", "G57", "G58", "G59"),
    }
    path_modes = ("G61", "G62", "G64")
    passive = ("G1", *ARCS, "G4")

    def __init__(self, text: str, name: str) -> None:
        super().__init__(text, name, counts_degrees=True)
        self._checked: set[int] = set()  # axes, from 0, whose offset was checked

    def read_block(self, line: int, block: str) -> None:
        if _NO_CONTOUR_CONTROL.fullmatch(block) or _KEEPS_UNIT.fullmatch(block):
            return
        if _RESTORES_UNIT.fullmatch(block):
            self.apply_codes(line, {"G20"})  # for all that is known here
            return
        guard = _GUARD.fullmatch(block)
        if guard:
            self._note_guard(line, int(guard.group(1)), int(guard.group(2)))
            return
        super().read_block(line, block)

    def take_dwell_s(self, line: int, words: dict[str, Word]) -> float:
        if "X" in words:
            return self.read_end(words.pop("X"))
        if "P" in words and "." not in words["P"].digits:
            return words["P"].value * 1e-3
        raise line_error(
            line, "a dwell needs X in seconds with a point, or P in milliseconds"
        )

    def read_end(self, word: Word) -> float:
        """Without a decimal point it counts least increments."""
        return word.value * (1.0 if "." in word.digits else _INCREMENT)

    def check_ends(self, line: int, ends: Mapping[str, float]) -> None:
        if not set(range(len(ends))) <= self._checked:
            raise line_error(line, "a position in G54 whose offset is not checked")

    def _note_guard(self, line: int, machine: int, work: int) -> None:
        if machine - _MACHINE != work - _WORK:
            raise line_error(line, f"#{machine} and #{work} belong to different axes")
        self._checked.add(machine - _MACHINE)


def _read_number(block: str) -> str:
    number = _NUMBER.fullmatch(block)
    if number is None or int(number.group(1)) == 0:
        raise line_error(2, "an O-number is needed after the first %")
    return block
