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

from app.motion.nc_programs.dialect import (
    STOP_RECORDING,
    Dialect,
    arrange_blocks,
    format_position,
)
from app.motion.nc_programs.gcode import GCodeReader, Groups, find_name, split_words
from app.motion.nc_programs.program_content import ProgramContent, ProgramRow
from app.motion.nc_programs.programmed_motion import (
    AXES,
    ProgrammedMotion,
)

_SAFE_START = ("G21", "G17 G40 G49 G80 G90 G94", "G61.1")


class LinuxCnc(Dialect):
    """Programs of LinuxCNC, `.ngc`."""

    control = "LinuxCNC"
    suffix = ".ngc"
    frame = "WITHOUT ANY OFFSET IN EACH BLOCK - G53"

    def write(self, content: ProgramContent) -> str:
        """Return the program; its name is that of its file and stands in a comment."""
        return "\n".join(_write_blocks(content)) + "\n"

    def read(self, text: str) -> ProgrammedMotion:
        """Return the motion of the control."""
        reader = _Reader(text, find_name(text, _NAME))
        for number, line in enumerate(text.splitlines(), 1):
            if not reader.ended:
                reader.read_block(number, _COMMENT.sub(" ", line))
        return reader.finish()


def _write_blocks(content: ProgramContent) -> Iterator[str]:
    def write_motion(row: ProgramRow) -> Iterator[str]:
        ends = format_position(content, row, ".4f")
        yield f"N{row.number} G53 G1 {ends} F{row.feed:.3f}"

    yield f"(PROGRAM {content.name})"
    yield from (f"({line})" for line in content.header)
    yield from _SAFE_START
    yield from arrange_blocks(
        content.rows,
        write_stop=lambda message: (f"(MSG, {message})", "M0"),
        write_motion=write_motion,
        write_dwell=lambda dwell_s: (f"G4 P{dwell_s:.3f}",) if dwell_s > 0 else (),
    )
    yield f"(MSG, {STOP_RECORDING})"
    yield "M2"


_NAME = re.compile(r"^\(PROGRAM (\w+)\)$", re.MULTILINE)
_COMMENT = re.compile(r"\([^()]*\)")


class _Reader(GCodeReader):
    groups: ClassVar[Groups] = {
        "the unit": ("G21", "G20"),
        "the plane": ("G17", "G18", "G19"),
        "radius compensation": ("G40", "G41", "G42"),
        "the tool length": ("G49", "G43", "G43.1"),
        "the cycle": ("G80", "G81", "G82", "G83"),
        "the dimension": ("G90", "G91"),
        "the feed": ("G94", "G93", "G95"),
    }
    path_modes = ("G61.1", "G61", "G64")
    frame = ("G53",)
    passive = ("G1", "G4")
    end = "M2"

    def read_block(self, line: int, block: str) -> None:
        words = split_words(line, block)
        values = {w.letter: w.value for w in words}
        codes = {w.code for w in words if w.letter in "GM"}
        self.feed = values.get("F", self.feed)
        self.apply_codes(line, codes)
        if "G4" in codes:
            self.control.dwell(line, values.get("P", -1.0))
        ends = {letter: v for letter, v in values.items() if letter in AXES}
        if ends:
            self.check_motion(line, codes)
            self.drive(line, ends, int(values.get("N", 0)))
