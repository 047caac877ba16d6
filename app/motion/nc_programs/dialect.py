"""What a control's own way of writing programs has to tell and to do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from app.motion.nc_programs.motion import ProgrammedMotion
from app.motion.nc_programs.order import Order


class Dialect(ABC):
    """One control: a writer and a reader that share nothing but this class.

    control : what people call it
    suffix : of program files
    decimals : of positions, the finest that every control of this kind takes
    most_rows : as many rows as block numbers can count
    least_dwell_s, longest_dwell_s : of a row; shorter dwells are prolonged
    counts_degrees : the feed is that of linear and rotary axes together, a degree being
        counted as a millimetre; else it is that of the linear axes where one moves
    frame : how machine coordinates are made sure of, for the header
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
        checksum : of the path, as `path_checksum`
        """
        return wanted

    @abstractmethod
    def write(self, order: Order) -> str:
        """Return the program in ASCII, every line ended by a line feed."""

    @abstractmethod
    def read(self, text: str) -> ProgrammedMotion:
        """Return what the control would do. Raises PlanningError naming the line.

        A motion that is not in machine coordinates, or for which a mode that it rests
        on was not set in this program, is an error.
        """
