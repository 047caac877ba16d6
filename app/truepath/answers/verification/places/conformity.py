"""Whether a value with its uncertainty keeps to a tolerance (ISO 14253-1)."""

from __future__ import annotations

from enum import StrEnum


class Conformity(StrEnum):
    """What may be said of a value."""

    WITHIN = "within"
    OUTSIDE = "outside"
    UNDECIDED = "undecided"


def decide_conformity(
    value_um: float, expanded_uncertainty_um: float, tolerance_um: float
) -> Conformity:
    """Decide on a length for all values in its interval.

    Within where the value and its expanded uncertainty keep to the tolerance, outside
    where the value less its uncertainty does not, else undecided (ISO 14253-1:2017).
    """
    if value_um + expanded_uncertainty_um <= tolerance_um:
        return Conformity.WITHIN
    if value_um - expanded_uncertainty_um > tolerance_um:
        return Conformity.OUTSIDE
    return Conformity.UNDECIDED
