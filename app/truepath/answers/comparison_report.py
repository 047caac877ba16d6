"""A comparison as `comparison.json`, `comparison.csv` and one HTML page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from truepath.answers.comparison import (
    ComparedError,
    ComparedNumber,
    ComparedVolume,
    Comparison,
    K,
    ReferenceUncertainty,
    compare,
    compare_volumes,
    mean_length,
)
from truepath.answers.shown.chart import (
    LEFT,
    TOP,
    Colour,
    Frame,
    Scale,
    draw_curve,
    draw_image,
    draw_label,
    draw_panels,
    draw_segments,
    draw_strokes,
    fill_band,
    join_shapes,
)
from truepath.answers.shown.page import (
    SIGN,
    View,
    format_expanded,
    format_number,
    render_page,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files
from truepath.files.bundle.recorded_files import decode_reference
from truepath.files.earlier.result_file import read_result
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.kinematics.machine.machine import Axis, Machine
from truepath.kinematics.machine.symbols import (
    describe_symbol,
    is_straightness,
    is_turn,
)
from truepath.motion.paths.default_points import unit_corners

_HEADER = (
    "error,position,position_unit,result,result_uncertainty,reference,"
    "reference_uncertainty,difference,combined_uncertainty,en,unit"
)
KINDS = ("positioning", "straightness", "turns")
_BINS = 31
_VIEW = np.array([[0.87, -0.5, 0.0], [0.28, 0.48, -0.83]])  # from front, right, above
_LONGEST = 34.0  # of an arrow, in units of the figure
_ARROWS = 4  # every fourth grid plane is drawn: both ends and the middle


def _classify(symbol: str) -> str:
    if is_turn(symbol):
        return "turns"
    return "straightness" if is_straightness(symbol) else "positioning"


def _comparison_json(
    comparison: Comparison,
    volume: ComparedVolume | None,
    names: dict[str, str],
    verdict: Verdict,
) -> dict[str, Any]:
    return {
        "schema": "comparison/1",
        **names,
        "verdict": verdict_json(verdict),
        "convention": "positioning and turns are 0 at the axis zero, else at the "
        "lowest position; straightness is 0 there and at the highest position; the "
        "mean of both directions",
        "errors": {e.symbol: _error_json(e) for e in comparison.errors},
        "numbers": {n.symbol: _columns_json(n) for n in comparison.numbers},
        "kinds": {kind: _kind_json(comparison, kind) for kind in KINDS},
        "volumetric": None
        if volume is None
        else {
            "points": len(volume.position),
            "result_mean_um": mean_length(volume.value_um),
            "reference_mean_um": mean_length(volume.reference_um),
            "difference_mean_um": mean_length(volume.difference_um),
            "difference_largest_um": float(
                np.linalg.norm(volume.difference_um, axis=1).max()
            ),
            "note": "of the errors that both know, squareness left out, on a regular "
            "grid over the range of the reference",
        },
        "not_compared": comparison.not_compared,
    }


def _compute_agreement(error: ComparedError) -> float:
    """Share of positions with |E_n| ≤ 1, without those that are 0 by convention."""
    known = error.combined > 0
    if not known.any():
        return 1.0
    return float((np.abs(error.normalised[known]) <= 1.0).mean())


def _error_json(error: ComparedError) -> dict[str, Any]:
    unit = error.unit
    return {
        f"position_{error.position_unit}": error.position_mm.tolist(),
        **_columns_json(error),
        f"forward_{unit}": _or_none(error.forward),
        f"backward_{unit}": _or_none(error.backward),
        f"largest_difference_{unit}": float(np.abs(error.difference).max()),
        f"mean_difference_{unit}": float(np.abs(error.difference).mean()),
        "largest_en": float(np.abs(error.normalised).max()),
        "share_within": _compute_agreement(error),
        "merged": list(error.merged),
        "missing": list(error.missing),
    }


def _or_none(values: Float64[np.ndarray, " n"]) -> list[float | None]:
    return [v if np.isfinite(v) else None for v in values.tolist()]


def _columns(one: ComparedNumber) -> dict[str, Float64[np.ndarray, "*n"]]:
    return {
        "result": one.value,
        "result_uncertainty": one.sigma,
        "reference": one.reference,
        "reference_uncertainty": one.reference_sigma,
        "difference": one.difference,
        "combined_uncertainty": one.combined,
        "en": one.normalised,
    }


def _columns_json(one: ComparedNumber) -> dict[str, Any]:
    return {
        key if key == "en" else f"{key}_{one.unit}": values.tolist()
        for key, values in _columns(one).items()
    }


def _kind_json(comparison: Comparison, kind: str) -> dict[str, Any] | None:
    """The figures that the paper reports for a kind of motions."""
    errors = [e for e in comparison.errors if _classify(e.symbol) == kind]
    if not errors:
        return None
    unit = errors[0].unit
    every = np.abs(np.concatenate([e.difference for e in errors]))
    return {
        "motions": len(errors),
        f"largest_difference_{unit}": float(every.max()),
        f"mean_difference_{unit}": float(every.mean()),
        f"largest_expanded_{unit}": K * max(float(e.combined.max()) for e in errors),
        "share_within": float(np.mean([_compute_agreement(e) for e in errors])),
    }


def _list_rows(comparison: Comparison) -> Iterator[list[str]]:
    for error in comparison.errors:
        columns = _columns(error).values()
        for at, *numbers in zip(error.position_mm, *columns, strict=True):
            cells = [f"{value:z.5f}" for value in numbers]
            place = f"{at:.4f}", error.position_unit
            yield [error.symbol, *place, *cells, error.unit]
    for one in comparison.numbers:
        cells = [f"{value:z.5f}" for value in _columns(one).values()]
        yield [one.symbol, "", "", *cells, one.unit]


def _render_comparison_report(
    machine: Machine,
    comparison: Comparison,
    volume: ComparedVolume | None,
    names: dict[str, str],
    verdict: Verdict,
) -> str:
    errors = [
        e for kind in KINDS for e in comparison.errors if _classify(e.symbol) == kind
    ]
    return render_page(
        "comparison.html",
        {
            "machine": machine.name,
            "verdict": verdict,
            "result": names["result"],
            "reference": names["reference"],
            "rows": [_format_row(one) for one in (*errors, *comparison.numbers)],
            "axes": [
                {"name": axis.name, "figure": _draw_error_motions(comparison, axis)}
                for axis in machine.axes
                if any(e.symbol[2] == axis.name for e in errors)
            ],
            "volume": None if volume is None else _describe_volume(volume),
            "not_compared": list(comparison.not_compared.items()),
        },
    )


def _format_row(number: ComparedNumber) -> tuple[str, ...]:
    unit = SIGN[number.unit]
    largest, expanded, normalised = (
        format_number(float(abs(values).max()), 2)
        for values in (number.difference, K * number.combined, number.normalised)
    )
    if isinstance(number, ComparedError):
        text = describe_symbol(number.symbol)
        if number.merged:
            text += f", with its share of {', '.join(number.merged)}"
        if number.missing:
            missing = ", ".join(number.missing)
            text += f"; holds a share of {missing}, not in the reference"
        mean = f"{format_number(float(abs(number.difference).mean()), 2)} {unit}"
        agreement = f"{format_number(100.0 * _compute_agreement(number), 0)} %"
    else:
        result = format_expanded(float(number.value), float(number.sigma))
        sigma = float(number.reference_sigma)
        reference = format_expanded(float(number.reference), sigma)
        text = f"result {result} {unit}, reference {reference} {unit}"
        mean, agreement = "", "yes" if abs(number.normalised) <= 1.0 else "no"
    stated = f"{largest} {unit}", mean, f"{expanded} {unit}", normalised, agreement
    return number.symbol, text, *stated


def _describe_volume(volume: ComparedVolume) -> View:
    lengths = (
        ("Result", volume.value_um),
        ("Reference", volume.reference_um),
        ("Difference", volume.difference_um),
    )
    return {
        "rows": [
            (name, format_number(mean_length(vector), 2)) for name, vector in lengths
        ],
        "points": len(volume.position),
        "figure": _draw_volume(volume),
    }


def compare_files(
    result: str | Path,
    reference: str | Path,
    folder: str | Path,
    instrument: ReferenceUncertainty,
) -> dict[str, Any]:
    """Compare and write the three files into a folder; gives the content of the JSON.

    Raises BundleError with the place, BadInput if nothing can be compared.
    """
    loaded = read_result(result)
    direct = decode_reference(Path(reference).read_bytes(), file=str(reference))
    comparison = compare(loaded, direct, instrument)
    volume = compare_volumes(loaded.machine, comparison)
    names = {
        "machine": loaded.machine.name,
        "result": Path(result).name,
        "reference": Path(reference).name,
    }
    verdict = loaded.verdict
    content = _comparison_json(comparison, volume, names, verdict)
    rows = [_HEADER, *(",".join(row) for row in _list_rows(comparison))]
    page = _render_comparison_report(loaded.machine, comparison, volume, names, verdict)
    files = {
        "comparison.csv": "".join(f"{row}\n" for row in rows).encode(),
        "comparison.html": page.encode(),
        "comparison.json": encode_json(content),
    }
    write_files(Path(folder), files)
    return content


def _draw_error_motions(comparison: Comparison, axis: Axis) -> Markup:
    def draw(frame: Frame, symbol: str, name: str) -> Markup:
        error = comparison.error(symbol)
        if error is None:
            return frame.draw_empty("not compared")
        return _draw_motion(frame, error, name)

    return draw_panels(axis, f"Error motions of axis {axis.name}, both methods", draw)


def _draw_volume(volume: ComparedVolume) -> Markup:
    parts: list[Markup] = []
    reach = max(float(np.abs(volume.difference_um).max()), 1e-6)
    edge = np.linspace(-reach, reach, _BINS + 1)
    for row, direction in enumerate("XYZ"):
        top = TOP + 84.0 * row
        frame = Frame(LEFT, top, 300.0, top + 58.0)
        parts.append(
            _draw_histogram(frame, volume.difference_um[:, row], edge, direction)
        )
    parts.append(_draw_arrows(volume))
    return draw_image(270.0, "Difference of the volumetric errors", parts)


def _draw_motion(frame: Frame, error: ComparedError, name: str) -> Markup:
    half = K * error.sigma
    low, high = error.value - half, error.value + half
    sides = (
        (error.forward, error.forward_spread, Colour.SECOND),
        (error.backward, error.backward_spread, Colour.THIRD),
    )
    reach = [low, high, *(v + s * k for v, s, _ in sides for k in (-1.0, 1.0))]
    travel = error.position_mm
    x = frame.make_x(float(travel[0]), float(travel[-1]), margin=0.02)
    y = frame.make_y(
        min(0.0, *(float(np.nanmin(r)) for r in reach if np.isfinite(r).any())),
        max(0.0, *(float(np.nanmax(r)) for r in reach if np.isfinite(r).any())),
    )
    at = x.place(travel)
    return join_shapes(
        [
            frame.draw_axes(x, y, name, SIGN[error.unit]),
            fill_band(at, y.place(low), y.place(high), Colour.ACCENT, opacity=0.22),
            draw_curve(at, y.place(error.value), Colour.ACCENT),
            *(_draw_runs(x, y, travel, *side) for side in sides),
        ]
    )


def _draw_runs(
    x: Scale,
    y: Scale,
    position_mm: Float64[np.ndarray, " n"],
    value: Float64[np.ndarray, " n"],
    spread: Float64[np.ndarray, " n"],
    colour: str,
) -> Markup:
    measured = np.isfinite(value)
    if not measured.any():
        return Markup()
    at, middle = x.place(position_mm[measured]), y.place(value[measured])
    low, high = (y.place(value[measured] + k * spread[measured]) for k in (-1.0, 1.0))
    bars = draw_segments(
        np.column_stack([at, low]), np.column_stack([at, high]), colour, width=0.7
    )
    dots = [f"M{a - 1.3:.2f} {b:.2f}h2.6" for a, b in zip(at, middle, strict=True)]
    return bars + draw_strokes(dots, colour, width=1.3)


def _draw_histogram(
    frame: Frame,
    difference_um: Float64[np.ndarray, " n"],
    edge: Float64[np.ndarray, " m"],
    direction: str,
) -> Markup:
    share = 100.0 * np.histogram(difference_um, edge)[0] / len(difference_um)
    x = frame.make_x(float(edge[0]), float(edge[-1]), margin=0.02)
    y = frame.make_y(0.0, 1.05 * float(share.max()), margin=0.0)
    steps = y.place(np.pad(np.repeat(share, 2), 1))
    name = "result − reference, µm" if direction == "Z" else ""
    return join_shapes(
        [
            frame.draw_title(f"{direction}: share of the points"),
            frame.draw_axes(x, y, name, "%", upright=False),
            draw_curve(np.repeat(x.place(edge), 2), steps, Colour.ACCENT, width=1.0),
        ]
    )


def _draw_arrows(volume: ComparedVolume) -> Markup:
    linear = volume.position[:, :3]
    drawn = np.ones(len(linear), bool)
    for column in linear.T:
        places = np.unique(column)[::_ARROWS]
        drawn &= np.isin(column, places) if len(places) > 1 else True
    flat = linear[drawn] @ _VIEW.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = min(210.0 / max(high[0] - low[0], 1.0), 170.0 / max(high[1] - low[1], 1.0))
    begin = np.array([390.0, 40.0]) + (flat - low) * scale
    longest = max(float(np.linalg.norm(volume.difference_um, axis=1).max()), 1e-9)
    end = begin + volume.difference_um[drawn] @ _VIEW.T * (_LONGEST / longest)
    note = f"the longest is {longest:.2f} µm"
    dots = [f"M{a - 0.9:.2f} {b:.2f}h1.8" for a, b in begin]
    edges = _compute_edges(linear) @ _VIEW.T
    edges = np.array([390.0, 40.0]) + (edges - low) * scale
    return join_shapes(
        [
            draw_segments(edges[0], edges[1], Colour.RULE, width=0.8),
            draw_label(380.0, TOP - 5.0, "Difference in the volume", colour=Colour.INK),
            draw_strokes(dots, Colour.MUTED, width=1.8),
            draw_segments(begin, end, Colour.ACCENT, width=1.2),
            draw_label(380.0, 262.0, note),
        ]
    )


def _compute_edges(
    position: Float64[np.ndarray, "n 3"],
) -> Float64[np.ndarray, "2 12 3"]:
    corners = unit_corners()
    low, high = position.min(axis=0), position.max(axis=0)
    pairs = [
        (a, b)
        for a in range(8)
        for b in range(a + 1, 8)
        if abs(corners[a] - corners[b]).sum() == 1.0
    ]
    return low + corners[np.array(pairs).T] * (high - low)
