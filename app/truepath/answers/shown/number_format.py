"""Numbers as people read them: with their uncertainty, and a true minus sign."""

from __future__ import annotations

import math

SIGN = {
    "um": "µm",
    "hz": "Hz",
    "urad": "µrad",
    "um_per_s": "µm/s",
    "um_per_m_K": "µm/m/K",
    "um_per_m": "µm/m",
}
"""Units of files as people write them, where they are not the same."""


def format_expanded(value: float, standard: float) -> str:
    """`value ± U`, k = 2, with U at two significant digits, three decimals at most."""
    half = 2.0 * standard
    decimals = 1
    if half > 0.0:
        decimals = min(max(1 - math.floor(math.log10(half)), 0), 3)
    return f"{format_number(value, decimals)} ± {format_number(half, decimals)}"


def format_number(value: float, decimals: int = 1) -> str:
    """With a true minus sign, no negative zero."""
    return f"{value:z.{decimals}f}".replace("-", "−")
