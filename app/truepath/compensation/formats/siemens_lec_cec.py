"""Siemens SINUMERIK: leadscrew tables (LEC) and cross tables (CEC).

`$AA_ENC_COMP` holds a table per axis; a positive value moves the axis in the negative
direction, so that the file has the error itself. `$AN_CEC` corrects one axis by the
position of another, or by a product of two tables; its sign is assumed to be the same
and has to be tried at the machine. Both interpolate linearly, hold their end values
beyond the table, and are equidistant. Source: SINUMERIK Function Manual Extended
Functions 03/2013, K3, pages 238 to 264.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import ClassVar

from truepath.compensation.format import (
    CompensationTables,
    InterpolatedTable,
    TableFormat,
)
from truepath.compensation.formats.siemens_controls import CONTROLS, DEFAULT_CONTROL
from truepath.compensation.formats.siemens_cross import (
    FACTOR_MM,
    CrossTable,
    choose_cross_tables,
    find_factor,
    list_factors,
)
from truepath.compensation.formats.siemens_leadscrew import (
    MEASURING_SYSTEMS,
    MeasuringSystem,
)
from truepath.compensation.formats.siemens_parser import (
    read_rotary_tables,
    read_tables,
)
from truepath.compensation.rotary_tables import (
    RotaryAddition,
)
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import LINEAR

_CONTROLS = tuple(CONTROLS)
_USUAL_SYSTEM = MEASURING_SYSTEMS[0]


class Siemens(TableFormat):
    """One INI file of tables that hold the error.

    area : that the file loads; variable : of the control, a table or a setting of it
    control : key of its limits
    remarks : comments of the file in addition to its stamp
    """

    suffix = ".ini"
    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {"control": _CONTROLS}
    area: ClassVar[str]
    variable: ClassVar[str]
    remarks: tuple[str, ...] = ()

    def __init__(self, control: str = DEFAULT_CONTROL) -> None:
        self.room = CONTROLS[control]

    @abstractmethod
    def write_tables(self, content: CompensationTables) -> Iterable[str]:
        """Lines of all tables."""

    def write(self, content: CompensationTables) -> dict[str, str]:
        """One file for all axes."""
        comments = (*content.stamp, *self.remarks)
        lines = [f"%_N_{self.area}_INI", *(f"; {s}" for s in comments)]
        lines += ["CHANDATA(1)", *self.write_tables(content), "M17", ""]
        return {f"{content.stem}{self.suffix}": "\n".join(lines)}

    def read_tables(
        self, files: Mapping[str, str], machine: Machine
    ) -> Iterator[InterpolatedTable]:
        """Negative of the tables."""
        return read_tables(files, self.variable)


class SiemensLec(Siemens):
    """Positioning of each axis, in tables of one of its measuring systems.

    forward : axes whose tables are those of positive travel; else the mean
    """

    area, variable = "AX_EEC", "ENC_COMP"
    carries = (
        "positioning of each axis, mean of both directions, of rotary axes modulo "
        "a turn"
    )
    not_carried = (
        "backlash (MD32450 has it), straightness, angular errors, squareness, "
        "lost motion across or about an axis"
    )
    carries_rotary = True
    units = "mm, of rotary axes deg"
    sign = (
        "the value is the error: a positive value moves the axis in the negative "
        "direction"
    )
    sign_is_verified = True

    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Siemens.choices,
        **MeasuringSystem.choices,
    }
    by_axis = MeasuringSystem.by_axis

    def __init__(
        self,
        control: str = DEFAULT_CONTROL,
        measuring_system: str = _USUAL_SYSTEM,
        forward: Collection[str] = (),
    ) -> None:
        super().__init__(control)
        self._system = MeasuringSystem(measuring_system)
        self._system.require_known(self.room.measuring_systems, self.room.title)
        self._forward = forward
        self.remarks = (self._system.remark,)
        self.most_points = self.room.leadscrew_points
        self.control = f"Siemens {self.room.title}, leadscrew error compensation"
        self.note = (
            f"rename X1, Y1, Z1 to the machine axes; {self._system.note} "
            f"({self.room.note})"
        )

    def write_tables(self, content: CompensationTables) -> Iterator[str]:
        """A table per axis. Raises BadInput for a measuring system of no axis."""
        self._system.require_axes(content.machine.axis_names)
        for table in content.tables:
            forward = table.axis.name in self._forward
            yield from self._system.write_straight(table, forward=forward)
        for table in content.rotary:
            yield from self._system.write_rotary(table)

    def read_rotary(
        self, files: Mapping[str, str], machine: Machine
    ) -> dict[str, RotaryAddition]:
        """Negative of the tables of rotary axes."""
        return read_rotary_tables(files)


class SiemensCec(Siemens):
    """Cross tables: errors of an axis across itself, and together with another one.

    backlash : whether lost motion is included; the leadscrew tables are then those of
        positive travel
    """

    area, variable = "NC_CEC", "CEC"
    carries = (
        "straightness and squareness along the middle of the travel; as products of "
        "two tables what the angular errors of an axis do at the positions of another, "
        "and sag"
    )
    not_carried = (
        "positioning (siemens-lec has it); lost motion across or about an axis; what "
        "is beyond the tables of the control"
    )
    sign = "the value is the error of the output axis, as in leadscrew tables"
    sign_is_verified = False

    def __init__(
        self, control: str = DEFAULT_CONTROL, *, backlash: bool = False
    ) -> None:
        super().__init__(control)
        self._backlash = backlash
        self.most_points = self.room.cross_points
        self.control = f"Siemens {self.room.title}, cross error compensation"
        self.note = (
            "AX1, AX2, AX3 are X, Y, Z; MD32710 enables the tables, SD41300 each of "
            "them; a licensed option; verify by a probe move that they act at all. A "
            "table with MULT_BY_TABLE is taken to act by the product alone, as in the "
            "manual's foundation that sags, and the table that it names by nothing "
            f"else: values of that are {FACTOR_MM} mm at most, should the control add "
            f"it by itself ({self.room.note})"
        )

    def choose(self, content: CompensationTables) -> list[CrossTable]:
        """The tables with the largest corrections, as many as the control has."""
        return choose_cross_tables(
            content.machine,
            content.tables,
            self.room.cross_tables,
            backlash=self._backlash,
        )

    def write_tables(self, content: CompensationTables) -> Iterator[str]:
        """The chosen tables, then the second ones of their products."""
        chosen = self.choose(content)
        factors = list_factors(chosen)
        for number, one in enumerate(chosen):
            times = 0
            if one.factor:  # named by its number, which is its index + 1
                times = len(chosen) + find_factor(one, factors) + 1
            yield from _write_cross(number, one, times)
        for k, (out, factor) in enumerate(factors):
            one = CrossTable(factor.axis, out, factor.position_mm, factor.value_mm, 0.0)
            yield from _write_cross(len(chosen) + k, one, 0)


def _write_cross(number: int, one: CrossTable, times: int) -> Iterator[str]:
    for index, value in enumerate(one.value_mm):
        yield f"$AN_CEC[{number},{index}]={value:z.6f}"
    at = one.position_mm
    yield f"$AN_CEC_INPUT_AXIS[{number}]=(AX{LINEAR.index(one.axis) + 1})"
    yield f"$AN_CEC_OUTPUT_AXIS[{number}]=(AX{one.out + 1})"
    yield f"$AN_CEC_STEP[{number}]={at[1] - at[0]:.9g}"
    yield f"$AN_CEC_MIN[{number}]={at[0]:.6f}"
    yield f"$AN_CEC_MAX[{number}]={at[-1]:.6f}"
    yield f"$AN_CEC_DIRECTION[{number}]={one.direction}"
    yield f"$AN_CEC_MULT_BY_TABLE[{number}]={times}"
    yield f"$AN_CEC_IS_MODULO[{number}]=0"
