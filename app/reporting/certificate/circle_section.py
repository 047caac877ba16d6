"""Circles that a verification drove on the fly: polar charts, and their figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from truepath.app.reporting.certificate.language import Language
from truepath.app.reporting.certificate.picture import paint
from truepath.app.reporting.polar_figure import PolarWords, draw_polar_circles
from truepath.app.reporting.templating import View
from truepath.app.results.circle_figures import FIGURES

Row = tuple[str, ...]


def describe_circles(content: Mapping[str, Any], language: Language) -> View:
    """Return figure and table of the circles; empty where none were driven.

    content : of a `verification/1`; one of an earlier version has no centre to draw
        its circles about, and they are stated without a figure
    """
    circles: Sequence[Mapping[str, Any]] = content.get("circles_in_motion", ())
    missing: Sequence[int] = content.get("circles_missing", ())
    words = _choose_words(language)
    return {
        "figure": paint(draw_polar_circles(circles, words)),
        "head": (language.say("circle"), *map(words.name, FIGURES)),
        "rows": [row for one in circles for row in _list_rows(one, language)],
        "missing": language.say(
            "circles_missing", rows=", ".join(str(row + 1) for row in missing)
        )
        if missing
        else "",
    }


def _choose_words(language: Language) -> PolarWords:
    return PolarWords(
        *(
            language.own[f"circle_{name}"]
            for name in (
                "description",
                "heading",
                "counterclockwise",
                "clockwise",
                "predicted",
                "ring",
            )
        ),
        mark=language.mark,
    )


def _list_rows(one: Mapping[str, Any], language: Language) -> Iterator[Row]:
    heading = language.own["circle_heading"].format(
        plane=one["plane"],
        diameter=f"{one['diameter_mm']:g}",
        feed=f"{one['feed_mm_min']:g}",
    )
    stated = one["figures_um"], one["uncertainty_um"]
    predicted = one["predicted_um"], one["predicted_uncertainty_um"]
    yield language.mark(heading), *_write_figures(*stated, language)
    yield language.say("circle_predicted"), *_write_figures(*predicted, language)


def _write_figures(
    value: Mapping[str, float], sigma: Mapping[str, float], language: Language
) -> Iterator[str]:
    for name in FIGURES:
        known = name in value
        yield language.write_expanded(value[name], sigma[name]) if known else "—"
