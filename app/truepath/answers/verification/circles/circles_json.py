"""Circles executed on the fly as JSON, and in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from truepath.answers.shown.page import format_expanded
from truepath.answers.verification.circles.circle_figures import (
    SECTOR_DEG,
    list_sector_angles,
)
from truepath.answers.verification.circles.circular_test import (
    CircleInMotion,
    CirclesInMotion,
)

_K = 2.0
_OTHER_FEED = 0.03  # of the commanded one; controls keep it far better


def circles_json(found: CirclesInMotion) -> dict[str, Any]:
    """`circles_in_motion`, and the rows of `circles_missing`."""
    return {
        "circles_in_motion": [_circle_json(one) for one in found.circles],
        "circles_missing": list(found.broken),
    }


def state_circles(found: CirclesInMotion) -> Iterator[str]:
    """One per circle, and one per missing circle."""
    for one in found.circles:
        figures = ", ".join(
            f"{name} {format_expanded(value, one.measured.uncertainty_um[name])}"
            for name, value in one.measured.value_um.items()
            if name in ("H", "G", "F_max", "F_min")
        )
        yield (
            f"Circle in {one.commanded.plane} on the fly, diameter "
            f"{2.0 * one.commanded.radius_mm:g} mm at "
            f"{one.commanded.feed_mm_min:g} mm/min: {figures} µm (k = 2)."
        )
        unlike = [name for name, (_, _, within) in _compare(one).items() if not within]
        if unlike:
            yield (
                f"The result does not predict {', '.join(unlike)} of that circle "
                "within what both state: look for what moves, play and following "
                "errors of the drives, at this feed."
            )
        for sense, driven in one.driven.items():
            share = driven.feed_mm_min / one.commanded.feed_mm_min
            if abs(share - 1.0) > _OTHER_FEED:
                yield (
                    f"That circle was driven {sense} at {driven.feed_mm_min:.0f} "
                    "mm/min: its figures are those of this feed."
                )
    for row in found.broken:
        yield (
            f"The circle to row {row + 1} was not driven whole, without a stop and in "
            "its sense, or not seen all round, as often as it was driven: it tells "
            "nothing. Drive it again."
        )


def _compare(one: CircleInMotion) -> dict[str, tuple[float, float, bool]]:
    compared: dict[str, tuple[float, float, bool]] = {}
    for name, value in one.measured.value_um.items():
        own, stated = one.measured.uncertainty_um, one.predicted_uncertainty_um
        expanded = _K * float(np.hypot(own[name], stated[name]))
        difference = value - one.predicted_um[name]
        compared[name] = difference, expanded, abs(difference) <= expanded
    return compared


def _circle_json(one: CircleInMotion) -> dict[str, Any]:
    return {
        "plane": one.commanded.plane,
        "standard": "iso-230-4",
        "diameter_mm": 2.0 * one.commanded.radius_mm,
        "feed_mm_min": one.commanded.feed_mm_min,
        "driven_feed_mm_min": {s: d.feed_mm_min for s, d in one.driven.items()},
        "row": one.row,
        "samples": {sense: driven.samples for sense, driven in one.driven.items()},
        "sector_deg": SECTOR_DEG,
        "angle_deg": list_sector_angles().tolist(),
        "radial_um": {sense: r.tolist() for sense, r in one.radial_um.items()},
        "predicted_radial_um": {s: r.tolist() for s, r in one.expected_um.items()},
        "centre_um": {
            "measured": one.centre_um.tolist(),
            "predicted": one.expected_centre_um.tolist(),
        },
        "figures_um": one.measured.value_um,
        "uncertainty_um": one.measured.uncertainty_um,
        "by_the_noise_alone_um": one.measured.own_um,
        "predicted_um": one.predicted_um,
        "predicted_uncertainty_um": one.predicted_uncertainty_um,
        "difference_um": {
            name: {"value": value, "expanded_uncertainty": expanded, "within": within}
            for name, (value, expanded, within) in _compare(one).items()
        },
    }
