"""A machine over time as `trend.json` (schema `trend/1`), and in words.

Uncertainties are standard ones (k = 1), as in every file; times are hours since the
first Run.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from truepath.app.files.machine_file import machine_to_json
from truepath.app.files.verdict import verdict_json
from truepath.app.results.error_table_files import tables_json
from truepath.app.results.number_format import format_number
from truepath.app.results.outlook import CHANCE, Outlook, TablesAt
from truepath.app.results.trend import HOUR_S, Trend

SCHEMA = "trend/1"
NOT_TOLD = (
    "Shifts and turns of the whole volume between Runs, the growth of a spindle among "
    "them: the tracker's place is free in every Run.",
    "What happens within a Run: each counts as one moment, its middle.",
    "Changes of lost motion and of anything else that depends on the direction of "
    "approach.",
    "What has not begun yet: another use of the machine, a crash, a change of its "
    "heating. The course goes on as it was, and as halls usually do.",
)
_KEYS = {
    "quick": "quick_um",
    "slow": "slow_um",
    "quick_s": "quick_s",
    "slow_s": "slow_s",
    "walk": "walk_um_in_one_hour",
    "day": "day_um",
    "per_kelvin": "per_kelvin_um",
}


def trend_json(trend: Trend) -> dict[str, Any]:
    """Return the content of `trend.json`."""
    return {
        "schema": SCHEMA,
        "machine": machine_to_json(trend.machine),
        "verdict": verdict_json(trend.verdict),
        "runs": [
            {
                "name": at.name,
                "sha256": run.digest,
                "temperature_degC": run.temperature_degc,
                **_encode_tables(trend, at),
            }
            for run, at in zip(trend.runs, trend.at_runs, strict=True)
        ],
        "later": [_encode_tables(trend, at) for at in trend.later],
        "states": {_KEYS[name]: asdict(size) for name, size in trend.sizes.items()},
        "sensors": list(trend.sensors),
        "outlook": _encode_outlook(trend.outlook),
        "not_told": list(NOT_TOLD),
    }


def describe_outlook(outlook: Outlook) -> str:
    """Say when to calibrate again."""
    if outlook.state == "not-known":
        return "When to calibrate again is not known: too few Runs, give three or more."
    if outlook.limit_um is None:
        return "No limit is stated, so nothing is said of when to calibrate again."
    limit = f"{outlook.limit_um:g} µm"
    hours = f"{format_number(float(outlook.time_s[-1]) / HOUR_S)} h"
    if outlook.due_s is None:
        return f"Not due: the machine stays below {limit} up to {hours}."
    if outlook.state == "already":
        return (
            f"Already: what is not known at the last Run may exceed {limit}. Measure "
            "more, or state a wider limit."
        )
    due = f"{format_number(outlook.due_s / HOUR_S)} h"
    chance = f"{100.0 * CHANCE:.0f} %"
    if outlook.expected_s is None:
        end = f"{100.0 * (outlook.exceeded or 0.0):.0f} %"
        return (
            f"The machine stays below {limit} up to {due}. Later cannot be said: the "
            f"chance to exceed it reaches {end} by {hours}. Measure once more by {due}."
        )
    expected = f"{format_number(outlook.expected_s / HOUR_S)} h"
    return (
        f"Calibrate again at {due} ({outlook.grade}): a chance of {chance} to exceed "
        f"{limit} by then, an even chance by {expected}."
    )


def _encode_tables(trend: Trend, at: TablesAt) -> dict[str, Any]:
    tables = tables_json(at.tables, (), "none", {}, trend.machine)
    del tables["direction"], tables["measured_range"]
    hours = at.time_s / HOUR_S
    return {"time_h": hours, "change_um": asdict(at.change_um), **tables}


def _encode_outlook(outlook: Outlook) -> dict[str, Any]:
    due, expected = outlook.due_s, outlook.expected_s
    return {
        "state": outlook.state,
        "grade": outlook.grade,
        "sentence": describe_outlook(outlook),
        "limit_um": outlook.limit_um,
        "chance": CHANCE,
        "exceeded": outlook.exceeded,
        "due_h": None if due is None else due / HOUR_S,
        "expected_h": None if expected is None else expected / HOUR_S,
        "time_h": (outlook.time_s / HOUR_S).tolist(),
        "median_um": outlook.median_um.tolist(),
        "high_um": outlook.high_um.tolist(),
    }
