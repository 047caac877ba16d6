"""The grade of a set-up as JSON, and in a sentence: for files, REST and people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from truepath.files.units import UM_PER_MM
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.motion.configurations import Commanded
from truepath.planning.grade import GOOD, USABLE, Grade, grade

_MEANS = {
    "good": "the map will be known to a quarter of what one tracker sample scatters "
    "or better",
    "usable": "the map will be worth more than measuring its every point once",
    "poor": "the map would rest on what is usual of machines more than on data",
}


def grade_set_up(
    machine: Machine,
    commanded: Commanded,
    *,
    tracker_mm: Sequence[float] | None = None,
    perpendicular_only: bool = False,
) -> dict[str, Any]:
    """Grade of a set-up as JSON.

    tracker_mm : station of the tracker, in the frame that it stands on; if None the
        worst of four typical stations counts
    """
    stand = None if tracker_mm is None else np.array(tracker_mm, np.float64)
    return grade_json(
        grade(
            machine, commanded, station_mm=stand, perpendicular_only=perpendicular_only
        )
    )


def grade_json(found: Grade) -> dict[str, Any]:
    """Uncertainties are standard ones (k = 1)."""
    return {
        "number": found.number,
        "verdict": found.verdict,
        "thresholds": {"good": GOOD, "usable": USABLE},
        "text": format_text(found),
        "expected_uncertainty_um": UM_PER_MM * found.sigma_mm,
        "sample_sigma_um": UM_PER_MM * found.sample_sigma_mm,
        "tracker": {
            "position_mm": found.station_mm.tolist(),
            "assumed": found.assumed,
            "best_number": found.best,
        },
        "improved_number": found.improved,
        "weakest": [
            {
                "error": motion.symbol,
                "meaning": describe_symbol(motion.symbol),
                "at_tool_um": UM_PER_MM * motion.at_tool_mm,
                "remedy": motion.remedy and f"add {motion.remedy.text}",
            }
            for motion in found.weakest
        ],
        "weak_shapes": [str(shape) for shape in found.shapes],
        "unobservable": list(found.unobservable),
    }


def format_text(found: Grade) -> str:
    """Sentences for the operator before the machine moves."""
    said = (
        f"{found.number:.2f}, {found.verdict}: {_MEANS[found.verdict]}; expected are "
        f"{2 * UM_PER_MM * found.sigma_mm:.1f} µm (k = 2)"
    )
    if found.assumed:
        said += ", with the tracker at the worst of four usual places"
    weakest = found.weakest[0]
    if weakest.remedy is None or found.improved is None:
        return f"{said}. No error motion is weak."
    others = ", ".join(m.symbol for m in found.weakest[1:])
    return (
        f"{said}. {weakest.symbol} ({describe_symbol(weakest.symbol)}) is weak"
        f"{f', then {others}' if others else ''}: add {weakest.remedy.text}, "
        f"which makes it {found.improved:.2f}."
    )
