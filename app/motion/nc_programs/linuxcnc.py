"""LinuxCNC (RS-274/NGC).

`G53` holds in its block: positions are machine coordinates whatever offsets are set.
The exact stop is `G61.1`: `G61` follows the path exactly but runs through rows that lie
on one line (measured on LinuxCNC 2.9). F is the feed of X, Y, Z where one of them
moves, else that of the rotary axes, in deg/min.
Source: LinuxCNC documentation, G-code reference (G53, G61.1, G94), and its interpreter.
"""

from __future__ import annotations

import re
from typing import ClassVar

from app.motion.nc_programs.dialect import BlockForms, Dialect, ProgramContent
from app.motion.nc_programs.gcode import GCodeReader, Groups, find_name
from app.motion.nc_programs.programmed_motion import ProgrammedMotion

_SAFE_START = ("G21", "G17 G40 G49 G80 G90 G94", "G61.1")
_FORMS = BlockForms(
    motion="N{row.number} G53 G1 {ends} F{row.feed:.3f}",
    dwell=("G4 P{:.3f}",),
    message="(MSG, {})",
)


class LinuxCnc(Dialect):
    """Programs of LinuxCNC, `.ngc`."""

    control = "LinuxCNC"
    suffix = ".ngc"
    frame = "WITHOUT ANY OFFSET IN EACH BLOCK - G53"

    def write(self, content: ProgramContent) -> str:
        """Return the program; its name is that of its file and stands in a comment."""
        lines = [f"({line})" for line in (f"PROGRAM {content.name}", *content.header)]
        return "\n".join([*lines, *_SAFE_START, *_FORMS.write_rows(content), "M2", ""])

    def read(self, text: str) -> ProgrammedMotion:
        """Return the motion of the control."""
        reader = _Reader(text, find_name(text, _NAME))
        for number, line in enumerate(text.splitlines(), 1):
            if not reader.ended:
                reader.read_block(number, _COMMENT.sub(" ", line))
        return reader.finish()


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
    dwell_letter = "P"
    end = "M2"
