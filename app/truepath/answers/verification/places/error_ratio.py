"""How much of a result's map a measurement shows, and what that says of a controller.

As found a machine has the errors of the result, so 1 time; an ideal compensation leaves
0, one of the wrong sign 2. Files that compensate only a part of the errors leave the
rest: their expected residual is stated together with the measured one, and whether they
are active is decided by what they add, not by what remains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from truepath.answers.verification.places.matched_points import MatchedPoints

ScaleCause = Literal["wrong-sign", "not-active", "active"]
Causes = Mapping[float, ScaleCause | None]
_AS_FOUND: Causes = {1.0: None, 0.0: "active", 2.0: "wrong-sign"}
_BY_FILES: Causes = {1.0: None, 0.0: "not-active", -1.0: "wrong-sign"}
_NEARLY = 0.2  # of the expected number, whatever the noise


@dataclass(frozen=True, slots=True)
class MapScale:
    """How much of the result's map the machine still has.

    uncertainty : the standard one; expected : 1 as found, else the residual of the
        files
    cause : why it differs, of the controller's compensation; None where it does not
        differ, or the measurement does not determine it
    """

    value: float
    uncertainty: float
    expected: float
    cause: ScaleCause | None


def find_map_scale(held: MatchedPoints, *, is_compensated: bool) -> MapScale | None:
    """Factor of the map in the measurement; None where the map has no errors.

    is_compensated : the controller is said to correct by files of the result
    """
    value, square = held.fit_scale_factor(held.places.residual_mm, held.as_found_mm)
    if square < 1.0:
        return None
    expected, _ = held.fit_scale_factor(held.predicted_mm, held.as_found_mm)
    sigma = square**-0.5
    if not is_compensated:
        return MapScale(value, sigma, expected, _find_cause(value, sigma, _AS_FOUND))
    return MapScale(value, sigma, expected, _assess_files(held))


def _assess_files(held: MatchedPoints) -> ScaleCause | None:
    added = held.predicted_mm - held.as_found_mm
    share, square = held.fit_scale_factor(
        held.places.residual_mm - held.as_found_mm, added
    )
    if square < 1.0:
        return None
    return _find_cause(share, square**-0.5, _BY_FILES)


def _find_cause(times: float, sigma: float, causes: Causes) -> ScaleCause | None:
    clear = 3.0 * sigma + _NEARLY
    near: list[ScaleCause | None] = [
        cause for number, cause in causes.items() if abs(times - number) < clear
    ]
    return near[0] if len(near) == 1 else None
