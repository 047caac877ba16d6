"""The temperature at which lengths of a certificate hold, in its language."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from truepath.answers.certificate.language import Language
from truepath.compensation.tables.reference_temperature import (
    REFERENCE_DEGC,
    STEEL_UM_PER_M_K,
    find_measured_degc,
)


def describe_lengths(
    measured_degc: tuple[float, float] | None, language: Language
) -> str:
    """Sentence that lengths are not normalised to 20 °C; °C as (low, high)."""
    at = language.say("lengths_unknown")
    if measured_degc is not None:
        ends = dict.fromkeys(language.number(end, 1) for end in measured_degc)
        at = f"{' … '.join(ends)} °C"
    return language.say(
        "lengths_are",
        at=at,
        reference=f"{REFERENCE_DEGC:g}",
        steel=language.number(STEEL_UM_PER_M_K, 1),
    )


def describe_measured_lengths(provenance: Mapping[str, Any], language: Language) -> str:
    """The same, with the temperature from the provenance of a result."""
    return describe_lengths(find_measured_degc(provenance), language)
