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
    line_error,
)

_SAFE_START = ("G17 G40 G90 G94", "G710", "G500 D0", "TRAFOOF", "TRANS", "G60 G601")


class Siemens(Dialect):
    """Main programs, `.MPF`."""

    control = "Siemens 840D"
    suffix = ".mpf"
    frame = "FRAMES ARE SUPPRESSED IN EACH BLOCK - SUPA"

    def write(self, content: ProgramContent) -> str:
        """Return the program; its name is that of its file and stands in a comment."""
        return "\n".join(_write_blocks(content)) + "\n"

    def read(self, text: str) -> ProgrammedMotion:
        """Return the motion of the control."""
        reader = _Reader(text, find_name(text, _NAME))
        for number, line in enumerate(text.upper().splitlines(), 1):
            block = _MESSAGE.sub("", line).partition(";")[0].strip()
            if block and reader.ended:
                raise line_error(number, "a block after M30")
            reader.read_block(number, block)
        return reader.finish()


def _write_blocks(content: ProgramContent) -> Iterator[str]:
    group = content.linear

    def write_motion(row: ProgramRow) -> Iterator[str]:
        nonlocal group
        wanted = content.rotary if row.rotary_only else content.linear
        if wanted != group:
            group = wanted
            yield _write_feed_group(group)
        ends = format_position(content, row, ".4f")
        yield f"N{row.number} G1 SUPA {ends} F{row.feed:.3f}"

    yield f"; PROGRAM {content.name}"
    yield from (f"; {line}" for line in content.header)
    yield from _SAFE_START
    yield _write_feed_group(group)
    yield from arrange_blocks(
        content.rows,
        write_stop=lambda message: (f'MSG("{message}")', "M0"),
        write_motion=write_motion,
        write_dwell=lambda dwell_s: (f"G4 F{dwell_s:.3f}",) if dwell_s > 0 else (),
    )
    yield f'MSG("{STOP_RECORDING}")'
    yield "M30"


def _write_feed_group(axes: tuple[str, ...]) -> str:
    return f"FGROUP({','.join(axes)})"


_NAME = re.compile(r"^; PROGRAM (\w+)$", re.MULTILINE)
_MESSAGE = re.compile(r'MSG\s*\(("[^"]*")?\)')
_FEED_GROUP = re.compile(r"FGROUP\(([A-Z](?:,[A-Z])*)\)")
_KEYWORDS = re.compile(r"\b(?:SUPA|TRAFOOF|TRAORI|TRANS)\b")


class _Reader(GCodeReader):
    groups: ClassVar[Groups] = {
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
    path_modes = ("G60", "G64", "G641", "G642")
    frame = ("SUPA", "G153")
    passive = ("G1", "G601", "G602", "G603")
    end = "M30"
    feed_group = ""

    def read_block(self, line: int, block: str) -> None:
        group = _FEED_GROUP.fullmatch(block)
        if group:
            self.feed_group = group.group(1).replace(",", "")
            return
        words = split_words(line, _KEYWORDS.sub("", block))
        codes = {w.code for w in words if w.letter in "GMD"}
        codes |= set(_KEYWORDS.findall(block))
        values = {w.letter: w.value for w in words}
        if "G4" in codes:
            self.control.dwell(line, values.get("F", -1.0))
            return
        self.feed = values.get("F", self.feed)
        self.apply_codes(line, codes)
        ends = {letter: v for letter, v in values.items() if letter in AXES}
        if ends:
            self.check_motion(line, codes)
            self._check_feed_group(line, ends)
            self.drive(line, ends, int(values.get("N", 0)))

    def _check_feed_group(self, line: int, ends: dict[str, float]) -> None:
        """Refuse a motion whose feed is that of axes that stand still."""
        has_linear = any(name in "XYZ" for name in self.feed_group)
        rotary_only = self.control.moves_rotary_only(ends)
        if not self.feed_group or rotary_only == has_linear:
            raise line_error(
                line, f"F belongs to FGROUP({self.feed_group}), which does not move"
            )
