"""The history of machines: calibrations, changes, comparison, models; as JSON.

A quantity is the symbol of an error motion, at a position of its table or at all, of a
squareness or of a location; or `volumetric`: the length of the volumetric error over
the travel. Values are those in the result files. One job makes one model at most.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from truepath.compensation.active_files import read_control_state
from truepath.errors import BadInput, NotFound
from truepath.kinematics.machine.symbols import (
    LINEAR,
    SQUARENESS,
    TURNS,
    find_unit,
    list_error_motions,
    list_locations,
)

_VOLUMETRIC = "volumetric"
_SAME = 0.5  # mm or deg: a position as people write it
_CHANCE = 0.05  # that any two of several equal machines are reported to differ
_SYMBOLS = frozenset(
    (
        *SQUARENESS,
        *(s for axis in (*LINEAR, *TURNS) for s in list_error_motions(axis)),
        *(s for axis in TURNS for s in list_locations(axis)),
    )
)
K = 2.0
_OTHER_COMPENSATION = (
    "The compensation of the control was another: what differs is no change of the "
    "machine by itself."
)
_SIGN = {"um": "µm", "urad": "µrad"}
MODEL, RESULT, DISCOVERY = "model.json", "result.json", "discovery.json"


@dataclass(frozen=True, slots=True)
class Entry:
    """One number of a result with its standard uncertainty (k = 1).

    label : `mean`, `p95` or `largest` of `volumetric`, else empty
    position : of the axis in `position_unit`; None where there is none
    """

    label: str
    position: float | None
    position_unit: str
    value: float
    uncertainty: float

    @property
    def key(self) -> tuple[str, float | None]:
        """Equal for the same entry of another result."""
        return self.label, self.position


def _find_quantity_unit(quantity: str) -> str:
    if quantity == _VOLUMETRIC:
        return "um"
    if quantity not in _SYMBOLS:
        raise BadInput(
            f"{quantity!r} is no quantity; give {_VOLUMETRIC}, or a symbol such as "
            "EXX, C0Y or XOC"
        )
    return find_unit(quantity)


def _read_entries(result: Mapping[str, Any], quantity: str) -> list[Entry]:
    if quantity == _VOLUMETRIC:
        return _read_spread(result["volumetric_error"]["before"])
    if single := result["squareness_urad"].get(quantity):
        return [Entry("", None, "", single["value"], single["uncertainty"])]
    unit = _find_quantity_unit(quantity)
    if place := result.get("axis_location", {}).get(quantity):
        value, sigma = place[f"value_{unit}"], place[f"uncertainty_{unit}"]
        return [Entry("", None, "", value, sigma)]
    table = result["error_tables"].get(quantity)
    if table is None:
        return []
    measure = "mm" if "position_mm" in table else "deg"
    columns = (f"position_{measure}", f"value_{unit}", f"uncertainty_{unit}")
    rows = zip(*(table[name] for name in columns), strict=True)
    return [Entry("", p, measure, v, u) for p, v, u in rows]


def _read_spread(spread: Mapping[str, Any]) -> list[Entry]:
    return [
        Entry(name, None, "", spread[name]["value_um"], spread[name]["uncertainty_um"])
        for name in ("mean", "p95", "largest")
    ]


def _choose_entries(
    entries: Sequence[Entry], quantity: str, position: float | None
) -> list[Entry]:
    if position is None or not entries:
        return list(entries)
    placed = [(e, e.position) for e in entries if e.position is not None]
    found = [e for e, at in placed if abs(at - position) < _SAME]
    if not found:
        known = ", ".join(f"{at:g}" for _, at in placed)
        raise BadInput(
            f"{quantity} has no entry at {position:g}; it has them at {known or 'none'}"
        )
    return found[:1]


def list_differing(entries: Sequence[Entry]) -> tuple[float, list[tuple[int, int]]]:
    """Factor, and pairs of machines whose numbers differ, the lower one first.

    Each pair is compared with the same factor of its combined standard uncertainty:
    with it any of equal machines are said to differ with a chance of 5 % at most
    (Bonferroni over the pairs).
    """
    pairs = list(combinations(range(len(entries)), 2))
    if not pairs:
        return 0.0, []
    factor = NormalDist().inv_cdf(1.0 - _CHANCE / (2.0 * len(pairs)))
    found: list[tuple[int, int]] = []
    for one, other in pairs:
        a, b = entries[one], entries[other]
        if abs(a.value - b.value) > factor * np.hypot(a.uncertainty, b.uncertainty):
            found.append((one, other) if a.value < b.value else (other, one))
    return factor, found


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


def read_result_content(one: Calibration) -> Mapping[str, Any]:
    """Content of a result file, cached: a file never changes once it exists."""
    return _read(one.file, one.file.stat().st_mtime_ns)


def history_json(
    machine: str,
    calibrations: Sequence[Calibration],
    quantity: str,
    position: float | None,
) -> dict[str, Any]:
    """A quantity over all calibrations, the oldest first. Raises BadInput."""
    unit = _find_quantity_unit(quantity)
    stated = [read_result_content(one) for one in calibrations]
    chosen = [
        _choose_entries(_read_entries(one, quantity), quantity, position)
        for one in stated
    ]
    is_volumetric = quantity == _VOLUMETRIC  # what remains after full compensation
    expected = [
        _read_spread(one["volumetric_error"]["after_expected"])
        if is_volumetric and "after_expected" in one["volumetric_error"]
        else []
        for one in stated
    ]
    keys = list(dict.fromkeys(e.key for entries in chosen for e in entries))
    of_key = {e.key: e for entries in chosen for e in entries}
    return {
        "schema": "machine-history/1",
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
                **_columns(entries, keys, "value", "uncertainty"),
                **_columns(after, keys, "expected_after", "expected_after_uncertainty"),
            }
            for one, entries, after in zip(calibrations, chosen, expected, strict=True)
        ],
    }


def _columns(
    entries: Sequence[Entry], keys: Sequence[tuple[str, float | None]], *names: str
) -> dict[str, list[float | None]]:
    """Values and uncertainties, by two names."""
    pairs = {e.key: (e.value, e.uncertainty) for e in entries}
    found = [pairs.get(key, (None, None)) for key in keys]
    return {name: [pair[k] for pair in found] for k, name in enumerate(names)}


def changes_json(since: Calibration, until: Calibration) -> dict[str, Any]:
    """What has changed between two calibrations, and how surely.

    Raises BadInput, BundleError where they cannot be compared.
    """
    return dict(_find_changes(since, until))


@lru_cache(maxsize=64)
def _find_changes(since: Calibration, until: Calibration) -> Mapping[str, Any]:
    # Imported on use: the service process does not load the numerical code.
    from truepath.answers.machine_change import CHANCE, detect_changes, list_significant
    from truepath.files.earlier.result_file import read_result

    before, after = read_result(since.file), read_result(until.file)
    change = detect_changes(before, after)
    stated = [one.provenance for one in (before, after)]
    is_other = any(
        None not in pair and pair[0] != pair[1]
        for pair in (
            [read_control_state(one) for one in stated],
            [one.get("active_tables") for one in stated],
        )
    )
    significant = [
        {**asdict(e), "difference": e.difference} for e in list_significant(change)
    ]
    return {
        "schema": "machine-changes/1",
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
        "entries": [{**asdict(e), "difference": e.difference} for e in change.entries],
        "not_compared": list(change.not_compared),
        "text": [_OTHER_COMPENSATION] * is_other
        + _describe_change(asdict(change.volume), significant, change.factor),
    }


def _describe_change(
    volume: Mapping[str, Any], significant: Sequence[Mapping[str, Any]], factor: float
) -> list[str]:
    texts: list[str] = []
    if volume["difference_um"] > volume["by_chance_um"]:
        texts.append(
            f"The volumetric error has changed by about {volume['change_um']:.1f} µm, "
            "root mean square over the travel."
        )
    for entry in significant:
        sign, place = _SIGN[entry["unit"]], ""
        if entry["position"] is not None:
            place = f" at {entry['position']:g} {entry['position_unit']}"
        texts.append(
            f"{entry['symbol']}{place} went from {entry['before']:.1f} to "
            f"{entry['after']:.1f} {sign}, by {entry['difference']:+.1f} ± "
            f"{K * entry['uncertainty']:.1f} {sign} (k = 2)."
        )
    if texts:
        return texts
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
    entries = _read_entries(read_result_content(one), _VOLUMETRIC)
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
    unit, label = (
        _find_quantity_unit(quantity),
        "p95" if quantity == _VOLUMETRIC else "",
    )
    found: list[tuple[Calibration, Entry]] = []
    for one in newest:
        entries = _choose_entries(
            _read_entries(read_result_content(one), quantity), quantity, position
        )
        own = [e for e in entries if e.label == label]
        if len(own) > 1:
            raise BadInput(f"{quantity} has many entries; give the position of one")
        found += [(one, e) for e in own]
    found.sort(key=lambda pair: pair[1].value)
    factor, differing = list_differing([entry for _, entry in found])
    names = [one.machine for one, _ in found]
    return {
        "schema": "machine-comparison/1",
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


def find_model_file(results: Path, job_id: str) -> Path:
    """The model of a discovery, or the result of an analysis.

    Raises NotFound if the job has neither.
    """
    for name in (MODEL, RESULT):
        file = results / job_id / name
        if file.is_file():
            return file
    raise NotFound(f"job {job_id} has no model and no result")


def read_model_summary(results: Path, job_id: str) -> Mapping[str, Any]:
    """Version, parent, difference, effects and gap of a discovered model.

    Raises NotFound if the job discovered none.
    """
    file = results / job_id / DISCOVERY
    if not file.is_file():
        raise NotFound(f"job {job_id} has no model")
    content = json.loads(file.read_text(encoding="utf-8"))
    return {**content["model"], "effects": content["effects"], "gap": content["gap"]}


def read_versions(results: Path, job_id: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Job and content of a model and its ancestors, the newest first."""
    found = [(job_id, read_model_summary(results, job_id))]
    seen = {job_id}
    while True:
        source = str(found[-1][1]["parent"]["source"])
        if source in seen or not (results / source / DISCOVERY).is_file():
            return found
        found.append((source, read_model_summary(results, source)))
        seen.add(source)


def read_difference(before: Path, after: Path) -> list[dict[str, str]]:
    """Two model or result files, compared. Raises BundleError."""
    # Imported on use: the service process does not load the numerical code.
    from truepath.answers.model_difference import list_differences
    from truepath.files.earlier.result_file import read_result

    old, new = (read_result(file) for file in (before, after))
    changes = list_differences(old, new)
    return [asdict(change) for change in changes]
