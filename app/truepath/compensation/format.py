"""Interface of a controller's format: its input, its files, its corrections.

Here too: rotary axes in a format, and choices that differ from axis to axis (`2`, or
`X=1,Y=2`).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from truepath.errors import BadInput
from truepath.kinematics.machine.machine import (
    LinearAxis,
    Machine,
    RotaryAxis,
    compute_local_directions,
)
from truepath.kinematics.machine.symbols import LINEAR, TURNS

_PART = re.compile(rf"([{''.join(LINEAR + TURNS)}])=([^,=]+)")


@dataclass(frozen=True, slots=True)
class RotaryTable:
    """Rotation of a rotary axis beyond its command.

    position_deg : (n,) equidistant, ascending, over the travel; over one turn where the
        axis turns fully, the last row being the first again
    error_deg : (n,) mean of both directions, 0 at the axis zero, else the lowest
    half_deg : (n,) half their difference: more of the error in + direction
    motions : (n, 6) E and ω in the directions of the axis, mm and rad, of the tool
        relative to the workpiece
    """

    axis: RotaryAxis
    position_deg: Float64[np.ndarray, " n"]
    error_deg: Float64[np.ndarray, " n"]
    motions: Float64[np.ndarray, "n 6"]
    half_deg: Float64[np.ndarray, " n"]

    @property
    def spacing_deg(self) -> float:
        """Distance between neighbouring rows."""
        return float(self.position_deg[1] - self.position_deg[0])


@dataclass(frozen=True, slots=True)
class RotaryAddition:
    """Addition of a controller to a rotary axis, linear between rows.

    added_deg : mean of both directions; half_deg : half their difference, where the
        file has both
    period_deg : after which it repeats; 0 where end values hold beyond
    """

    position_deg: Float64[np.ndarray, " n"]
    added_deg: Float64[np.ndarray, " n"]
    period_deg: float = 0.0
    half_deg: Float64[np.ndarray, " n"] | None = None

    def read(
        self, at_deg: Float64[np.ndarray, " n"], direction: float = 0.0
    ) -> Float64[np.ndarray, " n"]:
        """Addition at commanded positions, deg.

        direction : 1 or −1, in which the axis arrives; 0 for the mean of both
        """
        if self.period_deg:
            first = self.position_deg[0]
            at_deg = first + np.mod(at_deg - first, self.period_deg)
        added_deg = self.added_deg
        if self.half_deg is not None:
            added_deg = added_deg + direction * self.half_deg
        return np.interp(at_deg, self.position_deg, added_deg)


@dataclass(frozen=True, slots=True)
class RotaryAxisLocation:
    """Location of the axis of a rotary axis.

    location : its location errors by symbol, mm and rad, as far as the result has them
    untold : symbols that the measurement does not distinguish from other errors
    """

    axis: RotaryAxis
    location: Mapping[str, float]
    untold: frozenset[str] = frozenset()

    @property
    def known(self) -> frozenset[str]:
        """Symbols that the measurement determines."""
        return frozenset(self.location) - self.untold

    @property
    def origin_mm(self) -> Float64[np.ndarray, "3"]:
        """Nominal point on the axis, shifted by the location error."""
        return np.array(self.axis.origin_mm) + self._turn(LINEAR)

    @property
    def direction(self) -> Float64[np.ndarray, "3"]:
        """Nominal direction, tilted by the location error; a unit vector."""
        nominal = np.array(self.axis.direction)
        tilted = nominal + np.cross(self._turn(TURNS), nominal)
        return tilted / np.linalg.norm(tilted)

    def _turn(self, letters: tuple[str, ...]) -> Float64[np.ndarray, "3"]:
        own = [self.location.get(f"{one}O{self.axis.name}", 0.0) for one in letters]
        return compute_local_directions(self.axis) @ np.array(own)


def list_stated_locations(places: Iterable[RotaryAxisLocation]) -> frozenset[str]:
    """Symbols of all locations that a result has."""
    return frozenset(symbol for place in places for symbol in place.location)


def split_by_axis(word: str, known: Sequence[str]) -> dict[str, str]:
    """Words of a choice by axis; empty for a choice of one word for all axes.

    known : possible words for an axis

    Raises BadInput for another form, an axis twice, or an unknown word.
    """
    if "=" not in word:
        return {}
    chosen: dict[str, str] = {}
    for part in word.split(","):
        found = _PART.fullmatch(part)
        if found is None or found.group(1) in chosen or found.group(2) not in known:
            raise BadInput(
                f"{word!r}: {part!r} is no choice of one axis more; write each axis "
                f"once, with one of {', '.join(known)}, as X={known[0]},Y={known[-1]}"
            )
        chosen[found.group(1)] = found.group(2)
    return chosen


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


Files = Mapping[str, str]
"""Texts by file name."""

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
    def read(self, files: Files, machine: Machine) -> Correction:
        """The controller's correction from the files. Raises BadInput."""

    def list_written_locations(
        self, machine: Machine, places: Sequence[RotaryAxisLocation]
    ) -> frozenset[str]:
        """Symbols of rotary axis locations that the files contain.

        places : known locations
        """
        del machine, places
        return frozenset()

    def read_rotary(self, files: Files, machine: Machine) -> dict[str, RotaryAddition]:
        """Additions to rotary axes, by axis. Raises BadInput."""
        del files, machine
        return {}

    def read_locations(self, files: Files, machine: Machine) -> dict[str, float]:
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
        self, files: Files, machine: Machine
    ) -> Iterable[InterpolatedTable]:
        """Tables that the controller adds up. Raises BadInput."""

    def read(self, files: Files, machine: Machine) -> Correction:
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
