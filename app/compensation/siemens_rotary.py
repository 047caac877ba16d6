"""SINUMERIK leadscrew tables of rotary axes, in deg.

With IS_MODULO the table repeats: the value at MAX is followed by that at MIN, so both
are the same. Source: Function Manual Extended Functions 03/2013, K3, pages 238 to 242.
"""

from __future__ import annotations

from collections.abc import Iterator

from truepath.app.compensation.rotary_tables import (
    RotaryTable,
)


def write_turns(table: RotaryTable) -> Iterator[str]:
    """Yield the lines of a table; it repeats where the axis turns fully."""
    axis = f"{table.axis.name}1"
    for index, value in enumerate(table.error_deg):
        yield f"$AA_ENC_COMP[0,{index},{axis}]={value:z.6f}"
    yield f"$AA_ENC_COMP_STEP[0,{axis}]={table.spacing_deg:.9g}"
    yield f"$AA_ENC_COMP_MIN[0,{axis}]={table.position_deg[0]:.6f}"
    yield f"$AA_ENC_COMP_MAX[0,{axis}]={table.position_deg[-1]:.6f}"
    yield f"$AA_ENC_COMP_IS_MODULO[0,{axis}]={int(table.axis.turns_fully)}"
