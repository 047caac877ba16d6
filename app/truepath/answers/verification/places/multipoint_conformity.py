"""Conformity of many points with one tolerance, by ISO 14253-1.

All of them have to be within; one outside decides. So that a point among many does not
fail by chance, the coverage factor is that with which all of them lie within their
uncertainties together in 95 % of cases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from truepath.answers.verification.places.conformity import (
    Conformity,
    decide_conformity,
)

CONFIDENCE = 0.95


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
    each: float = CONFIDENCE ** (1.0 / max(count, 1))
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
