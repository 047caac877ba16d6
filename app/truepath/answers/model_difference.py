"""Differences between two models of a machine, in words and numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from truepath.answers.shown.page import SIGN, format_expanded, format_number
from truepath.files.units import unit_of
from truepath.kinematics.effects.base import Effect, ErrorCurve
from truepath.kinematics.model import EstimatedModel
from truepath.results.error_tables import build_error_table, choose_table_positions

_SHOWS = 2.0  # expanded uncertainty of the later model, k = 2
_UNITS = (
    *("um_per_m_K", "um_per_m", "um_per_s", "urad", "rad"),
    *("um", "mm", "ms", "hz", "s"),
)


@dataclass(frozen=True, slots=True)
class Change:
    """One difference. kind : `added`, `removed` or `changed`; text : a sentence"""

    kind: str
    what: str
    text: str


def list_differences(
    before: EstimatedModel, after: EstimatedModel
) -> tuple[Change, ...]:
    """Effects added and removed, and changed numbers.

    A number has changed if it did so by more than its expanded uncertainty (k = 2).
    """
    before, after = before.reduce_to_targets, after.reduce_to_targets
    old, new = before.effects(), after.effects()
    added = [_describe_effect(after, new[n], "added") for n in new if n not in old]
    removed = [_describe_effect(before, old[n], "removed") for n in old if n not in new]
    both = [n for n in new if n in old and type(old[n]) is type(new[n])]
    changed = [c for n in both for c in _list_changes(before, after, old[n], new[n])]
    return (*added, *removed, *changed)


def format_parameter(name: str, value: float, uncertainty: float) -> str:
    """`width 6.1 ± 0.4 µm` of a number that files call `width_um`."""
    stem, _, direction = name.partition("[")
    unit = next((one for one in _UNITS if stem.endswith(f"_{one}")), "")
    words = stem.removesuffix(f"_{unit}").replace("_", " "), direction.rstrip("]")
    number = format_expanded(value, uncertainty)
    return " ".join(filter(None, [*words, number, SIGN.get(unit, unit)]))


def _describe_effect(state: EstimatedModel, effect: Effect, kind: str) -> Change:
    theta, covariance = state.part(effect.name)
    catalogued = {e.name: e for e in state.model.catalogue_effects}
    if known := catalogued.get(effect.name):
        found = known.state(theta, covariance)
        numbers = [
            format_parameter(n, m.value, m.uncertainty) for n, m in found.items()
        ]
        return Change(kind, known.label, f"{known.label}: {', '.join(numbers)}")
    size = f"{len(theta)} parameters"
    if len(theta) == 1:
        unit, scale = unit_of(effect.parameters[0])
        sigma = float(np.sqrt(covariance[0, 0]))
        number = format_expanded(scale * float(theta[0]), scale * sigma)
        size = f"{number} {SIGN.get(unit, unit)}"
    return Change(kind, effect.label, f"{effect.label}: {size}")


def _list_changes(
    before: EstimatedModel, after: EstimatedModel, old: Effect, new: Effect
) -> Iterator[Change]:
    if old.motion and new.motion:
        yield from _list_motion_changes(before, after, old.motion, new.motion)
        return
    (was, _), (now, covariance) = before.part(old.name), after.part(new.name)
    sigma = np.sqrt(np.diag(covariance))
    for parameter, a, b, s in zip(new.parameters, was, now, sigma, strict=True):
        if abs(b - a) > _SHOWS * s:
            unit, scale = unit_of(parameter)
            number = format_expanded(scale * float(b), scale * float(s))
            text = (
                f"{parameter.name}: from {format_number(scale * float(a))} to {number}"
            )
            yield Change("changed", new.label, f"{text} {SIGN.get(unit, unit)}")


def _list_motion_changes(
    before: EstimatedModel, after: EstimatedModel, old: ErrorCurve, new: ErrorCurve
) -> Iterator[Change]:
    at_mm = choose_table_positions(new.axis)
    was = build_error_table(before, old, at_mm)
    now = build_error_table(after, new, at_mm)
    moved = now.value - was.value
    excess = np.abs(moved) / np.maximum(now.uncertainty, 1e-9)
    worst = int(np.argmax(excess))
    if excess[worst] > _SHOWS:
        number = format_expanded(float(now.value[worst]), float(now.uncertainty[worst]))
        position = format_number(float(at_mm[worst]), 0)
        before_text = format_number(float(was.value[worst]))
        text = (
            f"{new.symbol} at {new.axis.name} {position} {now.position_unit}: "
            f"from {before_text} to {number} {SIGN[now.unit]}"
        )
        yield Change("changed", new.symbol, text)
