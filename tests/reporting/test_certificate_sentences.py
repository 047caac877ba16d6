"""What a certificate says of a verification, in its own language."""

from __future__ import annotations

import re
from datetime import date
from types import SimpleNamespace

import numpy as np
import pytest

from truepath.answers.certificate.closing_sections import (
    describe_driven,
    describe_verification,
    say_decision,
    word_findings,
)
from truepath.answers.certificate.issue import Certificate, Source
from truepath.answers.certificate.language import load_language
from truepath.answers.verification.circles.circle_figures import (
    SECTORS,
    list_sector_angles,
)
from truepath.answers.verification.circles.polar_figure import (
    ENGLISH,
    draw_polar_circles,
)
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

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


@pytest.fixture
def issued():
    """A certificate with a verification, of which nothing else is asked."""

    def make(content):
        source = Source("v.json", content, "0" * 64)
        found = SimpleNamespace(input_sha256="")
        return Certificate(found, date(2026, 11, 24), verification=source)

    return make


@pytest.mark.parametrize(
    ("times", "cause", "words"),
    [
        (
            2.0,
            "wrong-sign",
            "Die Steuerung addiert die Kompensation mit falschem Vorzeichen",
        ),
        (1.0, "not-active", "Die Kompensation ist nicht aktiv"),
        (0.0, "active", "Eine Kompensation ist aktiv"),
    ],
)
def test_a_german_certificate_words_a_verification_in_german(times, cause, words):
    scale = {"value": times, "uncertainty": 0.01, "cause": cause}
    content = VERIFICATION | {"map_scale": scale}
    worst, agreement, said = word_findings(content, load_language("de"))
    assert "von 30 Stellen: 5,60 µm ± 0,40 µm" in worst
    assert "eine veränderte Maschine würde es erklären" in agreement
    assert words in said


def test_a_compensation_that_explains_all_sends_nobody_to_the_tracker():
    scale = {"value": 0.07, "uncertainty": 0.01, "cause": "active"}
    hopeless = AGREEMENT | {"chance_of_any_machine": 0.0}
    content = VERIFICATION | {"agreement": hopeless}
    _, tracker = word_findings(content, load_language("de"))
    _, control, _ = word_findings(content | {"map_scale": scale}, load_language("de"))
    assert "Prüfen Sie zuerst Tracker und Reflektor" in tracker
    assert "Tracker" not in control
    assert "Die Kompensation der Steuerung ist anders als angegeben" in control


def test_what_lines_leave_unseen_is_said_in_german():
    across = {"components": "three at standstills, the two across the travel on lines"}
    content = VERIFICATION | across | {"unseen_directions": ["X"]}
    _, across, unseen, _ = word_findings(content, load_language("de"))
    assert "quer zur Fahrt" in across
    assert unseen.startswith("Längs X wurde nichts gemessen")


def test_a_line_has_one_name_in_german():
    language = load_language("de")
    texts = {**language.own, **language.shared}
    other = {key for key, text in texts.items() if re.search(r"\bLinien?\b", text)}
    assert not other


def test_air_and_scale_of_a_verification_are_said_in_german():
    air = Reason("air-uncorrected", "doubtful", {"why": "no pressure"})
    content = VERIFICATION | {
        "run_verdict": verdict_json(Verdict((air,))),
        "runs": [{"length_scale_ppm": 270.0}, {"length_scale_ppm": 270.0}],
    }
    _, uncorrected, _, scale = word_findings(content, load_language("de"))
    assert uncorrected.startswith("Die Strecken des Trackers sind nicht um die Luft")
    assert "270,00 ppm" in scale


def test_a_scale_as_expected_is_not_commented():
    scale = {"value": 0.0, "uncertainty": 0.01, "cause": None}
    expected = VERIFICATION | {"map_scale": scale}
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


NUMBERS = {
    "agreement": AGREEMENT | {"chi_square": 110.04, "freedom": 84},
    "volumetric_error_um": {
        "measured": {
            f"{name}{end}": 0.5
            for name in ("mean", "p95", "largest")
            for end in ("", "_uncertainty")
        }
    },
}


def test_numbers_of_a_verification_are_in_words_and_not_in_keys_of_its_file(issued):
    view = describe_verification(issued(VERIFICATION | NUMBERS), load_language("de"))
    assert [row[0] for row in view["lengths"]] == ["An der Maschine gemessen"]
    assert view["lengths"][0][1] == "0,5 ± 1,0"
    rows = dict(view["rows"])
    assert rows["Toleranz an jeder Stelle"] == "5,00 µm"
    assert rows["Übereinstimmung, χ²"].startswith("110,0 bei 84 Freiheitsgraden")


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


FIGURES_UM = {"H": 3.2, "G": 12.5, "F_max": 6.5, "F_min": -6.0}
ANGLE = np.radians(list_sector_angles())
SENSES = {
    "counterclockwise": 4.0 * np.cos(2 * ANGLE) + 9.0 * np.cos(ANGLE),
    "clockwise": 4.0 * np.cos(2 * ANGLE) + 9.0 * np.cos(ANGLE),
}
CIRCLE = {
    "plane": "ZX",
    "diameter_mm": 230.4,
    "feed_mm_min": 3000.0,
    "angle_deg": list_sector_angles().tolist(),
    "radial_um": {name: one.tolist() for name, one in SENSES.items()},
    "predicted_radial_um": {name: [0.0] * SECTORS for name in SENSES},
    "centre_um": {"measured": [9.0, 0.0], "predicted": [0.0, 0.0]},
    "figures_um": FIGURES_UM,
    "uncertainty_um": dict.fromkeys(FIGURES_UM, 0.9),
    "predicted_um": FIGURES_UM,
    "predicted_uncertainty_um": dict.fromkeys(FIGURES_UM, 0.2),
}
CIRCLES = {"circles_in_motion": [CIRCLE], "circles_missing": [9]}


def test_circles_of_a_verification_are_drawn_and_stated_in_the_certificate(issued):
    content = VERIFICATION | NUMBERS | CIRCLES
    view = describe_verification(issued(content), load_language("de"))["circles"]
    heading, h, g, *_ = view["rows"][0]
    assert heading == "ZX, Durchmesser 230,4 mm, 3000 mm/min"
    assert (h, g) == ("3,2 ± 1,8", "12,5 ± 1,8")
    assert view["rows"][1][0] == "vorhergesagt"
    assert "Zeilen des Plans" in view["missing"]
    assert view["missing"].endswith(": 10.")
    for text in ("+Z", "+X", "H 3,2 ± 1,8 µm", "Ringabstand 2 µm", "F min −6,0"):
        assert text in view["figure"]


def test_a_circle_is_drawn_about_its_own_centre_on_rings_that_bear_its_numbers():
    figure = str(draw_polar_circles([CIRCLE], ENGLISH))
    curves = re.findall(r'd="M([\d. L]+)Z"', figure)
    points = np.array([pair.split() for pair in curves[-1].split("L")], float)
    assert len(points) == SECTORS
    rings = re.findall(r"M([\d.]+) ([\d.]+)a([\d.]+)", figure)
    left, level, nominal = map(float, rings[-1])  # drawn last, and darker
    radii = sorted({float(ring[2]) for ring in rings})
    per_um = (radii[1] - radii[0]) / 2.0
    out = np.linalg.norm(points - [left + nominal, level], axis=1)
    expected = nominal + per_um * 4.0 * np.cos(2 * ANGLE)
    assert np.allclose(out, expected, atol=0.02)


def test_circles_of_an_earlier_version_are_stated_without_a_figure(issued):
    earlier = {key: value for key, value in CIRCLE.items() if key != "centre_um"}
    content = VERIFICATION | NUMBERS | {"circles_in_motion": [earlier]}
    view = describe_verification(issued(content), load_language("en"))["circles"]
    assert view["figure"] == ""
    assert len(view["rows"]) == 2


LINE = {
    "axes": "X",
    "standard": "iso-230-2",
    "runs": 5,
    "figures_um": {"A": 13.4, "E": 12.9, "R": 6.8, "B": 4.2, "M": 9.0},
    "uncertainty_um": {"A": 3.4, "E": 0.7, "R": 3.3, "B": 0.6, "M": 0.5},
    "predicted_um": {"E": 11.9, "B": 2.7, "M": 9.1},
}
STANDING = {
    "plane": "YZ",
    "radius_mm": 153.6,
    "figures_um": {"G": 12.5, "F_max": 13.2, "F_min": -0.5},
    "uncertainty_um": {"G": 4.0, "F_max": 2.5, "F_min": 2.5},
    "predicted_um": {"G": 11.5, "F_max": 10.2, "F_min": -1.3},
}


def test_a_certificate_states_the_figures_that_a_verification_ran_for():
    driven = describe_driven(
        {"lines": [LINE], "circles": [STANDING]}, load_language("de")
    )
    measured, predicted = driven["lines"]
    assert measured[0] == "X (ISO 230-2), 5 Läufe"
    assert measured[1:] == (
        "13,4 ± 6,8",
        "12,9 ± 1,4",
        "6,8 ± 6,6",
        "4,2 ± 1,2",
        "9,0 ± 1,0",
    )
    assert predicted == ("vorhergesagt", "—", "11,9", "—", "2,7", "9,1")
    assert driven["circles"][0][:2] == ("YZ, Radius 154 mm", "12,5 ± 8,0")


def test_a_verification_by_scattered_points_states_no_figures_of_standards():
    driven = describe_driven({}, load_language("en"))
    assert driven["lines"] == driven["circles"] == []


def test_a_number_below_nought_has_a_true_minus_sign_and_a_date_keeps_its_hyphens():
    german = load_language("de")
    assert german.mark("um -493.4 µm, am 2026-11-25") == "um −493,4 µm, am 2026-11-25"
