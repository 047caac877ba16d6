"""What a certificate says of a verification, in its own language."""

from __future__ import annotations

import pytest

from truepath.app.reporting.certificate.closing_sections import (
    say_decision,
    word_findings,
)
from truepath.app.reporting.certificate.language import load_language

MEASURED = {
    "conformity": "outside",
    "length_um": 5.6,
    "expanded_uncertainty_um": 0.4,
    "coverage_factor": 3.2,
    "tolerance_um": 5.0,
}
AGREEMENT = {
    "consistent": False,
    "chance": 0.001,
    "share_within_expanded": 0.8,
    "chance_of_any_machine": 0.03,
}
VERIFICATION = {
    "statements": ["The machine fails."],
    "compensated": True,
    "places": {"row": list(range(30))},
    "conformity": {"measured": MEASURED},
    "agreement": AGREEMENT,
    "map_scale": None,
}


@pytest.mark.parametrize(
    ("times", "is_compensated", "words"),
    [
        (2.0, True, "Die Steuerung addiert die Kompensation mit falschem Vorzeichen"),
        (1.0, True, "Die Kompensation ist nicht aktiv"),
        (0.0, False, "Eine Kompensation ist aktiv"),
    ],
)
def test_a_german_certificate_words_a_verification_in_german(
    times, is_compensated, words
):
    scale = {"value": times, "uncertainty": 0.01}
    content = VERIFICATION | {"map_scale": scale, "compensated": is_compensated}
    worst, agreement, cause = word_findings(content, load_language("de"))
    assert "von 30 Stellen: 5,60 µm ± 0,40 µm" in worst
    assert "eine veränderte Maschine würde es erklären" in agreement
    assert words in cause


def test_a_scale_as_expected_is_not_commented():
    expected = VERIFICATION | {"map_scale": {"value": 0.0, "uncertainty": 0.01}}
    assert len(word_findings(expected, load_language("de"))) == 2


@pytest.mark.parametrize(
    ("language", "content"),
    [
        ("en", VERIFICATION),
        ("de", VERIFICATION | {"conformity": {"measured": {"k": 2}}}),
    ],
)
def test_a_file_that_states_less_is_quoted(language, content):
    assert word_findings(content, load_language(language)) == ["The machine fails."]


@pytest.mark.parametrize("decision", ["within", "outside", "undecided"])
@pytest.mark.parametrize(
    ("language", "words"), [("en", "compensation active"), ("de", "aktiver Komp")]
)
def test_a_decision_says_whether_the_compensation_was_active(decision, language, words):
    conformity = {"measured": MEASURED | {"conformity": decision}}
    content = VERIFICATION | {"conformity": conformity}
    with_it, without = (
        say_decision(content | {"compensated": active}, load_language(language))
        for active in (True, False)
    )
    assert words in with_it
    assert words not in without
