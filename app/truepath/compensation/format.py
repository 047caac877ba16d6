"""Interface of a controller's format: its input, its files, its corrections."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.compensation.rotary_tables import (
    RotaryAddition,
    RotaryAxisLocation,
    RotaryTable,
)
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.symbols import LINEAR


@dataclass(frozen=True, slots=True)
class PairTable:
    """Error of an axis in addition to its own table, at positions of another axis.

    by_mm : (m,) positions of the other axis, equidistant over its travel
    error_mm : (m, n, 3) at the axis' own n positions; 0 where either axis is at its
        reference
    """

    by: LinearAxis
    by_mm: Float64[np.ndarray, " m"]
    error_mm: Float64[np.ndarray, "m n 3"]


@dataclass(frozen=True, slots=True)
class AxisTable:
    """The error at the tool point as one axis moves.

    position_mm : (n,) equidistant, ascending, over the whole travel
    reference : index of the row nearest to the reference position, where tables are 0
    forward_mm, backward_mm : (n, 3) δ along the middle of the other axes' travel, less
        its value where the axis reaches the reference in + direction
    translation_mm, rotation_rad : (n, 3) E and ω of the axis, for lever arms that count
        from the zero of the later axes; the target's offset is in E
    pair : with one other axis, where the model has such an effect
    """

    axis: LinearAxis
    position_mm: Float64[np.ndarray, " n"]
    reference: int
    forward_mm: Float64[np.ndarray, "n 3"]
    backward_mm: Float64[np.ndarray, "n 3"]
    translation_mm: Float64[np.ndarray, "n 3"]
    rotation_rad: Float64[np.ndarray, "n 3"]
    pair: PairTable | None = None

    @property
    def mean_mm(self) -> Float64[np.ndarray, "n 3"]:
        """Mean of both directions, 0 at the reference."""
        mean = 0.5 * (self.forward_mm + self.backward_mm)
        return mean - mean[self.reference]

    @property
    def spacing_mm(self) -> float:
        """Distance between neighbouring rows."""
        return float(self.position_mm[1] - self.position_mm[0])

    @property
    def own(self) -> int:
        """Index of the axis' own direction."""
        return LINEAR.index(self.axis.name)


@dataclass(frozen=True, slots=True)
class TemperatureTables:
    """Change of tables with temperature.

    at_degc : for which the tables hold; low_degc, high_degc : range of validity of the
        change
    per_kelvin : of each table, mm/K and rad/K in place of mm and rad
    grows : axes whose positioning depends significantly on temperature
    """

    at_degc: float
    low_degc: float
    high_degc: float
    per_kelvin: tuple[AxisTable, ...]
    grows: frozenset[str]


@dataclass(frozen=True, slots=True)
class CompensationTables:
    """The content of the files of a format.

    stem : of file names; stamp : lines for comments, in plain ASCII
    temperature : where the tables are of a temperature model
    rotary : of the rotary axes, for formats that contain them
    places : locations of the rotary axes
    """

    stem: str
    machine: Machine
    tables: tuple[AxisTable, ...]
    stamp: tuple[str, ...]
    temperature: TemperatureTables | None = None
    rotary: tuple[RotaryTable, ...] = ()
    places: tuple[RotaryAxisLocation, ...] = ()


Correction = Callable[[Float64[np.ndarray, "n a"], float], Float64[np.ndarray, "n 3"]]
"""Correction at commanded positions (mm) in direction 1 or −1, (n, 3) mm."""


class CompensationFormat(ABC):
    """One format: a writer, and a simulator of the controller that reads it.

    control : name for display
    suffix : of its files
    most_points : rows per table that the controller accepts
    resolution_um : of its values
    carries, not_carried : texts for the account
    carries_rotary : whether it has tables of the positioning of rotary axes
    composes_rotary : whether it has all motions and locations of rotary axes, which its
        control composes with the others
    units : of the values and positions in its files
    directions : which directions of travel a value is for
    temperature : how files show a temperature model, in words
    sign : the rule that gives the file its sign
    sign_is_verified : whether that rule is from the maker's manual or source; else one
        deliberate value has to settle it at the machine before first use
    note : what to do with the files
    choices : keywords of the constructor, each with its possible words; the first is
        the default
    by_axis : those that may be given axis by axis, as `X=1,Y=2`
    """

    interface_version: ClassVar[int] = 1
    control: str
    suffix: ClassVar[str]
    most_points: int
    resolution_um: ClassVar[float] = 1e-3
    carries: ClassVar[str]
    not_carried: ClassVar[str]
    carries_rotary: ClassVar[bool] = False
    composes_rotary: ClassVar[bool] = False
    units: ClassVar[str] = "mm"
    directions: str = "mean of both"
    temperature: ClassVar[str] = (
        "nothing: the tables hold at the stated temperature; write them anew for others"
    )
    sign: ClassVar[str]
    sign_is_verified: ClassVar[bool]
    note: str
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    by_axis: ClassVar[tuple[str, ...]] = ()

    def limit_rows(
        self, axes: Sequence[LinearAxis], spacing_mm: float
    ) -> Mapping[str, int]:
        """Upper limit of rows of each axis' table, by axis.

        spacing_mm : requested, where axes share the number of rows
        """
        del spacing_mm
        return {axis.name: self.most_points for axis in axes}

    @abstractmethod
    def write(self, content: CompensationTables) -> dict[str, str]:
        """Files by name, ASCII."""

    @abstractmethod
    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """The controller's correction from the files. Raises BadInput."""

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """Symbols of rotary axis locations that the files contain.

        places : known locations
        """
        del machine, places
        return frozenset()

    def read_rotary(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, RotaryAddition]:
        """Additions to rotary axes, by axis. Raises BadInput."""
        del files, machine
        return {}

    def read_locations(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, float]:
        """Locations of rotary axes in the control by symbol, mm and rad.

        Relative to the nominal location. Raises BadInput.
        """
        del files, machine
        return {}


@dataclass(frozen=True, slots=True)
class InterpolatedTable:
    """Correction at positions of an axis, linear between rows.

    out : index of the axis that is corrected
    forward_mm, backward_mm : (n,) added in + and in − direction of the axis, the same
        in both where one is None; end values hold beyond
    times : factor at positions of another axis
    is_stepped : the value of the nearest row instead of a line
    """

    axis: str
    out: int
    position_mm: Float64[np.ndarray, " n"]
    forward_mm: Float64[np.ndarray, " n"]
    backward_mm: Float64[np.ndarray, " n"] | None = None
    times: InterpolatedTable | None = None
    is_stepped: bool = False

    def multiply(self, times: InterpolatedTable | None, side: int) -> InterpolatedTable:
        """Product with another table; the sign is that of this one.

        side : 1 or −1 for a table of that direction alone, 0 for both
        """
        nothing = np.zeros_like(self.forward_mm)
        if times is not None:
            times = replace(times, forward_mm=-times.forward_mm)
        return replace(
            self,
            forward_mm=nothing if side < 0 else self.forward_mm,
            backward_mm=nothing if side > 0 else self.forward_mm,
            times=times,
        )

    def read(
        self, position: Mapping[str, Float64[np.ndarray, " n"]], direction: float
    ) -> Float64[np.ndarray, " n"]:
        """Correction at positions by axis, in direction 1 or −1."""
        at, value_mm = position[self.axis], self.forward_mm
        if direction <= 0 and self.backward_mm is not None:
            value_mm = self.backward_mm
        if self.is_stepped:
            between = 0.5 * (self.position_mm[1:] + self.position_mm[:-1])
            added = value_mm[np.searchsorted(between, at, side="right")]
        else:
            added = np.interp(at, self.position_mm, value_mm)
        return added if self.times is None else added * self.times.read(position, 1.0)


class TableFormat(CompensationFormat):
    """A format of tables, each of which adds to one axis."""

    @abstractmethod
    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterable[InterpolatedTable]:
        """Tables that the controller adds up. Raises BadInput."""

    def read(self, files: Mapping[str, str], machine: Machine) -> Correction:
        """Sum of the tables."""
        tables = list(self.read_tables(files, machine))

        def correction(
            position_mm: Float64[np.ndarray, "n a"], direction: float
        ) -> Float64[np.ndarray, "n 3"]:
            added = np.zeros((len(position_mm), 3))
            position = dict(zip(machine.axis_names, position_mm.T, strict=True))
            for table in tables:
                added[:, table.out] += table.read(position, direction)
            return added

        return correction
