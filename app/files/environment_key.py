"""The key `environment` of a bundle's machine.json: what environment.csv cannot say.

"environment": {"missing": {"Y_degC": "no reading …"}, "refraction": {"by": …}}
"""

from __future__ import annotations

from typing import Any

from truepath.app.errors import BundleError
from truepath.app.files.environment import find_missing, state_facts
from truepath.app.files.refraction import (
    Refraction,
    refraction_from_json,
    refraction_to_json,
)
from truepath.app.files.run import IMPLAUSIBLE, SENSOR_KINDS, Run, RunEvent

KEY, _SILENT = "environment", "sensor-silent"
_TOLD, _LEFT_OUT = "told", "left_out"


def describe_environment(run: Run) -> dict[str, Any]:
    """Return the key with its content; nothing where there is nothing to say."""
    time_s = run.tracker.device_time_s
    content: dict[str, Any] = {}
    if len(time_s):
        span = float(time_s[0]), float(time_s[-1])
        missing = find_missing(state_facts(run.temperature, run.air, *span))
        content |= {"missing": missing} if missing else {}
    told = [event.text for event in run.events if event.kind in SENSOR_KINDS]
    content |= {_TOLD: list(dict.fromkeys(told))} if told else {}
    wrong = [event.text for event in run.events if event.kind == IMPLAUSIBLE]
    content |= {_LEFT_OUT: list(dict.fromkeys(wrong))} if wrong else {}
    if run.refraction != Refraction():
        content["refraction"] = refraction_to_json(run.refraction)
    return {KEY: content} if content else {}


def read_environment(content: Any) -> tuple[Refraction, tuple[RunEvent, ...]]:
    """Return who has corrected the ranges, and what sensors were missing.

    content : of machine.json. Raises BundleError.
    """
    stated = content.get(KEY) if isinstance(content, dict) else None
    if stated is None:
        return Refraction(), ()
    try:
        refraction = refraction_from_json(stated.get("refraction"))
        missing = [f"{name}: {why}" for name, why in stated.get("missing", {}).items()]
        wrong = [str(text) for text in stated.get(_LEFT_OUT, ())]
        kinds = dict.fromkeys([*map(str, stated.get(_TOLD, ())), *missing], _SILENT)
        kinds |= dict.fromkeys(wrong, IMPLAUSIBLE)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BundleError(
            f"cannot be understood ({error})",
            file="machine.json",
            column=KEY,
            remedy="leave the key as it was exported, or leave it out",
        ) from error
    return refraction, tuple(RunEvent(0, kind, text) for text, kind in kinds.items())
