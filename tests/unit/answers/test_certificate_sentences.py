"""What a certificate says, in its own language."""

import functools
import inspect
import operator
import re
from datetime import date
from types import SimpleNamespace

import numpy as np
import pytest

from sentences_of_the_service import ENGLISH, list_unobservable
from truepath.answers.certificate import issue, measurement_sections
from truepath.answers.certificate.closing_sections import (
    describe_decision,
    describe_iso_figures,
    describe_verification,
    translate_findings,
)
from truepath.answers.certificate.figures import draw_histograms
from truepath.answers.certificate.language import load_language
from truepath.answers.certificate.result_sections import describe_brief
from truepath.answers.verification import circle_figures, polar_figure
from truepath.estimation.problem import observability
from truepath.estimation.problem.observability import PoorlyObservableShape
from truepath.files.earlier.result_file import KnownLengthsFile
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

MEASURED = {"conformity": "outside", "length_um": 5.6, "expanded_uncertainty_um": 0.4}
MEASURED |= {"coverage_factor": 3.2, "tolerance_um": 5.0}
AGREEMENT = {"consistent": False, "chance": 0.001, "share_within_expanded": 0.8}
AGREEMENT |= {"chance_of_any_machine": 0.03}
VERIFICATION = {"statements": ["The machine fails."], "compensated": True}
VERIFICATION |= {"places": {"row": list(range(30))}, "map_scale": None}
VERIFICATION |= {"conformity": {"measured": MEASURED}, "agreement": AGREEMENT}
GERMAN, BRITISH = load_language("de"), load_language("en")
WRONG_SIGN = "Die Steuerung addiert die Kompensation mit falschem Vorzeichen"
U = ("", "_uncertainty")
LENGTHS = [f"{name}{u}" for name in ("mean", "p95", "largest") for u in U]
NUMBERS = {
    "agreement": AGREEMENT | {"chi_square": 110.04, "freedom": 84},
    "volumetric_error_um": {"measured": dict.fromkeys(LENGTHS, 0.5)},
}
FIGURES_UM = {"H": 3.2, "G": 12.5, "F_max": 6.5, "F_min": -6.0}
ANGLE = np.radians(circle_figures.list_sector_angles())
RADIAL_UM = (4.0 * np.cos(2 * ANGLE) + 9.0 * np.cos(ANGLE)).tolist()
SENSES = ("counterclockwise", "clockwise")
CIRCLE = {"plane": "ZX", "diameter_mm": 230.4, "feed_mm_min": 3000.0}
CIRCLE |= {
    "angle_deg": circle_figures.list_sector_angles().tolist(),
    "radial_um": dict.fromkeys(SENSES, RADIAL_UM),
    "predicted_radial_um": dict.fromkeys(SENSES, [0.0] * circle_figures.SECTORS),
    "centre_um": {"measured": [9.0, 0.0], "predicted": [0.0, 0.0]},
    "figures_um": FIGURES_UM,
    "uncertainty_um": dict.fromkeys(FIGURES_UM, 0.9),
    "predicted_um": FIGURES_UM,
    "predicted_uncertainty_um": dict.fromkeys(FIGURES_UM, 0.2),
}
CIRCLES = {"circles_in_motion": [CIRCLE], "circles_missing": [9]}
LINE = {"axes": "X", "standard": "iso-230-2", "runs": 5}
LINE |= {
    "figures_um": {"A": 13.4, "E": 12.9, "R": 6.8, "B": 4.2, "M": 9.0},
    "uncertainty_um": {"A": 3.4, "E": 0.7, "R": 3.3, "B": 0.6, "M": 0.5},
    "predicted_um": {"E": 11.9, "B": 2.7, "M": 9.1},
}
STANDING = {"plane": "YZ", "radius_mm": 153.6}
STANDING |= {
    "figures_um": {"G": 12.5, "F_max": 13.2, "F_min": -0.5},
    "uncertainty_um": {"G": 4.0, "F_max": 2.5, "F_min": 2.5},
    "predicted_um": {"G": 11.5, "F_max": 10.2, "F_min": -1.3},
}
MERGED = (
    "ECZ (roll of Z) is not distinguishable from EXZ and EYZ with one tool length; a "
    "second target at least 180 mm to the side, in X or Y, separates them (to 3.4 "
    "µrad, k = 2, on the same path)"
)


def describe(*more):
    content = functools.reduce(operator.or_, more, VERIFICATION)
    source = issue.Source("v.json", content, "0" * 64)
    found = SimpleNamespace(input_sha256="")
    issued = issue.Certificate(found, date(2026, 11, 24), verification=source)
    return describe_verification(issued, GERMAN)


def german(**more):
    return translate_findings(VERIFICATION | more, GERMAN)


@pytest.mark.parametrize(
    ("times", "cause", "words"),
    [
        (2.0, "wrong-sign", WRONG_SIGN),
        (1.0, "not-active", "Die Kompensation ist nicht aktiv"),
        (0.0, "active", "Eine Kompensation ist aktiv"),
    ],
)
def test_a_german_certificate_words_a_verification_in_german(times, cause, words):
    scale = {"value": times, "uncertainty": 0.01, "cause": cause}
    worst, agreement, said = german(map_scale=scale)
    assert "von 30 Stellen: 5,60 µm ± 0,40 µm" in worst
    assert "eine veränderte Maschine würde es erklären" in agreement
    assert words in said
    assert len(german(map_scale=scale | {"cause": None})) == 2  # as expected


def test_a_compensation_that_explains_all_sends_nobody_to_the_tracker():
    scale = {"value": 0.07, "uncertainty": 0.01, "cause": "active"}
    hopeless = AGREEMENT | {"chance_of_any_machine": 0.0}
    _, tracker = german(agreement=hopeless)
    _, control, _ = german(agreement=hopeless, map_scale=scale)
    assert "Prüfen Sie zuerst Tracker und Reflektor" in tracker
    assert "Tracker" not in control
    assert "Die Kompensation der Steuerung ist anders als angegeben" in control


def test_unseen_directions_air_and_scale_are_said_in_german_with_u():
    across = "three at standstills, the two across the travel on lines"
    _, said, unseen, _ = german(components=across, unseen_directions=["X"])
    assert "quer zur Fahrt" in said
    assert unseen.startswith("Längs X wurde nichts gemessen")
    air = Reason("air-uncorrected", "doubtful", {"why": "no pressure"})
    judged, runs = verdict_json(Verdict((air,))), [{"length_scale_ppm": 270.0}] * 2
    _, uncorrected, _, scale = german(run_verdict=judged, runs=runs)
    assert uncorrected.startswith("Die Strecken des Trackers sind nicht um die Luft")
    assert "540,00 ppm (k = 2)" in scale
    figure = {"value_um": 5.0, "uncertainty_um": 0.2}
    spread = dict.fromkeys(("mean", "p95", "largest"), figure)
    known = KnownLengthsFile(count=3, off_ppm=-61.5, uncertainty_ppm=0.7)
    volume = {"before": spread, "after_expected": spread}
    result = SimpleNamespace(length_scale_ppm=0.8, known_lengths=known)
    found = SimpleNamespace(content={"volumetric_error": volume}, result=result)
    note = describe_brief(SimpleNamespace(found=found, left=None), GERMAN)["scale_note"]
    assert "bekannte Längen fest (3)" in note
    assert "um −61,50 ppm zu lang, mit U = 1,40 ppm" in note


def test_a_prediction_and_circles_that_differ_from_it_are_said_in_german():
    more = {"conformity": {"deviation": MEASURED}}
    apart = {"H": {"within": False}, "G_clockwise": {"within": False}}
    circle = CIRCLE | {"difference_um": apart, "driven_feed_mm_min": {SENSES[0]: 2500}}
    prediction, _, unlike, feed = german(**more, circles_in_motion=[circle])
    assert prediction.startswith("Das Ergebnis als Vorhersage der Maschine: Nicht best")
    assert ": Das Ergebnis sagt H, G im Uhrzeiger nicht im Rahmen" in unlike
    assert feed.startswith(
        "ZX, Durchmesser 230,4 mm, 3000 mm/min: Gemessen mit: gegen "
    )


def test_numbers_stand_in_words_with_a_true_minus_and_what_states_less_is_quoted():
    view = describe(NUMBERS)
    assert [row[0] for row in view["lengths"]] == ["An der Maschine gemessen"]
    assert view["lengths"][0][1] == "0,5 ± 1,0"
    rows = dict(view["rows"])
    assert rows["Toleranz an jeder Stelle"] == "5,00 µm"
    assert rows["Übereinstimmung, χ²"].startswith("110,0 bei 84 Freiheitsgraden")
    texts = {**GERMAN.own, **GERMAN.shared}
    assert not [key for key, text in texts.items() if re.search(r"\bLinien?\b", text)]
    said = GERMAN.localise_numbers("um -493.4 µm, am 2026-11-25")
    assert said == "um −493,4 µm, am 2026-11-25"
    quoted = ["The machine fails."]
    assert translate_findings(VERIFICATION, BRITISH) == quoted
    assert german(conformity={"measured": {"k": 2}}) == quoted


@pytest.mark.parametrize("decision", ["within", "outside", "undecided"])
def test_a_decision_says_whether_the_compensation_was_active(decision):
    more = {"conformity": {"measured": MEASURED | {"conformity": decision}}}
    for language, words in ((BRITISH, "compensation active"), (GERMAN, "aktiver Komp")):
        for active in (True, False):
            content = VERIFICATION | more | {"compensated": active}
            assert (words in describe_decision(content, language)) == active


def test_lengths_before_and_after_are_drawn_on_one_scale():
    before, after = np.linspace(1.0, 400.0, 100), np.linspace(0.1, 20.0, 100)
    drawn = draw_histograms([("as found", before), ("left", after)], BRITISH)
    assert drawn.count(">400<") == 2


def test_circles_of_a_verification_are_drawn_and_stated_in_the_certificate():
    view = describe(NUMBERS, CIRCLES)["circles"]
    heading, h, g, *_ = view["rows"][0]
    assert heading == "ZX, Durchmesser 230,4 mm, 3000 mm/min"
    assert (h, g) == ("3,2 ± 1,8", "12,5 ± 1,8")
    assert view["rows"][1][0] == "vorhergesagt"
    assert "Zeilen des Plans" in view["missing"]
    assert view["missing"].endswith(": 10.")
    for text in ("+Z", "+X", "H 3,2 ± 1,8 µm", "Ringabstand 2 µm", "F min −6,0"):
        assert text in view["figure"]
    earlier = {key: value for key, value in CIRCLE.items() if key != "centre_um"}
    view = describe(NUMBERS, {"circles_in_motion": [earlier]})["circles"]
    assert view["figure"] == ""
    assert len(view["rows"]) == 2


def test_a_circle_is_drawn_about_its_own_centre_on_rings_that_bear_its_numbers():
    figure = str(polar_figure.draw_polar_circles([CIRCLE], polar_figure.ENGLISH))
    curves = re.findall(r'd="M([\d. L]+)Z"', figure)
    points = np.array([pair.split() for pair in curves[-1].split("L")], float)
    assert len(points) == circle_figures.SECTORS
    rings = re.findall(r"M([\d.]+) ([\d.]+)a([\d.]+)", figure)
    left, level, nominal = map(float, rings[-1])  # drawn last, and darker
    radii = sorted({float(ring[2]) for ring in rings})
    per_um = (radii[1] - radii[0]) / 2.0
    out = np.linalg.norm(points - [left + nominal, level], axis=1)
    expected = nominal + per_um * 4.0 * np.cos(2 * ANGLE)
    assert np.allclose(out, expected, atol=0.02)


def test_a_certificate_states_the_figures_that_a_verification_ran_for():
    driven = describe_iso_figures({"lines": [LINE], "circles": [STANDING]}, GERMAN)
    measured, predicted = driven["lines"]
    assert measured[0] == "X (ISO 230-2), 5 Läufe"
    figures = ("13,4 ± 6,8", "12,9 ± 1,4", "6,8 ± 6,6", "4,2 ± 1,2", "9,0 ± 1,0")
    assert measured[1:] == figures
    assert predicted == ("vorhergesagt", "—", "11,9", "—", "2,7", "9,1")
    assert driven["circles"][0][:2] == ("YZ, Radius 154 mm", "12,5 ± 8,0")
    scattered = describe_iso_figures({}, BRITISH)  # points of no standard
    assert scattered["lines"] == scattered["circles"] == []


def list_poor():
    source = inspect.getsource(observability.describe_form)
    shapes = set(re.findall(r"\ban? (?:slope|bow|wave)\b|\ban S\b", source))
    assert len(shapes) == 4
    whats = ("error", "turning")
    forms = [f"{shape} of the {what} along X" for shape in shapes for what in whats]
    for form in (*forms, "the angle"):
        for symbols in (("EXX",), ("EXX", "C0Y"), ("EXX", "EYX", "EZX", "EAX", "EBX")):
            yield str(PoorlyObservableShape(symbols, 0.73, 2.4e-3, form))


@pytest.mark.parametrize(
    ("say", "texts"),
    [
        (measurement_sections.describe_unobservable, sorted(set(list_unobservable()))),
        (measurement_sections.describe_poorly_observable, sorted(set(list_poor()))),
    ],
)
def test_no_statement_of_a_limit_stays_english_in_a_german_certificate(say, texts):
    assert len(texts) > 10
    for text in texts:
        said = say(text, GERMAN)
        left = set(re.findall(r"\w+", said.lower())) & (ENGLISH | {"turning", "along"})
        assert not left, f"{text!r} is said as {said!r}"
        assert say(text, BRITISH) == text
    assert say("EXX is unsure", GERMAN) == "EXX is unsure", "of another version"


def test_numbers_of_a_statement_stand_in_its_german_words():
    said = measurement_sections.describe_unobservable(MERGED, GERMAN)
    form = "an S of the error along X"
    poor = str(PoorlyObservableShape(("EXX", "C0Y"), 0.73, 2.4e-3, form))
    assert "ECZ (Rollen von Z) ist mit diesen Daten nicht von EXZ und EYZ " in said
    assert "mindestens 180 mm seitlich" in said
    assert "auf 3,4 µrad bekannt (k = 2)" in said
    said = measurement_sections.describe_poorly_observable(poor, GERMAN)
    assert "EXX zusammen mit C0Y: ein S-förmiger Verlauf der Abweichung" in said
    assert "73 % dessen" in said
    assert "4,8 µm (k = 2)" in said
    earlier = poor.replace("4.8 µm at the tool (k = 2)", "2.4 µm at the tool (k = 1)")
    assert measurement_sections.describe_poorly_observable(earlier, GERMAN) == said
    assert measurement_sections.describe_poorly_observable(earlier, BRITISH) == poor
