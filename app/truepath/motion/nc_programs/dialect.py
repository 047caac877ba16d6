"""The interface of a control's program format: its content, the order of its blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import ClassVar

from truepath.motion.nc_programs.programmed_motion import ProgrammedMotion

_CHECK_WAY = "THE AXES GO TO ROW 1 ONE BY ONE. WAY FREE - CYCLE START"
_START_RECORDING = "START THE RECORDING. AFTER 2 S CYCLE START"
_STOP_RECORDING = "END. AFTER 2 S STOP THE RECORDING"


PLANES = {"XY": "G17", "ZX": "G18", "YZ": "G19"}
"""Planes of arcs, and their codes where a control has G-code."""
CENTRES = {"X": "I", "Y": "J", "Z": "K"}
"""Letters of the centre of an arc, from its begin, in G-code."""


@dataclass(frozen=True, slots=True)
class ProgramArc:
    """A circular motion to a row, in whole turns and a rest.

    axes : of its plane, XY, YZ or ZX
    begin : of both axes; centre : from there; rounded as printed
    turns : before the rest, which is a whole turn at most
    is_positive : from the first axis towards the second, G3
    """

    axes: str
    begin: tuple[float, float]
    centre: tuple[float, float]
    turns: int
    is_positive: bool

    @property
    def code(self) -> str:
        return "G3" if self.is_positive else "G2"


@dataclass(frozen=True, slots=True)
class ProgramRow:
    """One motion: to a row of the path, or on the way to the first.

    number : of the row, from 1; 0 on the way to the first
    axes, position : in the block, rounded as printed, mm and deg
    rotary_only : only rotary axes move
    feed : of the linear axes, mm/min; of the rotary axes, deg/min, where only they move
    path_feed : of all axes together, a degree counted as a millimetre
    target_change : action of the operator before the motion, empty for nothing
    arc : of the motion; None on a straight line
    """

    number: int
    axes: tuple[str, ...]
    position: tuple[float, ...]
    rotary_only: bool
    feed: float
    path_feed: float
    dwell_s: float
    target_change: str = ""
    arc: ProgramArc | None = None

    @property
    def label(self) -> str:
        """Comment of the block."""
        return f"ROW {self.number}" if self.number else "APPROACH"


@dataclass(frozen=True, slots=True)
class ProgramContent:
    """A whole program.

    header : in ASCII capitals
    approach : motions of single axes, in order, which end at the first row
    """

    name: str
    axes: tuple[str, ...]
    linear: tuple[str, ...]
    rotary: tuple[str, ...]
    header: tuple[str, ...]
    approach: tuple[ProgramRow, ...]
    rows: tuple[ProgramRow, ...]


class Dialect(ABC):
    """One control: a writer and a reader that share nothing but this class.

    control : its name for people
    suffix : of program files
    decimals : of positions, the finest that every control of this kind takes
    most_rows : as many rows as block numbers can count, three blocks each
    least_dwell_s, longest_dwell_s : of a row; shorter dwells are prolonged
    counts_degrees : the feed is that of linear and rotary axes together, a degree being
        counted as a millimetre; else it is that of the linear axes where one moves
    frame : how the program ensures machine coordinates, for the header
    drives_arcs : paths with arcs have a program
    """

    interface_version: ClassVar[int] = 1
    control: ClassVar[str]
    suffix: ClassVar[str]
    decimals: ClassVar[int] = 4
    most_rows: ClassVar[int] = 33_000
    least_dwell_s: ClassVar[float] = 0.0
    longest_dwell_s: ClassVar[float] = 3600.0
    counts_degrees: ClassVar[bool] = False
    frame: ClassVar[str]
    drives_arcs: ClassVar[bool] = False

    def program_name(self, wanted: str, checksum: str) -> str:
        """A name that the control accepts: the wanted one unless overridden.

        wanted : in letters, digits and underscores, at most 16, a letter first
        checksum : of the path, as `compute_checksum`
        """
        return wanted

    @abstractmethod
    def write(self, content: ProgramContent) -> str:
        """The program in ASCII, every line ended by a line feed."""

    @abstractmethod
    def read(self, text: str) -> ProgrammedMotion:
        """The motion of the control. Raises PlanningError naming the line.

        A motion that is not in machine coordinates is an error, and so is one that
        depends on a mode that this program did not set.
        """


def _write_nothing(_row: ProgramRow) -> Iterable[str]:
    return ()


def write_words(
    names: Iterable[str], values: Iterable[float], form: str, begin: str = ""
) -> str:
    """Words of a block; form : of each number, begin : of each word."""
    words = zip(names, values, strict=True)
    return " ".join(f"{begin}{name}{value:{form}}" for name, value in words)


@dataclass(frozen=True, slots=True)
class BlockForms:
    """The blocks of a control, as formats, and their order.

    motion : of a `row` to its `ends`; number : of a position in them
    dwell : blocks of a dwell in s
    message : to the operator; stop : until the operator continues
    """

    motion: str
    dwell: tuple[str, ...]
    message: str
    stop: str = "M0"
    number: str = ".4f"

    def write_rows(
        self,
        content: ProgramContent,
        write_before: Callable[[ProgramRow], Iterable[str]] = _write_nothing,
        write_arc: Callable[[ProgramRow, ProgramArc], Iterable[str]] | None = None,
    ) -> Iterator[str]:
        """Blocks of all rows, with the stops at which the operator acts.

        write_before : blocks before the motion of a row
        write_arc : blocks of a motion on an arc, where the dialect drives some
        """
        yield from self._write_stop(_CHECK_WAY)
        for row in (*content.approach, *content.rows):
            if row.target_change:
                yield from self._write_stop(row.target_change)
            yield from write_before(row)
            if row.arc and write_arc:
                yield from write_arc(row, row.arc)
            else:
                ends = write_words(row.axes, row.position, self.number)
                yield self.motion.format(row=row, ends=ends)
            if row.number == 1:
                yield from self._write_stop(_START_RECORDING)
            if row.dwell_s > 0:
                yield from (form.format(row.dwell_s) for form in self.dwell)
        yield from self._write_stop(_STOP_RECORDING)

    def _write_stop(self, message: str) -> tuple[str, str]:
        return self.message.format(message), self.stop


def number_blocks(blocks: Iterable[str]) -> Iterator[str]:
    """G-code block numbers, from 1."""
    return (f"N{number} {block}" for number, block in enumerate(blocks, 1))
