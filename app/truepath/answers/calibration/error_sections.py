"""Sections on the errors: motions, squareness, direction, volume."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from truepath.answers.comparison.model_difference import format_text
from truepath.answers.shown.error_figures import draw_error_motions, draw_volume
from truepath.answers.shown.page import SIGN, View, format_expanded, format_number
from truepath.kinematics.effects.family import Quantity
from truepath.kinematics.machine.machine import Axis, position_unit
from truepath.kinematics.machine.symbols import describe_symbol
from truepath.kinematics.machine.symbols import list_error_motions as symbols_of
from truepath.results.error_tables import ErrorTable, compute_half_differences
from truepath.results.result_summary import Findings
from truepath.results.updated_effects import describe_use, list_updated_effects
from truepath.results.volumetric_error import Figure

_K = 2.0


def state_figure(figure: Figure) -> str:
    """`value ± U` in µm, k = 2."""
    return format_expanded(figure.value_um, figure.uncertainty_um)


def describe_error_motions(findings: Findings) -> View:
    """Range, largest value, largest U and the values of each error motion."""
    axes = findings.estimate.model.machine.axes
    return {
        "sizes": [
            (
                symbol,
                describe_symbol(symbol),
                *_state_sizes(findings.tables.table(symbol)),
            )
            for axis in axes
            for symbol in symbols_of(axis.name)
        ],
        "axes": [
            {
                "name": axis.name,
                "figure": draw_error_motions([findings.estimate], axis),
                **_list_values(findings, axis),
            }
            for axis in axes
        ],
    }


def describe_squareness(findings: Findings) -> View:
    """Squareness between linear axes, and location errors of rotary axes; k = 2."""
    tables = findings.tables
    return {
        "rows": [
            (
                one.symbol,
                describe_symbol(one.symbol),
                f"{format_expanded(one.value, one.uncertainty)} {SIGN[one.unit]}",
            )
            for one in (*tables.squareness, *tables.locations)
        ]
    }


def describe_direction(findings: Findings) -> View:
    """Half the difference between + and − direction, where any |value| > U."""
    halves = compute_half_differences(findings.estimate)
    rows: list[tuple[str, str, str]] = []
    for half in halves:
        if np.any(np.abs(half.value) > _K * half.uncertainty):
            i = int(np.argmax(np.abs(half.value)))
            value = format_expanded(half.value[i], half.uncertainty[i])
            text = f"{value} {SIGN[half.unit]}"
            rows.append((half.symbol, describe_symbol(half.symbol), text))
    return {"halves": halves, "rows": rows}


def describe_volume(findings: Findings) -> View:
    """The volumetric error before and after compensation, and its worst position."""
    volume = findings.volumetric
    worst = int(np.argmax(np.linalg.norm(volume.error_um, axis=1)))
    axes = findings.estimate.model.machine.axes
    position = zip(axes, volume.position_mm[worst], strict=True)
    error = zip(volume.error_um[worst], volume.uncertainty_um[worst], strict=True)
    states = (("Before compensation", volume.before), ("After, expected", volume.after))
    return {
        "rows": [
            (
                name,
                *(state_figure(f) for f in (spread.mean, spread.p95, spread.largest)),
            )
            for name, spread in states
        ],
        "points": len(volume.position_mm),
        "worst_at": ", ".join(
            f"{axis.name} {format_number(value, 0)} {position_unit(axis)}"
            for axis, value in position
        ),
        "worst": ", ".join(format_expanded(value, sigma) for value, sigma in error),
        "figure_of_volume": draw_volume(findings),
    }


def describe_effects(findings: Findings) -> View:
    """Effects of a given model, before and with this measurement."""
    estimate, model = findings.estimate, findings.provenance.model
    repeats_model = findings.provenance.repeats_model
    effects = list_updated_effects(estimate.known, estimate, estimate.chances)
    return {
        "use": model and describe_use(model, repeats_model=repeats_model),
        "rows": [
            (
                one.title,
                "not used" if repeats_model else _state_numbers(one.before),
                _state_numbers(one.after),
            )
            for one in effects
        ],
        "contradicted": [one.title for one in effects if one.agrees is False],
    }


def _state_sizes(table: ErrorTable | None) -> tuple[str | None, ...]:
    if table is None:
        return "", "", None
    sizes = np.ptp(table.value), np.abs(table.value).max()
    texts = [format_number(float(size)) for size in sizes]
    texts.append(format_number(_K * float(table.uncertainty.max()), 2))
    return tuple(f"{text} {SIGN[table.unit]}" for text in texts)


def _list_values(findings: Findings, axis: Axis) -> View:
    every = [findings.tables.table(symbol) for symbol in symbols_of(axis.name)]
    tables = [t for t in every if t is not None]
    positions: list[float] = tables[0].position_mm.tolist() if tables else []
    head = [f"{axis.name}, {position_unit(axis)}"]
    return {
        "head": head + [f"{t.symbol}, {SIGN[t.unit]}" for t in tables],
        "rows": [
            (
                format_number(position, 2),
                *(format_expanded(t.value[i], t.uncertainty[i]) for t in tables),
            )
            for i, position in enumerate(positions)
        ],
    }


def _state_numbers(parameters: Mapping[str, Quantity]) -> str:
    return "; ".join(
        format_text(name, number.value, number.uncertainty)
        for name, number in parameters.items()
    )
