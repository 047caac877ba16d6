"""Temperature at which lengths in files hold: that of the machine, not 20 °C.

Lengths are stated at 20 °C (ISO 1). A calibration measures the machine at its own
temperature, in lengths of the tracker, without correction for the growth of its scales.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

REFERENCE_DEGC = 20.0
STEEL_UM_PER_M_K = 11.5
_SCALES = ("X", "Y", "Z")  # sensors of the scales, where there are any


def find_measured_degc(provenance: Mapping[str, Any]) -> tuple[float, float] | None:
    """Lowest and highest temperature of a measurement; None if unknown.

    Of the axis scales where they have sensors, else of all sensors.
    """
    stated: Mapping[str, Sequence[float]] = provenance.get("temperature_degC") or {}
    scales = [ends for name, ends in stated.items() if name in _SCALES]
    ends = scales or list(stated.values())
    if not ends:
        return None
    return min(low for low, _ in ends), max(high for _, high in ends)


def describe_lengths(measured_degc: tuple[float, float] | None) -> str:
    """Text in plain ASCII."""
    at = "an unknown temperature"
    if measured_degc is not None:
        at = " to ".join(dict.fromkeys(f"{end:.1f}" for end in measured_degc)) + " degC"
    return (
        f"lengths at the machine's own temperature, {at}, not normalised to "
        f"{REFERENCE_DEGC:g} degC: for steel {STEEL_UM_PER_M_K:g} um/m per K"
    )


def warn_of_lengths(measured_degc: tuple[float, float] | None) -> str | None:
    """Why lengths may be off at 20 °C; None within 1 K of it."""
    if measured_degc is None:
        return (
            "the temperature of the measurement is not known: lengths hold at it, and "
            f"are off at {REFERENCE_DEGC:g} °C by {STEEL_UM_PER_M_K:g} µm/m for each "
            "kelvin between (steel)"
        )
    off_k = max(measured_degc, key=lambda end: abs(end - REFERENCE_DEGC))
    off_k -= REFERENCE_DEGC
    if abs(off_k) <= 1.0:  # off the reference temperature without a warning
        return None
    return (
        f"measured {off_k:+.1f} K off {REFERENCE_DEGC:g} °C: lengths hold at the "
        "machine's own temperature and are not normalised, which for steel is "
        f"{abs(off_k) * STEEL_UM_PER_M_K:.0f} µm/m"
    )


def state_lengths(measured_degc: tuple[float, float] | None) -> dict[str, Any]:
    """The account's part about lengths."""
    return {
        "measured_degC": measured_degc and list(measured_degc),
        "reference_degC": REFERENCE_DEGC,
        "normalised": False,
        "text": describe_lengths(measured_degc),
        "warning": warn_of_lengths(measured_degc),
    }
