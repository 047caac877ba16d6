"""The interface of a control's program format, and the order of its blocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import ClassVar

from app.motion.nc_programs.program_content import ProgramContent, ProgramRow
from app.motion.nc_programs.programmed_motion import ProgrammedMotion

CHECK_WAY = "ROW 1 IS APPROACHED STRAIGHT. WAY FREE - CYCLE START"
START_RECORDING = "START THE RECORDING. AFTER 2 S CYCLE START"
STOP_RECORDING = "END. AFTER 2 S STOP THE RECORDING"


class Dialect(ABC):
    """One control: a writer and a reader that share nothing but this class.

    control : its name for people
    suffix : of program files
    decimals : of positions, the finest that every control of this kind takes
    most_rows : as many rows as block numbers can count
    least_dwell_s, longest_dwell_s : of a row; shorter dwells are prolonged
    counts_degrees : the feed is that of linear and rotary axes together, a degree being
        counted as a millimetre; else it is that of the linear axes where one moves
    frame : how the program ensures machine coordinates, for the header
    """

    control: ClassVar[str]
    suffix: ClassVar[str]
    decimals: ClassVar[int] = 4
    most_rows: ClassVar[int] = 99_999
    least_dwell_s: ClassVar[float] = 0.0
    longest_dwell_s: ClassVar[float] = 3600.0
    counts_degrees: ClassVar[bool] = False
    frame: ClassVar[str]

    def program_name(self, wanted: str, checksum: str) -> str:
        """Return a name that the control accepts: the wanted one unless overridden.

        wanted : in letters, digits and underscores, at most 16, a letter first
        checksum : of the path, as `compute_checksum`
        """
        return wanted

    @abstractmethod
    def write(self, content: ProgramContent) -> str:
        """Return the program in ASCII, every line ended by a line feed."""

    @abstractmethod
    def read(self, text: str) -> ProgrammedMotion:
        """Return the motion of the control. Raises PlanningError naming the line.

        A motion that is not in machine coordinates is an error, and so is one that
        depends on a mode that this program did not set.
        """


def arrange_blocks(
    rows: Iterable[ProgramRow],
    *,
    write_stop: Callable[[str], Iterable[str]],
    write_motion: Callable[[ProgramRow], Iterable[str]],
    write_dwell: Callable[[float], Iterable[str]],
) -> Iterator[str]:
    """Yield the blocks of all rows, with the stops at which the operator acts.

    write_stop : the blocks of a program stop with its message
    write_dwell : the blocks of a dwell in s, which may be 0
    """
    yield from write_stop(CHECK_WAY)
    for row in rows:
        if row.target_change:
            yield from write_stop(row.target_change)
        yield from write_motion(row)
        if row.number == 1:
            yield from write_stop(START_RECORDING)
        yield from write_dwell(row.dwell_s)


def format_position(content: ProgramContent, row: ProgramRow, form: str) -> str:
    """Return the axis words of a row; `form` is the format of a number."""
    words = zip(content.axes, row.position, strict=True)
    return " ".join(f"{axis}{value:{form}}" for axis, value in words)
