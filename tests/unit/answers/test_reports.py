"""The reports: whole, self-contained, and honest about what they do not know."""

import csv
import html
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from results_fixtures import THREE_TARGETS, as_loaded, change_run
from truepath.answers.calibration_report import (
    render_calibration_report,
    render_section,
)
from truepath.answers.discovery import ASK, discover_runs
from truepath.answers.discovery_report import (
    render_discovery_report,
    write_discovery,
)
from truepath.answers.shown.page import format_expanded, format_number
from truepath.discovery.discrimination import DiscriminationDesign, Question
from truepath.estimation.problem.prior_model import read_prior_model
from truepath.files.earlier.result_file import result_from_json
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath.planning.default_path import default_path
from truepath.planning.grade import grade
from truepath.results import error_tables, prediction
from truepath.results.error_tables import build_error_tables
from truepath.results.grade_json import format_text, grade_json
from truepath.results.result_json import result_json
from truepath.results.result_summary import group_residuals, state_findings, state_noise
from truepath.results.updated_effects import describe_use
from truepath_simulators.hidden.setup import SetupStep
from truepath_simulators.worlds.synthetic import Setting

VOID = {"input", "meta", "br", "img", "link", "hr", "path", "use"}
LEFT_OUT = Reason("spikes-left-out", "usable", {"samples": 3, "distance_um": 90.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})
STATION_MM = np.array([900.0, 100.0, -200.0])
MEASURED = {"X": (-100.0, 300.0), "Y": (10.0, 300.0), "Z": (20.0, 290.0)}
WEAK = "EZZ together with B0Z: a bow of the error along Z is poorly observable; …"


class Outline(HTMLParser):
    """Text and tags of a page; every tag that opens has to close."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open, self.texts, self.tags, self.addresses = [], [], set(), []
        self.feed(page)
        assert self.open == []
        self.text = re.sub(r"\s+", " ", " ".join(self.texts))

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href") and v]

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def page(found):
    return render_calibration_report(found)


@pytest.fixture(scope="module")
def outline(page):
    return Outline(page)


def test_the_page_needs_only_itself_and_figures_take_its_colours(found, page, outline):
    assert {"script", "link", "img", "iframe"}.isdisjoint(outline.tags)
    assert outline.addresses == []
    assert "url(http" not in page
    assert "@import" not in page
    named = set(re.findall(r"https?://[^\"' )]+", page))
    assert named <= {"http://www.w3.org/1999/xlink", "http://www.w3.org/2000/svg"}
    assert render_calibration_report(found) == page
    svg = page[page.index("<svg") :]
    assert "var(--accent)" in svg
    assert not [one for one in ("#0101", "#000000", "DejaVu") if one in svg]
    used = set(re.findall(r"var\(--([a-z-]+)\)", page))
    assert used <= set(re.findall(r"--([a-z-]+):", page))


def test_errors_figures_and_provenance_stand_in_it(found, outline):
    for words in (
        *("EXX", "EYX", "ECX", "EAY", "EZZ", "C0Y", "B0Z", "A0Z"),
        *("straightness of X in Y", "roll of X", "squareness of Z to Y"),
        *("truepath 9.9", "monday.zip", "0" * 64, "2026-03-07", "2,500 to", "k = 2"),
        "It has not been measured",  # what is expected
    ):
        assert words in outline.text
    for spread in (found.volumetric.before, found.volumetric.after):
        for figure in (spread.mean, spread.p95, spread.largest):
            stated = format_expanded(figure.value_um, figure.uncertainty_um)
            assert stated in outline.text


def test_what_cannot_be_told_is_said_in_words(estimate, outline, construct, provenance):
    assert estimate.observability.unobservable
    for statement in estimate.observability.unobservable:
        assert statement in outline.text
    assert "hold for the measured target offset only" in outline.text
    assert outline.text.count("not observable") >= 2 * 4
    all_told = state_findings(construct(THREE_TARGETS), provenance)
    assert "all error motions were identified" in render_section("limits", all_told)
    text = Outline(render_section("error_motions", all_told)).text
    assert "hold for any tool" in text
    assert "not observable" not in text


def test_residuals_above_the_noise_are_a_warning(estimate, provenance):
    def render(rms_mm):
        residuals = replace(estimate.runs[0].residuals, rms_mm=rms_mm, floor_mm=1e-3)
        found = state_findings(change_run(estimate, residuals=residuals), provenance)
        return render_section("residuals", found)

    assert "explains the measurement to its noise" in render(1e-3)
    assert "3.0 times the noise. The model lacks an effect" in render(3e-3)
    assert 'class="callout warn"' in render(3e-3)


def test_a_standstill_run_speaks_of_points(estimate, provenance):
    points = {"mode": "standstill", "feed_mm_min": None, "temperature_degc": {}}
    run = replace(provenance.runs[0], **points)
    at_rest = state_findings(estimate, replace(provenance, runs=(run,)))
    assert "measured at standstill" in render_calibration_report(at_rest)
    text = render_section("machine", at_rest)
    assert "12 points" in text
    assert "mm/min" not in text
    assert "Temperature" not in text
    residuals = render_section("residuals", at_rest)
    assert "Residual by point" in residuals
    assert "travel" not in residuals
    assert "timing" not in render_section("documentation", at_rest)


def test_one_feed_is_one_number_and_across_is_named(estimate, provenance, across_only):
    run = replace(provenance.runs[0], feed_mm_min=(2500.0, 2500.0))
    found = state_findings(estimate, replace(provenance, runs=(run,)))
    assert "on the fly at 2,500 mm/min" in render_section("machine", found)
    found = state_findings(across_only, provenance)
    assert "across the travel only" in render_section("documentation", found)
    assert "along the travel was not used" in render_section("residuals", found)
    run = across_only.runs[0]
    lines = group_residuals(run, across_only=True)
    square = run.residuals.across_mm.reshape(len(lines.row), -1) ** 2
    assert lines.rms_um == pytest.approx(1e3 * np.sqrt(square.mean(axis=1) / 3))


def test_names_cannot_smuggle_markup_into_the_page(estimate, provenance):
    evil = "<script>alert(1)</script>"
    machine = replace(estimate.model.machine, name=evil)
    model = replace(estimate.model, machine=machine)
    run = replace(provenance.runs[0], name=evil, source={evil: evil})
    named = replace(estimate, model=model), replace(provenance, runs=(run,))
    page = render_calibration_report(state_findings(*named))
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_an_axis_of_which_nothing_is_known_has_no_values(estimate, provenance):
    model = estimate.model
    kept = tuple(e for e in model.effects if not re.fullmatch("E.Z", e.name))
    rows = np.concatenate([np.r_[model.slices[e.name]] for e in kept])
    told = estimate.theta[rows], estimate.covariance[np.ix_(rows, rows)]
    fewer = replace(model, effects=kept)
    thin = replace(estimate, model=fewer, theta=told[0], covariance=told[1])
    found = state_findings(thin, provenance)
    text = Outline(render_section("error_motions", found)).text
    assert "Values of axis X" in text
    assert "Values of axis Z" not in text
    nothing = 0.0 * estimate.theta, 0.0 * estimate.covariance
    perfect = replace(estimate, theta=nothing[0], covariance=nothing[1])
    Outline(render_section("volume", state_findings(perfect, provenance)))


def test_noise_is_stated_at_the_distance_of_the_tool(estimate):
    noise = state_noise(estimate.runs[0])
    tracker = estimate.model.machine.tracker
    stated = 1e3 * tracker.sigma_mm(np.array([noise.distance_mm]))[0]
    assert 500.0 < noise.distance_mm < 2000.0
    assert noise.white_um == pytest.approx(stated * [1.1, 0.9])
    assert noise.ou_um == pytest.approx(stated * [0.2, 0.3])
    assert noise.along_travel_um == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("value", "standard", "text"),
    [
        (12.3456, 0.5, "12.3 ± 1.0"),
        (12.3456, 0.05, "12.35 ± 0.10"),
        (-0.04, 0.2, "−0.04 ± 0.40"),
        (1234.5, 60.0, "1234 ± 120"),
        (0.123456, 1e-9, "0.123 ± 0.000"),
        (3.0, 0.0, "3.0 ± 0.0"),
    ],
)
def test_an_uncertainty_has_two_digits_and_the_value_its_places(value, standard, text):
    assert format_expanded(value, standard) == text
    assert format_number(-0.0004, 2) == "0.00"


def judged(found, *reasons):
    return render_calibration_report(replace(found, verdict=Verdict(reasons)))


def test_a_result_that_is_not_to_be_used_begins_with_that(found, page):
    judged_page = judged(found, LEFT_OUT, BEYOND)
    band = judged_page.index('class="verdict not-usable" role="alert"')
    places = ["<strong>Not to be used</strong>", str(BEYOND), str(LEFT_OUT)]
    order = [judged_page.index(one) for one in (*places, 'class="tile ')]
    assert [band, *order] == sorted([band, *order])
    assert f'class="grave">{BEYOND}' in judged_page
    quiet = judged(found, LEFT_OUT)
    assert 'class="verdict usable" role="note"' in quiet
    assert str(LEFT_OUT) in quiet
    assert 'class="grave"' not in quiet
    assert 'class="verdict' not in page  # which has nothing to say
    evil = "<script>alert(1)</script>"
    assert evil not in judged(found, Reason("stated", "doubtful", {"text": evil}))


@pytest.fixture(scope="module")
def partly(estimate):
    seen = replace(estimate.observability, poorly_observable=(WEAK,))
    return replace(estimate, measured=MEASURED, observability=seen)


@pytest.fixture(scope="module")
def graded(partly, provenance):
    machine = partly.model.machine
    poor = grade(machine, default_path(machine, lines=5), station_mm=STATION_MM)
    return state_findings(partly, provenance, None, poor)


def test_every_extrapolated_value_is_marked_in_csv_and_result_and_found_again(graded):
    text = error_tables.error_tables_csv(graded.tables, graded.verdict)
    rows = list(csv.DictReader(io.StringIO(text)))
    for row in rows:
        beyond = ""
        if row["position_mm"]:
            low, high = MEASURED[row["error"][2]]
            beyond = str(int(not low <= float(row["position_mm"]) <= high))
        assert row["extrapolated"] == beyond
    assert {row["extrapolated"] for row in rows} == {"0", "1", ""}
    content = json.loads(json.dumps(result_json(graded)))
    table = content["error_tables"]["EYX"]
    beyond = np.array(table["position_mm"]) < -100.0
    assert table["extrapolated"] == beyond.tolist()
    assert content["measured_range"]["Z"] == {"from_mm": 20.0, "to_mm": 290.0}
    loaded = result_from_json(content)
    assert loaded.measured == MEASURED
    again = build_error_tables(loaded, loaded.measured).table("EYX")
    assert again.extrapolated.tolist() == beyond.tolist()
    del content["measured_range"]
    assert result_from_json(content).measured == {}
    assert not build_error_tables(loaded, {}).table("EYX").extrapolated.any()


def test_the_report_states_grade_remedy_weak_shapes_and_extrapolation(graded, found):
    assert result_json(graded)["observability"]["weak"] == [WEAK]
    page = render_calibration_report(graded)
    assert f"Grade of the set-up: <strong>{graded.grade.number:.2f}" in page
    assert graded.grade.weakest[0].remedy.text in page
    for words in ("EZZ together with B0Z", "X -200 to -100 mm", "Z 290 to 310 mm"):
        assert words in page.replace("−", "-")
    assert result_json(found)["grade"] is None
    assert "Grade of the set-up" not in render_calibration_report(found)
    said = format_text(graded.grade)
    assert said.startswith(f"{graded.grade.number:.2f}, {graded.grade.verdict}: ")
    assert f"which makes it {graded.grade.improved:.2f}." in said
    content = grade_json(graded.grade)
    remedy = content["weakest"][0]["remedy"]
    assert remedy.startswith(("add a line ", "add the diagonal "))
    assert content["thresholds"] == {"good": 0.25, "usable": 1.0}
    expanded = 2 * content["expected_uncertainty_um"]
    assert f"expected are {expanded:.1f} µm (k = 2)" in said


def test_prediction_warns_of_points_far_beyond_what_was_measured(partly):
    loaded = replace(as_loaded(partly), measured=MEASURED)
    inside, far = [0.0, 100.0, 100.0], [-190.0, 100.0, 100.0]
    (said,) = prediction.predict(loaded, np.array([inside, far])).warnings
    assert said.startswith("1 of 2 points lie in the travel but far beyond what was")
    assert prediction.predict(loaded, np.array([inside])).warnings == ()


@pytest.fixture(scope="module")
def knocked(record):
    setting = Setting(hidden=(SetupStep(20.0, (4.0, -3.0, 0.0)),))
    return discover_runs([record(11, rows=40, travel_mm=150.0, setting=setting)[0]])


def text_of(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", " ", page.split("</style>")[1]))


def test_a_finding_has_numbers_cause_and_remedy_and_unusual_noise_is_said(knocked):
    page = render_discovery_report(knocked.found, knocked.model, knocked.proposal, ASK)
    (finding,) = knocked.found.findings
    words, step = finding.family.words["en"], finding.parameters["step_um[x]"]
    gap = knocked.found.gap
    said = text_of(page)
    for sentence in (
        *("Step of the set-up", words.cause, words.looks_like, words.remedy),
        *(f"step x {step.value:.2f} ±", "no other effect of the catalogue"),
        *(f"{v:.2f} µm" for v in (gap.before_um, gap.after_um, gap.noise_floor_um)),
        *("line", "time", "beam", "moving axis", "position of X"),  # where it disagrees
        *("direction of Y", "region of X and Z"),
        "X, Y and Z of the workpiece, on which the tracker stands",
        *("removed from the machine's numbers", "Nothing is asked"),
    ):
        assert sentence in said
    assert knocked.proposal is None
    for figure in ("Gap on held-out lines", "Residual along the run", "by line"):
        assert f'aria-label="{figure}' in page or figure in page
    assert not re.search(r'(?:src|href)="', page)  # it needs nothing from elsewhere
    assert "nan" not in page
    baseline = knocked.found.baseline
    (run,) = baseline.runs
    four = {"white": (4.0, 4.0), "ou": tuple(4.0 * np.array(run.noise.typical.ou))}
    loud = replace(run, noise=replace(run.noise, ramp_sigma_mm=0.0, **four))
    found = replace(knocked.found, baseline=replace(baseline, runs=(loud,)))
    said = text_of(render_discovery_report(found, knocked.model, None, ASK))
    for where in ("along", "across"):
        assert f"{where} the beam, in no shape that was tried: they are counted" in said
    assert said.count("4 times what the tracker is stated to have there") == 2


def test_what_belongs_to_the_measurement_stays_out_of_the_machine(knocked, tmp_path):
    assert knocked.model.extended.added == ()
    (effect,) = knocked.model.content["effects"]
    assert effect["part_of"] == "measurement"
    kinds = {e["effect"] for e in knocked.model.content["model"]["effects"]}
    assert "catalogued" not in kinds
    write_discovery(knocked, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"discovery.json", "model.json", "report.html"}
    earlier = read_prior_model(tmp_path / "model.json")
    assert "Left out: setup-step" in describe_use(earlier, repeats_model=False)


def test_lines_to_drive_next_come_with_programs(knocked, record, tmp_path):
    path = record(11, rows=5, travel_mm=150.0)[0].commanded
    question = Question("backlash", "a lag", (1, 1), np.zeros)
    asked = DiscriminationDesign((question,), path, (9.0,))
    write_discovery(replace(knocked, proposal=asked), tmp_path)
    for control in list_dialects():
        (program,) = (tmp_path / "ask" / control).iterdir()
        motion = read_program(program.read_text(), control)
        np.testing.assert_allclose(motion.position, path.position, atol=6e-4)
    (tmp_path / "ask" / "tracker.csv").touch()
    write_discovery(knocked, tmp_path)
    assert [one.name for one in (tmp_path / "ask").iterdir()] == ["tracker.csv"]
