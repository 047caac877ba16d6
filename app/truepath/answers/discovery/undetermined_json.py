"""Effects that Runs do not distinguish, and what would tell them."""

from __future__ import annotations

from typing import Any

from truepath.discovery.undetermined import (
    OTHER,
    POSE,
    SQUARENESS,
    TIMING,
    TRACKER,
    Undetermined,
)
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.family import find_family

_TAKERS = {
    POSE: "the pose of the tracker",
    TIMING: "phase and speed of the lines",
    SQUARENESS: "squareness",
    TRACKER: "errors of the tracker within its specification",
    OTHER: "other effects of the model",
}
_TELLS = {
    "other-target": "Another tool length or offset shows it.",
    "oblique-lines": "Lines on which several axes move at once show it.",
    "both-directions": "Lines in both directions and at different feeds show it.",
    "repeated-lines": "Repeated lines, the first ones again at the end, show it.",
    "other-places": "Lines along the axis at more positions of the other axes show it.",
    "more-lines": "More lines, at other places and feeds, show it.",
}
REMEDY = "remedy"  # the remedy of the effect's family says it


def undetermined_json(one: Undetermined) -> dict[str, Any]:
    """An effect with what it is not distinguishable from, in keys and in words."""
    return {
        "name": one.family.name,
        **one.keys,
        "signal_to_noise": one.ratio,
        "taken_by": list(one.taken_by),
        "indistinguishable_from": [
            {"name": rival.family, **rival.keys} for rival in one.rivals
        ],
        "would_tell": _choose_cure(one),
        "sentence": write_sentence(one),
    }


def write_sentence(one: Undetermined) -> str:
    """For example `Backlash of X is not distinguishable from …; … show it.`"""
    takers = [
        _TAKERS.get(name, f"the error motions of {name}") for name in one.taken_by
    ]
    takers += [find_family(r.family).title(r.keys) for r in one.rivals]
    cure = _choose_cure(one)
    tells = _TELLS.get(cure, one.family.words["en"].remedy)
    title = one.family.title(one.keys)
    return f"{title} is not distinguishable from {' with '.join(takers)}. {tells}"


def _choose_cure(one: Undetermined) -> str:
    """Key of what would tell."""
    axis = one.keys.get("axis")
    if any(
        r.family == one.family.name and r.keys.get("axis") == axis for r in one.rivals
    ):
        return "other-target"
    if TIMING in one.taken_by:
        return "oblique-lines"
    if one.family.varies_with == "way":
        return "both-directions"
    if one.family.varies_with == "time":
        return "repeated-lines"
    if one.family.role is Role.MEASUREMENT:
        return REMEDY
    return "other-places" if one.family.varies_with == "place" else "more-lines"
