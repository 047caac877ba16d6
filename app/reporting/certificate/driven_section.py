"""Lines and circles that a verification measured at standstills, by their standards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from truepath.app.reporting.certificate.language import Language
from truepath.app.reporting.templating import View
from truepath.app.results.circles_at_standstill import CIRCLE_FIGURES
from truepath.app.results.driven_figures import LINE_FIGURES

Row = tuple[str, ...]
Entry = Mapping[str, Any]


def describe_driven(content: Entry, language: Language) -> View:
    """Return the figures of ISO 230-2, -6 and -4; empty where none were measured.

    content : of a `verification/1`
    """
    lines: Sequence[Entry] = content.get("lines", ())
    circles: Sequence[Entry] = content.get("circles", ())
    return {
        "line_head": (language.say("driven_line"), *LINE_FIGURES),
        "lines": [
            row
            for one in lines
            for row in _list_rows(
                _name_line(one, language), one, LINE_FIGURES, language
            )
        ],
        "circle_head": (language.say("circle"), "G", "F max", "F min"),
        "circles": [
            row
            for one in circles
            for row in _list_rows(
                _name_circle(one, language), one, CIRCLE_FIGURES, language
            )
        ],
    }


def _name_line(one: Entry, language: Language) -> str:
    standard = str(one["standard"]).upper().replace("ISO-", "ISO ")
    return language.say(
        "driven_line_is", axes=one["axes"], standard=standard, runs=one["runs"]
    )


def _name_circle(one: Entry, language: Language) -> str:
    radius = language.number(one["radius_mm"], 0)
    return language.say("driven_circle_is", plane=one["plane"], radius=radius)


def _list_rows(
    name: str, one: Entry, figures: Sequence[str], language: Language
) -> Iterator[Row]:
    value, sigma, predicted = (
        one[key] for key in ("figures_um", "uncertainty_um", "predicted_um")
    )
    yield name, *(language.write_expanded(value[f], sigma[f]) for f in figures)
    yield (
        language.say("circle_predicted"),
        *(language.number(predicted[f]) if f in predicted else "—" for f in figures),
    )
