"""Linear temperature compensation of a SINUMERIK.

Of an axis at position P the control takes

    ΔK = K0(T) + tanβ(T) (P − P0)

with K0 = SD43900, tanβ = SD43910 (the gradient of the line that the error is taken
for) and P0 = SD43920; MD32750 bit 0 switches K0 on, bit 1 tanβ. The control knows no
temperature: its PLC writes SD43900 and SD43910 as the machine warms. Source: SINUMERIK
Function Manual Extended Functions 03/2013, K3, pages 225 to 228. That a positive ΔK
moves the axis in the negative direction, as in leadscrew tables, is assumed.

Tables are those of the stated temperature, where tanβ is therefore 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from truepath.app.compensation.format import (
    AxisTable,
    CompensationTables,
    TemperatureTables,
)
from truepath.app.kinematics.symbols import LINEAR

TEMPERATURE_AREA = "_N_TEMP_COMP_INI"
_STEP_K = 1.0


def write_temperature_file(
    content: CompensationTables, temperature: TemperatureTables
) -> str:
    """Return the settings of each axis that grows, and tanβ by temperature."""
    lines = [f"%{TEMPERATURE_AREA}", *(f"; {line}" for line in content.stamp)]
    lines += [
        "; tables hold at the stated temperature, where SD43910 is 0. The PLC writes",
        "; SD43910 = tanbeta(T) by the thermometer; the sign is to be tried",
        "; SD43900 stays 0: drift of the zero of an axis is not told",
        "CHANDATA(1)",
    ]
    for table in temperature.per_kelvin:
        lines += _write_axis(table, temperature)
    return "\n".join([*lines, "M17", ""])


def find_slope_per_k(table: AxisTable) -> float:
    """Return the gradient of an axis' own error through its reference, per kelvin."""
    off_mm = table.position_mm - table.position_mm[table.reference]
    own = table.mean_mm[:, table.own]
    return float(off_mm @ own / (off_mm @ off_mm))


def _write_axis(table: AxisTable, temperature: TemperatureTables) -> Iterator[str]:
    name = table.axis.name
    if name not in temperature.grows:
        yield f"; {name}: no growth is seen, temperature compensation stays off"
        return
    number = LINEAR.index(name) + 1
    slope = find_slope_per_k(table)
    off_mm = table.position_mm - table.position_mm[table.reference]
    left_mm = table.mean_mm[:, table.own] - slope * off_mm
    rms_um = 1e3 * math.sqrt(float(left_mm @ left_mm) / len(left_mm))
    yield f"; {name}: tanbeta(T) = {slope:.4e} (T - {temperature.at_degc:g} degC)"
    yield (
        f"; {1e6 * slope:.2f} um/m per K; a straight line leaves "
        f"{rms_um:.3f} um per K, root mean square"
    )
    yield f"$MA_TEMP_COMP_TYPE[AX{number}]=2"
    reference_mm = table.position_mm[table.reference]
    yield f"$SA_TEMP_COMP_REF_POSITION[AX{number}]={reference_mm:.6f}"
    yield f"$SA_TEMP_COMP_ABS_VALUE[AX{number}]=0"
    yield f"$SA_TEMP_COMP_SLOPE[AX{number}]=0"
    low, high = temperature.low_degc, temperature.high_degc
    count = max(2, round((high - low) / _STEP_K) + 1)
    for celsius in np.linspace(low, high, count):
        gradient = slope * (celsius - temperature.at_degc)
        yield f";   {celsius:.3f} degC  SD43910 = {gradient:.6e}"
