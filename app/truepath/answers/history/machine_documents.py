"""History, changes and comparison of machines as JSON documents, with sentences."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from truepath.answers.history.machine_history import (
    VOLUMETRIC,
    Entry,
    choose_entries,
    find_quantity_unit,
    list_differing,
    read_entries,
    read_expected_after,
)
from truepath.compensation.active_files import read_control_state
from truepath.errors import BadInput

HISTORY_SCHEMA, CHANGES_SCHEMA = "machine-history/1", "machine-changes/1"
COMPARISON_SCHEMA = "machine-comparison/1"
K = 2.0
_OTHER_COMPENSATION = (
    "The compensation of the control was another: what differs is no change of the "
    "machine by itself."
)
_SIGN = {"um": "µm", "urad": "µrad"}


@dataclass(frozen=True, slots=True)
class Calibration:
    """One result of a machine.

    file : its `result.json`; verdict : the state of its verdict
    is_time_stated : by its Runs; else `measured` is when it was catalogued
    """

    machine: str
    job_id: str
    run_ids: tuple[str, ...]
    measured: str
    machine_version: int | None
    verdict: str | None
    file: Path
    is_time_stated: bool = True

    def describe(self) -> dict[str, Any]:
        """The keys of a document but its file and machine."""
        return {
            "job_id": self.job_id,
            "run_ids": list(self.run_ids),
            "measured": self.measured,
            "machine_version": self.machine_version,
            "verdict": self.verdict,
        }


@lru_cache(maxsize=256)
def _read(file: Path, _written_ns: int) -> Mapping[str, Any]:
    return json.loads(file.read_text(encoding="utf-8"))


def read_stated(one: Calibration) -> Mapping[str, Any]:
    """Content of a result file, cached: a file never changes once it exists."""
    return _read(one.file, one.file.stat().st_mtime_ns)


def history_json(
    machine: str,
    calibrations: Sequence[Calibration],
    quantity: str,
    position: float | None,
) -> dict[str, Any]:
    """A quantity over all calibrations, the oldest first. Raises BadInput."""
    unit = find_quantity_unit(quantity)
    stated = [read_entries(read_stated(one), quantity) for one in calibrations]
    chosen = [choose_entries(entries, quantity, position) for entries in stated]
    keys = list(dict.fromkeys(e.key for entries in chosen for e in entries))
    of_key = {e.key: e for entries in chosen for e in entries}
    return {
        "schema": HISTORY_SCHEMA,
        "machine": machine,
        "quantity": quantity,
        "unit": unit,
        "entries": [
            {
                "label": label,
                "position": where,
                "position_unit": of_key[label, where].position_unit,
            }
            for label, where in keys
        ],
        "calibrations": [
            {
                **one.describe(),
                **_columns(entries, keys),
                **_columns_after(read_expected_after(read_stated(one), quantity), keys),
            }
            for one, entries in zip(calibrations, chosen, strict=True)
        ],
    }


def _columns(
    entries: Sequence[Entry], keys: Sequence[tuple[str, float | None]]
) -> dict[str, list[float | None]]:
    found = {e.key: e for e in entries}
    return {
        "value": [found[k].value if k in found else None for k in keys],
        "uncertainty": [found[k].uncertainty if k in found else None for k in keys],
    }


def _columns_after(
    entries: Sequence[Entry], keys: Sequence[tuple[str, float | None]]
) -> dict[str, list[float | None]]:
    columns = _columns(entries, keys)
    return {
        "expected_after": columns["value"],
        "expected_after_uncertainty": columns["uncertainty"],
    }


def changes_json(since: Calibration, until: Calibration) -> dict[str, Any]:
    """What has changed between two calibrations, and how surely.

    Raises BadInput, BundleError where they cannot be compared.
    """
    return dict(_find_changes(since, until))


@lru_cache(maxsize=64)
def _find_changes(since: Calibration, until: Calibration) -> Mapping[str, Any]:
    # Imported on use: the service process does not load the numerical code.
    from truepath.answers.history.machine_change import (
        CHANCE,
        find_changes,
        list_significant,
    )
    from truepath.files.earlier.result_file import read_result

    before, after = read_result(since.file), read_result(until.file)
    change = find_changes(before, after)
    stated = [one.provenance for one in (before, after)]
    is_other = any(
        None not in pair and pair[0] != pair[1]
        for pair in (
            [read_control_state(one) for one in stated],
            [one.get("active_tables") for one in stated],
        )
    )
    significant = [_entry_json(asdict(e)) for e in list_significant(change)]
    return {
        "schema": CHANGES_SCHEMA,
        "machine": until.machine,
        "since": since.describe(),
        "until": until.describe(),
        "has_changed": change.is_significant and not is_other,
        "compensation_changed": is_other,
        "chance": CHANCE,
        "factor": change.factor,
        "volumetric": {
            **asdict(change.volume),
            "is_significant": change.volume.is_significant,
        },
        "significant": significant,
        "entries": [_entry_json(asdict(e)) for e in change.entries],
        "not_compared": list(change.not_compared),
        "text": [_OTHER_COMPENSATION] * is_other
        + _describe_change(asdict(change.volume), significant, change.factor),
    }


def _entry_json(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {**entry, "difference": entry["after"] - entry["before"]}


def _describe_change(
    volume: Mapping[str, Any], significant: Sequence[Mapping[str, Any]], factor: float
) -> list[str]:
    told: list[str] = []
    if volume["difference_um"] > volume["by_chance_um"]:
        told.append(
            f"The volumetric error has changed by about {volume['change_um']:.1f} µm, "
            "root mean square over the travel."
        )
    for entry in significant:
        sign, place = _SIGN[entry["unit"]], ""
        if entry["position"] is not None:
            place = f" at {entry['position']:g} {entry['position_unit']}"
        told.append(
            f"{entry['symbol']}{place} went from {entry['before']:.1f} to "
            f"{entry['after']:.1f} {sign}, by {entry['difference']:+.1f} ± "
            f"{K * entry['uncertainty']:.1f} {sign} (k = 2)."
        )
    if told:
        return told
    return [
        "No change is seen: no table entry differs by more than "
        f"its expanded uncertainty (k = {factor:.1f}), and the volumetric difference "
        f"of {volume['difference_um']:.1f} µm is within the "
        f"{volume['by_chance_um']:.1f} µm that both uncertainties allow."
    ]


@dataclass(frozen=True, slots=True)
class ToleranceJudgement:
    """The 95th percentile of the volumetric error compared with a tolerance.

    state : `within`, `over`, or `not-sure` where the tolerance lies within the expanded
        uncertainty (k = 2)
    """

    state: str
    value_um: float
    uncertainty_um: float
    tolerance_um: float

    @property
    def text(self) -> str:
        """English sentence with U (k = 2)."""
        said = f"{self.value_um:.1f} ± {K * self.uncertainty_um:.1f} µm (k = 2)"
        words = {"within": "within", "over": "over", "not-sure": "too close to tell:"}
        return (
            f"95 % of the places err by at most {said}, {words[self.state]} the "
            f"tolerance of {self.tolerance_um:g} µm"
        )


def assess_tolerance(one: Calibration, tolerance_um: float) -> ToleranceJudgement:
    """On the 95th percentile of the volumetric error of a calibration."""
    entries = read_entries(read_stated(one), VOLUMETRIC)
    p95 = next(e for e in entries if e.label == "p95")
    off = p95.value - tolerance_um
    state = "over" if off > 0.0 else "within"
    if abs(off) <= K * p95.uncertainty:
        state = "not-sure"
    return ToleranceJudgement(state, p95.value, p95.uncertainty, tolerance_um)


def comparison_json(
    newest: Sequence[Calibration],
    quantity: str,
    position: float | None,
    tolerances_um: Mapping[str, float | None],
) -> dict[str, Any]:
    """One quantity of several machines, the smallest first.

    newest : the calibration of each machine

    Raises BadInput where the quantity has several entries and no position is given.
    """
    unit, label = find_quantity_unit(quantity), "p95" if quantity == VOLUMETRIC else ""
    found: list[tuple[Calibration, Entry]] = []
    for one in newest:
        entries = choose_entries(
            read_entries(read_stated(one), quantity), quantity, position
        )
        own = [e for e in entries if e.label == label]
        if len(own) > 1:
            raise BadInput(f"{quantity} has many entries; give the position of one")
        found += [(one, e) for e in own]
    found.sort(key=lambda pair: pair[1].value)
    factor, differing = list_differing([entry for _, entry in found])
    names = [one.machine for one, _ in found]
    return {
        "schema": COMPARISON_SCHEMA,
        "quantity": quantity,
        "label": label,
        "position": position,
        "unit": unit,
        "factor": factor,
        "machines": [
            {
                "machine": one.machine,
                **one.describe(),
                "value": entry.value,
                "uncertainty": entry.uncertainty,
                "is_more_than": [names[a] for a, b in differing if b == k],
                "tolerance_um": tolerances_um.get(one.machine),
            }
            for k, (one, entry) in enumerate(found)
        ],
    }
