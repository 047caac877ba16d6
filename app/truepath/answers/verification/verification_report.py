"""A verification: its page, one HTML file, and its files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from truepath.answers.shown.chart import (
    EDGE,
    LEFT,
    TOP,
    WIDTH,
    Colour,
    Frame,
    draw_curve,
    draw_image,
    draw_segments,
    draw_strokes,
    join_shapes,
)
from truepath.answers.shown.error_figures import draw_legend
from truepath.answers.shown.page import (
    View,
    format_expanded,
    format_number,
    render_page,
)
from truepath.answers.verification.circle_figures import FIGURES, StatedFigures
from truepath.answers.verification.matched_points import K
from truepath.answers.verification.polar_figure import ENGLISH, draw_polar_circles
from truepath.answers.verification.static_tests import (
    CIRCLE_FIGURES,
    LINE_FIGURES,
    LineFigures,
)
from truepath.answers.verification.verification import Verification
from truepath.answers.verification.verification_json import (
    circles_json,
    describe_findings,
    directions_json,
    verification_json,
)
from truepath.documents.file_model import encode_json
from truepath.documents.whole_files import write_files

VERIFICATION, REPORT = "verification.json", "report.html"
_HEIGHT = 130.0
_STATISTICS = (
    ("mean", "Mean"),
    ("p95", "95 % of the places within"),
    ("largest", "Largest"),
)


def write_verification(
    found: Verification,
    folder: str | Path,
    asked: Mapping[str, Any] | None = None,
    *,
    compensation: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write `verification.json` and `report.html`; gives the content of the first.

    asked : the request, to be repeated there
    compensation : which files were active, `format` and `files_sha256` by name
    """
    content = {
        **verification_json(found),
        "compensation": compensation,
        "asked": dict(asked or {}),
    }
    page = _render_verification_report(found).encode()
    write_files(Path(folder), {REPORT: page, VERIFICATION: encode_json(content)})
    return content


def _render_verification_report(found: Verification) -> str:
    return render_page(
        "verification.html",
        {
            "machine": found.result.machine.name,
            "verdict": found.result.verdict,
            "run_verdict": found.run_verdict,
            "run": ", ".join(one.summary.name for one in found.runs),
            "is_compensated": found.is_compensated,
            "statements": list(describe_findings(found)),
            "statistics": [
                (
                    title,
                    *(
                        format_expanded(one[name].value_um, one[name].uncertainty_um)
                        for one in found.statistics.values()
                    ),
                )
                for name, title in _STATISTICS
            ],
            "places": _draw_lengths(found),
            "directions": [
                (
                    name,
                    format_number(one["rms_um"], 2),
                    format_number(one["largest_um"], 2),
                    format_number(K * one["uncertainty_um"], 2),
                )
                for name, one in directions_json(found.deviation).items()
            ],
            "line_head": ("Line", "standard", "runs", *LINE_FIGURES),
            "lines": [
                row
                for one in found.driven.lines
                for row in _list_rows(
                    (one.axes, one.kind.upper().replace("ISO-", "ISO "), str(one.runs)),
                    LINE_FIGURES,
                    one.figures,
                    one.predicted_um,
                )
            ],
            "circle_head": ("Plane", "radius mm", *CIRCLE_FIGURES),
            "circles": [
                row
                for one in found.driven.circles
                for row in _list_rows(
                    (one.plane, format_number(one.radius_mm, 0)),
                    CIRCLE_FIGURES,
                    one.figures,
                    one.predicted_um,
                )
            ],
            "moving_head": ("Plane", "diameter mm", "feed mm/min", *FIGURES),
            "moving_circles": [
                row
                for one in found.circles.circles
                for row in _list_rows(
                    (
                        one.commanded.plane,
                        f"{2.0 * one.commanded.radius_mm:g}",
                        f"{one.commanded.feed_mm_min:g}",
                    ),
                    FIGURES,
                    one.measured,
                    one.predicted_um,
                    one.predicted_uncertainty_um,
                )
            ],
            "polar_circles": draw_polar_circles(
                circles_json(found.circles)["circles_in_motion"], ENGLISH
            ),
            "runs": [_draw_line(one) for one in found.driven.lines],
            "components": "in all three components"
            if found.points.is_complete
            else "across the travel on lines, in three components at standstills",
        },
    )


def _list_rows(
    head: Sequence[str],
    names: Sequence[str],
    stated: StatedFigures,
    predicted_um: Mapping[str, float],
    predicted_uncertainty_um: Mapping[str, float] | None = None,
) -> list[tuple[str, ...]]:
    """Rows of figures: as measured, by the noise alone, as predicted."""

    def format_row(
        value: Mapping[str, float], sigma: Mapping[str, float] | None
    ) -> Iterator[str]:
        for name in names:
            if name not in value:
                yield "—"
            elif sigma is None:
                yield format_number(value[name], 1)
            else:
                yield format_expanded(value[name], sigma[name])

    blank = [""] * (len(head) - 2)
    return [
        (*head, *format_row(stated.value_um, stated.uncertainty_um)),
        ("", "noise alone", *blank, *format_row(stated.own_um, None)),
        ("", "predicted", *blank, *format_row(predicted_um, predicted_uncertainty_um)),
    ]


def _draw_lengths(found: Verification) -> Markup:
    frame = Frame(LEFT + 6.0, TOP, WIDTH - EDGE, TOP + _HEIGHT)
    number = np.arange(1.0, len(found.points) + 1.0)
    sets = ((found.measured, Colour.SECOND), (found.deviation, Colour.ACCENT))
    top = max(float(one.length_um.max()) for one, _ in sets)
    top = max(top, found.tolerance_um or 0.0)
    x = frame.make_x(0.0, float(number[-1]) + 1.0)
    y = frame.make_y(0.0, 1.05 * top, margin=0.0)
    shapes: list[Markup] = []
    for one, colour in sets:
        half = K * one.length_sigma_um
        at, low = x.place(number), y.place(np.maximum(one.length_um - half, 0.0))
        high, middle = y.place(one.length_um + half), y.place(one.length_um)
        ends = np.column_stack([at, low]), np.column_stack([at, high])
        shapes.append(draw_segments(*ends, colour, width=0.7))
        dots = [f"M{a - 1.2:.2f} {b:.2f}h2.4" for a, b in zip(at, middle, strict=True)]
        shapes.append(draw_strokes(dots, colour, width=1.6))
    if found.tolerance_um is not None:
        limit = frame.draw_level(
            y, found.tolerance_um, Colour.INK, width=0.8, dash="4 2"
        )
        shapes.append(limit)
    legend = ((Colour.SECOND, "machine as it is"), (Colour.ACCENT, "less the result"))
    return draw_image(
        TOP + _HEIGHT + 28.0,
        "Length of the error at each place, as measured and less the prediction",
        [
            frame.draw_axes(x, y, "places in the order of measuring", "µm"),
            *shapes,
            draw_legend(frame, legend),
        ],
    )


def _draw_line(one: LineFigures) -> View:
    frame = Frame(LEFT + 6.0, TOP, WIDTH - EDGE, TOP + 0.8 * _HEIGHT)
    sides = ((one.forward_um, Colour.SECOND), (one.backward_um, Colour.THIRD))
    values: Sequence[float] = np.concatenate([one.forward_um, one.backward_um]).tolist()
    x = frame.make_x(float(one.position_mm[0]), float(one.position_mm[-1]), margin=0.02)
    y = frame.make_y(min(0.0, *values), max(0.0, *values))
    curves = [
        draw_curve(x.place(one.position_mm), y.place(value), colour)
        for value, colour in sides
    ]
    legend = ((Colour.SECOND, "+ direction"), (Colour.THIRD, "− direction"))
    figure = draw_image(
        TOP + 0.8 * _HEIGHT + 28.0,
        f"Deviation along the line of {one.axes}",
        [
            frame.draw_axes(x, y, "along the line, mm", "µm"),
            join_shapes(curves),
            draw_legend(frame, legend),
        ],
    )
    return {"name": one.axes, "figure": figure}
