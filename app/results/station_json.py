"""What a plan says of the tracker's place and of further stations, and in sentences."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64

from truepath.app.files.units import UM_PER_MM
from truepath.app.kinematics.symbols import describe_symbol
from truepath.app.planning.station_choice import StationAdvice, StationOption
from truepath.app.planning.station_information import StationVariance

_ORDINAL = {2: "second", 3: "third"}


def stations_json(advice: StationAdvice) -> dict[str, Any]:
    """Return the advice; uncertainties are standard ones (k = 1)."""
    return {
        "recommended": len(advice.recommended.place_mm),
        "statement": in_words(advice),
        "move_minutes": advice.move_s / 60.0,
        "judged": advice.judged,
        "best": {"position_mm": _round(advice.best_mm), **_state(advice.best)},
        "worst": _state(advice.worst),
        "options": [_option_json(option) for option in advice.options],
    }


def in_words(advice: StationAdvice) -> list[str]:
    """Return what a person needs to know before the tracker is set up."""
    first, *further = advice.options
    said = [
        f"from {_place(first.place_mm[0])} {_um(first.left)} stay, "
        f"{UM_PER_MM * first.left.systematic_mm:.2f} of them by the tracker's own "
        f"errors; of {advice.judged} places the worst leaves {_um(advice.worst)}"
    ]
    if first.left.seen < 1.0:
        said.append(f"{first.left.seen:.0%} of the travel are in range and in sight")
    if not advice.chosen and advice.best.sigma_mm < 0.95 * first.left.sigma_mm:
        said.append(f"{_place(advice.best_mm)} would leave {_um(advice.best)}")
    said += [_compare(option) for option in further]
    count = len(advice.recommended.place_mm)
    said.append(f"{count} stations pay" if count > 1 else "one station is enough")
    return said


def _compare(option: StationOption) -> str:
    count = len(option.place_mm)
    places = " and ".join(_place(place) for place in option.place_mm[1:])
    said = (
        f"with a {_ORDINAL[count]} station ({places}) {_um(option.left)} after "
        f"{option.total_s / 60.0:.0f} min in all; staying as long leaves "
        f"{_um(option.stay)}"
    )
    if not option.pays:
        return f"{said}: it does not pay"
    return f"{said}: it pays, because {_give_reason(option)}"


def _give_reason(option: StationOption) -> str:
    if option.reason == "sight":
        return (
            f"one place sees {option.stay.seen:.0%} of the travel, these "
            f"{option.left.seen:.0%}"
        )
    if option.reason == "systematic":
        return "the tracker's own errors, which no time averages, differ by the place"
    return f"one place leaves {option.reason} ({describe_symbol(option.reason)}) weak"


def _option_json(option: StationOption) -> dict[str, Any]:
    return {
        "count": len(option.place_mm),
        "position_mm": [_round(place) for place in option.place_mm],
        "minutes": option.total_s / 60.0,
        **_state(option.left),
        "one_place_as_long": _state(option.stay),
        "pays": option.pays,
        "because": option.reason if option.pays else None,
    }


def _state(left: StationVariance) -> dict[str, float]:
    return {
        "volumetric_uncertainty_um": UM_PER_MM * left.sigma_mm,
        "random_um": UM_PER_MM * left.random_mm,
        "systematic_um": UM_PER_MM * left.systematic_mm,
        "seen": left.seen,
    }


def _um(left: StationVariance) -> str:
    return f"{UM_PER_MM * left.sigma_mm:.2f} µm"


def _place(place_mm: Float64[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{v:.0f}' for v in place_mm.tolist())}) mm"


def _round(place_mm: Float64[np.ndarray, "3"]) -> list[float]:
    return [round(v, 3) for v in place_mm.tolist()]
