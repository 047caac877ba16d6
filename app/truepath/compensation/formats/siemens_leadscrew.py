"""The measuring system of an axis to which a SINUMERIK leadscrew table applies.

`$AA_ENC_COMP[e, N, axis]`, as MD32700 and MD38000 of it, has e = 0 for measuring system
1 and e = 1 for measuring system 2; a table acts while its system is the active one of
the axis. Source: SINUMERIK Function Manual Extended Functions 03/2013, K3, pages 239
and 240.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import ClassVar

from truepath.compensation.format import AxisTable
from truepath.compensation.per_axis_options import split_by_axis
from truepath.compensation.rotary_tables import RotaryTable
from truepath.errors import BadInput

MEASURING_SYSTEMS = ("1", "2")


class MeasuringSystem:
    """The measuring system to which the table of each axis applies.

    word : of `MEASURING_SYSTEMS` for all axes, or by axis as `X=1,Y=2`; system 1 for
        those that it does not name
    """

    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "measuring_system": MEASURING_SYSTEMS
    }
    by_axis: ClassVar[tuple[str, ...]] = ("measuring_system",)

    def __init__(self, word: str) -> None:
        self._by_axis = split_by_axis(word, MEASURING_SYSTEMS)
        self._block_medians = MEASURING_SYSTEMS[0] if self._by_axis else word
        title, index, active = f"system {word}", str(self._find_index("")), "each axis"
        if self._by_axis:
            stated = ", ".join(f"{n} of {axis}" for axis, n in self._by_axis.items())
            title, index = f"system {stated}, {self._block_medians} of others", "e"
            active = "its axis, e being one less than its number"
        self.remark = (
            f"tables of measuring {title}: $AA_ENC_COMP[{index}, ...]; it has to be "
            f"the active one of {active}"
        )
        self.note = (
            f"the tables are of measuring {title} ($AA_ENC_COMP[{index}, ...]), which "
            f"has to be the active one of {active}; MD38000[{index}] must hold the "
            f"points; load with MD32700[{index}] = 0, set it to 1, reference the axes"
        )

    def require_axes(self, names: Collection[str]) -> None:
        """Raises BadInput if a measuring system is given for an unknown axis."""
        for axis in self._by_axis:
            if axis not in names:
                raise BadInput(
                    f"measuring_system: the machine has no axis {axis}; it has "
                    f"{', '.join(names)}"
                )

    def require_known(self, known: Collection[str], control: str) -> None:
        """Raises BadInput if a control has no such measuring system."""
        for number in (self._block_medians, *self._by_axis.values()):
            if number not in known:
                raise BadInput(
                    f"measuring_system: the {control} has {', '.join(known)} alone, "
                    f"not {number}; choose another control or measuring system"
                )

    def _find_index(self, axis: str) -> int:
        return MEASURING_SYSTEMS.index(self._by_axis.get(axis, self._block_medians))

    def write_straight(self, table: AxisTable, *, forward: bool) -> list[str]:
        """Lines of a linear axis.

        forward : the values of positive travel in place of the mean
        """
        values = table.forward_mm if forward else table.mean_mm
        return self._write(
            table.axis.name,
            values[:, table.own].tolist(),
            table.spacing_mm,
            (float(table.position_mm[0]), float(table.position_mm[-1])),
            modulo=False,
        )

    def write_rotary(self, table: RotaryTable) -> list[str]:
        """Lines of a rotary axis, in deg; of a full turn they repeat.

        With IS_MODULO the value at MAX is followed by that at MIN, so both are the
        same. Source: K3, pages 238 to 242.
        """
        return self._write(
            table.axis.name,
            table.error_deg.tolist(),
            table.spacing_deg,
            (float(table.position_deg[0]), float(table.position_deg[-1])),
            modulo=table.axis.turns_fully,
        )

    def _write(
        self,
        axis: str,
        values: list[float],
        step: float,
        ends: tuple[float, float],
        *,
        modulo: bool,
    ) -> list[str]:
        index = self._find_index(axis)
        place = f"[{index},{axis}1]"
        return [
            *(
                f"$AA_ENC_COMP[{index},{row},{axis}1]={value:z.6f}"
                for row, value in enumerate(values)
            ),
            f"$AA_ENC_COMP_STEP{place}={step:.9g}",
            f"$AA_ENC_COMP_MIN{place}={ends[0]:.6f}",
            f"$AA_ENC_COMP_MAX{place}={ends[1]:.6f}",
            f"$AA_ENC_COMP_IS_MODULO{place}={int(modulo)}",
        ]
