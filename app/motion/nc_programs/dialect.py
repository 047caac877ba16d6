"""The interface of a control's program format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from app.motion.nc_programs.program_content import ProgramContent
from app.motion.nc_programs.programmed_motion import ProgrammedMotion


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
