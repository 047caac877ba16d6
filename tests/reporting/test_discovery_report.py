"""The report says where, which, and how much of the gap is closed."""

import html
import re

import pytest

from truepath.answers.discovery.discovery import ASK, discover_runs
from truepath.answers.discovery.discovery_report import (
    render_discovery_report,
    write_discovery,
)
from truepath_simulators.hidden.setup import SetupStep
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def knocked(record):
    setting = Setting(hidden=(SetupStep(40.0, (4.0, -3.0, 0.0)),))
    return discover_runs([record(11, rows=60, setting=setting)[0]])


@pytest.fixture(scope="module")
def page(knocked):
    return render_discovery_report(knocked.found, knocked.model, knocked.asked, ASK)


def text_of(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", " ", page.split("</style>")[1]))


def test_a_finding_comes_with_numbers_cause_and_remedy(knocked, page):
    (finding,) = knocked.found.findings
    said = text_of(page)
    assert "Step of the set-up" in said
    words = finding.family.words["en"]
    for sentence in (words.cause, words.looks_like, words.remedy):
        assert sentence in said
    step = finding.parameters["step_um[x]"]
    assert f"step x {step.value:.2f} ±" in said
    assert "no other effect of the catalogue" in said


def test_the_gap_stands_in_numbers_and_as_a_plot(knocked, page):
    gap = knocked.found.gap
    said = text_of(page)
    for value in (gap.before_um, gap.after_um, gap.noise_floor_um):
        assert f"{value:.2f} µm" in said
    for figure in ("Gap on held-out lines", "Residual along the run", "by line"):
        assert f'aria-label="{figure}' in page or figure in page


def test_where_it_disagrees_is_told_by_line_time_place_and_direction(page):
    said = text_of(page)
    for grouping in ("line", "time", "beam", "moving axis", "position of X"):
        assert grouping in said
    assert "direction of Y" in said
    assert "region of X and Z" in said
    assert "X, Y and Z of the workpiece, on which the tracker stands" in said


def test_what_belongs_to_the_measurement_stays_out_of_the_machine(knocked, page):
    assert "removed from the machine's numbers" in text_of(page)
    assert knocked.model.extended.added == ()
    (effect,) = knocked.model.content["effects"]
    assert effect["part_of"] == "measurement"
    kinds = {e["effect"] for e in knocked.model.content["model"]["effects"]}
    assert "catalogued" not in kinds


def test_where_nothing_is_asked_the_report_says_so(knocked, page):
    assert knocked.asked is None
    assert "Nothing is asked" in text_of(page)


def test_the_page_needs_nothing_from_elsewhere(page):
    assert not re.search(r'(?:src|href)="', page)
    assert "nan" not in page


def test_the_files_of_the_contract_are_written(knocked, tmp_path):
    write_discovery(knocked, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"discovery.json", "model.json", "report.html"}
