"""A path as a program of LinuxCNC, and its lines as rows."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from truepath_drivers.interfaces import rs274
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.interfaces.records import Arc, Path

_PREFIX = "truepath-"
_PLANES = {"XY": ("G17", "IJ"), "YZ": ("G19", "JK"), "ZX": ("G18", "KI")}
_MODES = "G21 G90 G94 G61.1 G40 G49 G80"


@dataclass(frozen=True, slots=True)
class ProgramRow:
    """Feed of a row, as its block has it."""

    feed: float


@dataclass(frozen=True, slots=True)
class Program:
    """A program for LinuxCNC.

    lines : numbers in the file, from 1, of the block that moves to each row
    goal : position at its end
    """

    name: str
    text: str
    lines: tuple[int, ...]
    goal: tuple[float, ...]

    def find_row(self, line: int) -> int:
        """Row of the path that a line of the file executes."""
        if not self.lines:
            return 0
        row = int(np.searchsorted(self.lines, line, side="right")) - 1
        return min(max(row, 0), len(self.lines) - 1)


def write_program(path: Path, prologue: Sequence[str]) -> Program:
    """Program of a path; its name contains a hash of its content."""
    blocks = [*rs274.SAFE_START, *prologue]
    lines: list[int] = []
    for row, position in enumerate(path.position):
        stated = ProgramRow(float(path.feed_mm_min[row]))
        arc = path.arc[row] if path.arc else None
        if arc is None:
            block = _write_motion(path.axes, position, stated)
        else:
            block = _write_arc(path, row, arc, stated)
        blocks.append(f"N{row + 1} {block}")
        lines.append(len(blocks))
        if arc is not None:
            blocks.append(rs274.AFTER_ARC)
        if path.dwell_s[row] > 0:
            blocks.append(rs274.DWELL.format(path.dwell_s[row]))
    text = "\n".join([*blocks, rs274.END, ""])
    goal = tuple(float(value) for value in path.position[-1])
    name = f"{_PREFIX}{zlib.crc32(text.encode()):08x}.ngc"
    return Program(name, text, tuple(lines), goal)


def write_move(
    axes: Sequence[str], position: np.ndarray, feed_mm_min: float
) -> Program:
    """The single block of a move for MDI; it has no lines."""
    block = _write_motion(axes, position, ProgramRow(feed_mm_min))
    return Program(
        "", f"{_MODES} {block}", (), tuple(float(value) for value in position)
    )


def _write_motion(axes: Sequence[str], position: np.ndarray, row: ProgramRow) -> str:
    words = zip(axes, position, strict=True)
    ends = " ".join(f"{axis}{value:.{rs274.DECIMALS}f}" for axis, value in words)
    return rs274.MOTION.format(row=row, ends=ends)


def _write_arc(path: Path, row: int, arc: Arc, stated: ProgramRow) -> str:
    columns = [path.axes.index(name) for name in arc.axes]
    begin, end = path.position[row - 1][columns], path.position[row][columns]
    plane, letters = _PLANES[arc.axes]

    def write(names: str, values: np.ndarray) -> str:
        words = zip(names, values, strict=True)
        return " ".join(f"{name}{value:.{rs274.DECIMALS}f}" for name, value in words)

    return rs274.ARC.format(
        row=stated,
        plane=plane,
        verb="G3" if arc.turn_deg > 0.0 else "G2",
        ends=write(arc.axes, end - begin),
        centre=write(letters, np.array(arc.centre_mm) - begin),
        turns=max(int(np.ceil(abs(arc.turn_deg) / 360.0 - 1e-9)), 1),
    )


def store_program(program: Program, folder: FilePath | None) -> None:
    """Write a program as a file and remove those of earlier paths."""
    if folder is None:
        raise Refused(
            "no program_folder is set; name a folder that this computer and LinuxCNC "
            "share"
        )
    file = folder / program.name
    part = file.with_suffix(".part")
    try:
        part.write_text(program.text, encoding="ascii")
        part.replace(file)
        for old in folder.glob(f"{_PREFIX}*.ngc"):
            if old != file:
                old.unlink(missing_ok=True)
    except OSError as error:
        raise Refused(
            f"the program cannot be written to {folder} ({error.strerror}); name a "
            "folder that this computer and LinuxCNC share as program_folder"
        ) from error
