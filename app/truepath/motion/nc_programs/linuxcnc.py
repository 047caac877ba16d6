"""LinuxCNC (RS-274/NGC); its motion rules are in `drivers.interfaces.rs274`."""

from __future__ import annotations

import re
from typing import ClassVar

from truepath.motion.nc_programs.dialect import (
    BlockForms,
    Dialect,
    ProgramContent,
    number_blocks,
)
from truepath.motion.nc_programs.gcode import GCodeReader, Groups, find_name
from truepath.motion.nc_programs.programmed_motion import ProgrammedMotion
from truepath_drivers.interfaces import rs274

_FORMS = BlockForms(
    motion=f"{rs274.MOTION} ({{row.label}})",
    dwell=(rs274.DWELL,),
    message="(MSG, {})",
    number=f".{rs274.DECIMALS}f",
)
_KEEP_MODES, _RESTORE_MODES = "M70", "M72"


class LinuxCnc(Dialect):
    """Programs of LinuxCNC, `.ngc`."""

    control = "LinuxCNC"
    suffix = ".ngc"
    frame = "WITHOUT ANY OFFSET IN EACH BLOCK - G53"

    def write(self, content: ProgramContent) -> str:
        """The program's name is that of its file and in a comment."""
        lines = [f"({line})" for line in (f"PROGRAM {content.name}", *content.header)]
        rows = _FORMS.write_rows(content)
        blocks = [_KEEP_MODES, *rs274.SAFE_START, *rows, _RESTORE_MODES, rs274.END]
        return "\n".join([*lines, *number_blocks(blocks), ""])

    def read(self, text: str) -> ProgrammedMotion:
        """Blocks after the end of the program are ignored."""
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
    passive = ("G1", "G4", _KEEP_MODES, _RESTORE_MODES)
    dwell_letter = "P"
    end = rs274.END
