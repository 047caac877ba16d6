"""Conformity with a tolerance, of one value and of many points (ISO 14253-1).

All points have to be within; one outside decides. So that a point among many does not
fail by chance, the coverage factor is that with which all of them lie within their
uncertainties together in 95 % of cases.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float64

_CONFIDENCE = 0.95


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


@dataclass(frozen=True, slots=True)
class PointConformity:
    """Lengths against a tolerance.

    tolerance_um : upper limit; coverage_factor : of the expanded uncertainties
    worst : point that is farthest outside, or nearest to it
    each : decision of every point alone
    """

    conformity: Conformity
    tolerance_um: float
    coverage_factor: float
    worst: int
    length_um: float
    expanded_um: float
    each: tuple[Conformity, ...]


def compute_joint_factor(count: int, known_by: float) -> float:
    """Factor k such that `count` independent values all lie within k σ, by 95 %.

    known_by : degrees of freedom of σ (Student's distribution, as in GUM G.3)
    """
    # Imported on use: the service process does not load SciPy.
    from scipy.special import stdtrit

    each: float = _CONFIDENCE ** (1.0 / max(count, 1))
    return float(stdtrit(known_by, 0.5 * (1.0 + each)))


def decide_points(
    length_um: Float64[np.ndarray, " n"],
    sigma_um: Float64[np.ndarray, " n"],
    known_by: float,
    tolerance_um: float,
    *,
    sees_all: bool = True,
) -> PointConformity:
    """One decision for all lengths.

    sigma_um : their standard uncertainties; known_by : degrees of freedom of these
    sees_all : whether every direction is measured somewhere, and every axis moved; else
        a point may be outside, but nothing proves that all is within
    """
    factor = compute_joint_factor(len(length_um), known_by)
    half = factor * sigma_um
    each = [
        decide_conformity(length, own, tolerance_um)
        for length, own in zip(length_um.tolist(), half.tolist(), strict=True)
    ]
    conformity = next(
        (one for one in (Conformity.OUTSIDE, Conformity.UNDECIDED) if one in each),
        Conformity.WITHIN,
    )
    if conformity is Conformity.WITHIN and not sees_all:
        conformity = Conformity.UNDECIDED
    is_outside = conformity is Conformity.OUTSIDE
    worst = int(np.argmax(length_um - half if is_outside else length_um + half))
    return PointConformity(
        conformity,
        tolerance_um,
        factor,
        worst,
        float(length_um[worst]),
        float(half[worst]),
        tuple(each),
    )
