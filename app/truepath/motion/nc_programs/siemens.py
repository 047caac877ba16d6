"""Siemens SINUMERIK 840D (powerline, sl, ONE).

`SUPA` suppresses every frame in its block, so positions are machine coordinates
whatever work offset is set; `D0` deselects the tool. `G60 G601` stops exactly, in the
fine window, and `COMPOF` switches off the block compressor; after the last row `G64` is
set, and `M30` restores the machine's initial modes. `FGROUP` selects the axes of the
feed F: the linear axes, or the rotary axes where they turn alone; a degree counts as a
millimetre (`FGREF` at its default). `TURN` is the number of whole turns before the rest
of a circle; its centre counts from its begin.

Source: SINUMERIK 840D sl programming manual, fundamentals (frames; feed control).
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
    GCodeReader,
    Groups,
    find_name,
)
from truepath.motion.nc_programs.programmed_motion import (
    ProgrammedMotion,
    line_error,
)

_SAFE_START = (
    "G17 G40 G90 G94",
    "G710",
    "G500 D0",
    "TRAFOOF",
    "TRANS",
    "COMPOF",
    "G60 G601",
)
_CONTINUOUS = "G64"
_FORMS = BlockForms(
    motion="G1 SUPA {ends} F{row.feed:.3f} ; {row.label}",
    dwell=("G4 F{:.3f}",),
    message='MSG("{}")',
)


class Siemens(Dialect):
    control = "Siemens 840D"
    suffix = ".mpf"
    frame = "FRAMES ARE SUPPRESSED IN EACH BLOCK - SUPA"
    drives_arcs = True

    def write(self, content: ProgramContent) -> str:
        """The program's name is that of its file and in a comment."""
        header = [f"; {s}" for s in (f"PROGRAM {content.name}", *content.header)]
        return "\n".join([*header, *number_blocks(_write_blocks(content)), ""])

    def read(self, text: str) -> ProgrammedMotion:
        """Raises PlanningError at a block after M30."""
        reader = _Reader(text, find_name(text, _NAME))
        for number, line in enumerate(text.upper().splitlines(), 1):
            block = _MESSAGE.sub("", line).partition(";")[0].strip()
            if block and reader.ended:
                raise line_error(number, "a block after M30")
            reader.read_block(number, block)
        return reader.finish()


def _write_blocks(content: ProgramContent) -> Iterator[str]:
    group = content.linear

    def write_group(row: ProgramRow) -> Iterator[str]:
        nonlocal group
        wanted = content.rotary if row.rotary_only else content.linear
        if wanted != group:
            group = wanted
            yield _write_feed_group(group)

    yield from _SAFE_START
    yield _write_feed_group(group)
    yield from _FORMS.write_rows(content, write_group, _write_arc)
    yield _CONTINUOUS
    yield "M30"


def _write_arc(row: ProgramRow, arc: ProgramArc) -> Iterator[str]:
    ends = write_words(row.axes, row.position, ".4f")
    centre = write_words((CENTRES[a] for a in arc.axes), arc.centre, ".4f")
    turns = f" TURN={arc.turns}" if arc.turns else ""
    yield PLANES[arc.axes]
    yield f"{arc.code} SUPA {ends} {centre}{turns} F{row.feed:.3f} ; {row.label}"
    yield "G17"


def _write_feed_group(axes: tuple[str, ...]) -> str:
    return f"FGROUP({','.join(axes)})"


_NAME = re.compile(r"^; PROGRAM (\w+)$", re.MULTILINE)
_MESSAGE = re.compile(r'MSG\s*\(("[^"]*")?\)')
_TURNS = re.compile(r"\bTURN=(\d{1,3})\b")
_FEED_GROUP = re.compile(r"(?:N\d+ )?FGROUP\(([A-Z](?:,[A-Z])*)\)")


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
    passive = ("G1", *ARCS, "G4", "G601", "G602", "G603", "COMPOF")
    dwell_letter = "F"
    end = "M30"
    modal = "GMD"
    keywords = re.compile(r"\b(?:SUPA|TRAFOOF|TRAORI|TRANS|COMP[A-Z]+)\b")
    feed_group = ""

    def read_block(self, line: int, block: str) -> None:
        group = _FEED_GROUP.fullmatch(block)
        if group:
            self.feed_group = group.group(1).replace(",", "")
            return
        turns = _TURNS.search(block)
        self.turns = int(turns.group(1)) if turns else 0
        super().read_block(line, _TURNS.sub("", block))

    def check_ends(self, line: int, ends: Mapping[str, float]) -> None:
        has_linear = any(name in "XYZ" for name in self.feed_group)
        rotary_only = self.control.moves_rotary_only(ends)
        if not self.feed_group or rotary_only == has_linear:
            raise line_error(
                line, f"F belongs to FGROUP({self.feed_group}), which does not move"
            )
