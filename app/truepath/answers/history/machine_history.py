"""One number of a machine over all its calibrations, and of several machines.

A quantity is the symbol of an error motion, at a position of its table or at all, of a
squareness or of a location; or `volumetric`: the length of the volumetric error over
the travel. Values are those in the result files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import NormalDist
from typing import Any

import numpy as np

from truepath.errors import BadInput
from truepath.kinematics.machine.symbols import (
    LINEAR,
    SQUARENESS,
    TURNS,
    find_unit,
    list_error_motions,
    list_locations,
)

VOLUMETRIC = "volumetric"
FIGURES = ("mean", "p95", "largest")
_SAME = 0.5  # mm or deg: a position as people write it
CHANCE = 0.05  # that any two of several equal machines are reported to differ


_SYMBOLS = frozenset(
    (
        *SQUARENESS,
        *(s for axis in (*LINEAR, *TURNS) for s in list_error_motions(axis)),
        *(s for axis in TURNS for s in list_locations(axis)),
    )
)


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


def find_quantity_unit(quantity: str) -> str:
    """`um` or `urad`. Raises BadInput for an unknown quantity."""
    if quantity == VOLUMETRIC:
        return "um"
    if quantity not in _SYMBOLS:
        raise BadInput(
            f"{quantity!r} is no quantity; give {VOLUMETRIC}, or a symbol such as EXX, "
            "C0Y or XOC"
        )
    return find_unit(quantity)


def read_entries(result: Mapping[str, Any], quantity: str) -> list[Entry]:
    """Entries of a quantity; empty where the result does not have it."""
    if quantity == VOLUMETRIC:
        return _read_spread(result["volumetric_error"]["before"])
    if single := result["squareness_urad"].get(quantity):
        return [Entry("", None, "", single["value"], single["uncertainty"])]
    unit = find_quantity_unit(quantity)
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


def read_expected_after(result: Mapping[str, Any], quantity: str) -> list[Entry]:
    """What is expected to remain of a quantity after full compensation.

    Only of `volumetric`; else empty, as where a result does not have it.
    """
    if quantity != VOLUMETRIC or "after_expected" not in result["volumetric_error"]:
        return []
    return _read_spread(result["volumetric_error"]["after_expected"])


def _read_spread(spread: Mapping[str, Any]) -> list[Entry]:
    figures = ((name, spread[name]) for name in FIGURES)
    return [
        Entry(name, None, "", one["value_um"], one["uncertainty_um"])
        for name, one in figures
    ]


def choose_entries(
    entries: Sequence[Entry], quantity: str, position: float | None
) -> list[Entry]:
    """The entry at a position (to 0.5 mm or deg), or all. Raises BadInput."""
    if position is None or not entries:
        return list(entries)
    placed = [e for e in entries if e.position is not None]
    found = [e for e in placed if abs((e.position or 0.0) - position) < _SAME]
    if not found:
        known = ", ".join(f"{e.position:g}" for e in placed)
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
    factor = NormalDist().inv_cdf(1.0 - CHANCE / (2.0 * len(pairs)))
    found: list[tuple[int, int]] = []
    for one, other in pairs:
        a, b = entries[one], entries[other]
        if abs(a.value - b.value) > factor * np.hypot(a.uncertainty, b.uncertainty):
            found.append((one, other) if a.value < b.value else (other, one))
    return factor, found
