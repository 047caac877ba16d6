"""The report: whole, self-contained, and honest about what it does not know."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from truepath.answers.calibration.calibration_report import (
    render_calibration_report,
    render_section,
)
from truepath.answers.shown.number_format import format_expanded, format_number
from truepath.results.findings import group_residuals, state_findings, state_noise

VOID = {"input", "meta", "br", "img", "link", "hr", "path", "use"}


class Outline(HTMLParser):
    """Texts and tags of a page; every tag that opens has to close."""

    def __init__(self) -> None:
        super().__init__()
        self.open, self.texts, self.tags, self.addresses = [], [], set(), []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href") and v]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.texts))


def read(page: str) -> Outline:
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    return outline


@pytest.fixture(scope="module")
def page(found) -> str:
    return render_calibration_report(found)


@pytest.fixture(scope="module")
def outline(page) -> Outline:
    return read(page)


def test_the_page_needs_nothing_but_itself(page, outline):
    assert {"script", "link", "img", "iframe"}.isdisjoint(outline.tags)
    assert outline.addresses == []
    assert "url(http" not in page
    assert "@import" not in page
    named = set(re.findall(r"https?://[^\"' )]+", page))
    assert named <= {"http://www.w3.org/1999/xlink", "http://www.w3.org/2000/svg"}


def test_the_same_findings_give_the_same_page(found, page):
    assert render_calibration_report(found) == page


def test_figures_take_their_colours_from_the_page(page):
    svg = page[page.index("<svg") :]
    assert "var(--accent)" in svg
    assert "#0101" not in svg
    assert "#000000" not in svg
    assert "DejaVu" not in svg


def test_every_variable_of_the_figures_is_in_the_style(page):
    used = set(re.findall(r"var\(--([a-z-]+)\)", page))
    assert used <= set(re.findall(r"--([a-z-]+):", page))


def test_all_error_motions_and_squarenesses_stand_in_it(outline):
    for symbol in ("EXX", "EYX", "ECX", "EAY", "EZZ", "C0Y", "B0Z", "A0Z"):
        assert symbol in outline.text
    for words in ("straightness of X in Y", "roll of X", "squareness of Z to Y"):
        assert words in outline.text


def test_before_and_after_are_stated_with_their_uncertainty(found, outline):
    for spread in (found.volumetric.before, found.volumetric.after):
        for figure in (spread.mean, spread.p95, spread.largest):
            assert (
                format_expanded(figure.value_um, figure.uncertainty_um) in outline.text
            )
    assert "k = 2" in outline.text


def test_what_is_expected_is_not_called_measured(outline):
    assert "It has not been measured" in outline.text


def test_what_cannot_be_told_is_said_in_words(estimate, outline):
    assert estimate.observability.unobservable
    for statement in estimate.observability.unobservable:
        assert statement in outline.text
    assert "hold for the measured target offset only" in outline.text
    assert outline.text.count("not observable") >= 2 * 4


def test_where_all_is_told_apart_the_report_says_so(
    construct, three_targets, provenance
):
    all_told = state_findings(construct(three_targets), provenance)
    assert "all error motions were identified" in render_section("limits", all_told)
    text = read(render_section("error_motions", all_told)).text
    assert "hold for any tool" in text
    assert "not observable" not in text


def test_the_provenance_is_there(outline):
    for words in ("truepath 9.9", "monday.zip", "0" * 64, "2026-03-07", "2,500 to"):
        assert words in outline.text


def test_residuals_at_the_noise_are_good(estimate, provenance, with_residuals):
    at_noise = replace(estimate.runs[0].residuals, rms_mm=1.0e-3, floor_mm=1.0e-3)
    found = state_findings(with_residuals(estimate, at_noise), provenance)
    assert "explains the measurement to its noise" in render_section("residuals", found)


def test_residuals_above_the_noise_are_a_warning(estimate, provenance, with_residuals):
    above = replace(estimate.runs[0].residuals, rms_mm=3.0e-3, floor_mm=1.0e-3)
    found = state_findings(with_residuals(estimate, above), provenance)
    section = render_section("residuals", found)
    assert "3.0 times the noise. The model lacks an effect" in section
    assert 'class="callout warn"' in section


def test_a_standstill_run_speaks_of_points(estimate, provenance):
    run = replace(
        provenance.runs[0], mode="standstill", feed_mm_min=None, temperature_degc={}
    )
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


def test_one_feed_is_one_number(estimate, provenance):
    run = replace(provenance.runs[0], feed_mm_min=(2500.0, 2500.0))
    found = state_findings(estimate, replace(provenance, runs=(run,)))
    assert "on the fly at 2,500 mm/min" in render_section("machine", found)


def test_across_the_travel_only_is_named(across_only, provenance):
    found = state_findings(across_only, provenance)
    assert "across the travel only" in render_section("documentation", found)
    assert "along the travel was not used" in render_section("residuals", found)


def test_names_cannot_smuggle_markup_into_the_page(estimate, provenance):
    evil = "<script>alert(1)</script>"
    machine = replace(estimate.model.machine, name=evil)
    model = replace(estimate.model, machine=machine)
    run = replace(provenance.runs[0], name=evil, source={evil: evil})
    page = render_calibration_report(
        state_findings(replace(estimate, model=model), replace(provenance, runs=(run,)))
    )
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_an_axis_of_which_nothing_is_known_has_no_values(estimate, provenance):
    model = estimate.model
    kept = tuple(
        e for e in model.effects if not e.name.endswith("Z") or e.name[0] != "E"
    )
    rows = np.concatenate([np.r_[model.slices[e.name]] for e in kept])
    thin = replace(
        estimate,
        model=replace(model, effects=kept),
        theta=estimate.theta[rows],
        covariance=estimate.covariance[np.ix_(rows, rows)],
    )
    text = read(render_section("error_motions", state_findings(thin, provenance))).text
    assert "Values of axis X" in text
    assert "Values of axis Z" not in text


def test_errors_of_nothing_are_drawn_all_the_same(estimate, provenance):
    perfect = replace(
        estimate,
        theta=np.zeros_like(estimate.theta),
        covariance=np.zeros_like(estimate.covariance),
    )
    read(render_section("volume", state_findings(perfect, provenance)))


def test_residuals_across_the_travel_count_where_only_those_were_used(across_only):
    run = across_only.runs[0]
    lines = group_residuals(run, across_only=True)
    square = run.residuals.across_mm.reshape(len(lines.row), -1) ** 2
    assert lines.rms_um == pytest.approx(1e3 * np.sqrt(square.mean(axis=1) / 3))


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
def test_an_uncertainty_has_two_digits_and_the_value_as_many_places(
    value, standard, text
):
    assert format_expanded(value, standard) == text


def test_no_zero_carries_a_minus_sign():
    assert format_number(-0.0004, 2) == "0.00"
