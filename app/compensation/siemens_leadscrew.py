"""Which of the two measuring systems of an axis a SINUMERIK leadscrew table is of.

`$AA_ENC_COMP[e, N, axis]`, as MD32700 and MD38000 of it, has e = 0 for measuring system
1 and e = 1 for measuring system 2; a table acts while its system is the active one of
the axis. Source: SINUMERIK Function Manual Extended Functions 03/2013, K3, pages 239
and 240.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from truepath.app.compensation.format import AxisTable
from truepath.app.compensation.rotary_tables import RotaryTable

MEASURING_SYSTEMS = ("1", "2")


class MeasuringSystem:
    """The measuring system that all tables of an order are of.

    number : of `MEASURING_SYSTEMS`
    index : e of the tables
    """

    choices: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "measuring_system": MEASURING_SYSTEMS
    }

    def __init__(self, number: str) -> None:
        self.number = number
        self.index = MEASURING_SYSTEMS.index(number)
        self.remark = (
            f"tables of measuring system {number}: $AA_ENC_COMP[{self.index}, ...]; it "
            "has to be the active one of each axis"
        )
        self.note = (
            f"the tables are of measuring system {number} ($AA_ENC_COMP[{self.index}, "
            f"...]), which has to be the active one of each axis; MD38000[{self.index}]"
            f" must hold the points; load with MD32700[{self.index}] = 0, set it to 1, "
            "reference the axes"
        )

    def write_straight(self, table: AxisTable, *, forward: bool) -> list[str]:
        """Return the lines of a straight axis.

        forward : the values of positive travel in place of the mean
        """
        values = table.forward_mm if forward else table.mean_mm
        return self._write(
            f"{table.axis.name}1",
            values[:, table.own].tolist(),
            table.spacing_mm,
            (float(table.position_mm[0]), float(table.position_mm[-1])),
            modulo=False,
        )

    def write_rotary(self, table: RotaryTable) -> list[str]:
        """Return the lines of a rotary axis, in deg; turned fully they repeat.

        With IS_MODULO the value at MAX is followed by that at MIN, so both are the
        same. Source: K3, pages 238 to 242.
        """
        return self._write(
            f"{table.axis.name}1",
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
        place = f"[{self.index},{axis}]"
        return [
            *(
                f"$AA_ENC_COMP[{self.index},{row},{axis}]={value:z.6f}"
                for row, value in enumerate(values)
            ),
            f"$AA_ENC_COMP_STEP{place}={step:.9g}",
            f"$AA_ENC_COMP_MIN{place}={ends[0]:.6f}",
            f"$AA_ENC_COMP_MAX{place}={ends[1]:.6f}",
            f"$AA_ENC_COMP_IS_MODULO{place}={int(modulo)}",
        ]
