"""The report says where, which, and how much of the gap is closed."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.discovery.discovery import ASK, discover_runs
from truepath.answers.discovery.discovery_report import (
    render_discovery_report,
    write_discovery,
)
from truepath.discovery.discrimination import DiscriminationDesign, Question
from truepath.estimation.problem.prior_model import read_prior_model
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath.results.updated_effects import describe_use
from truepath_simulators.hidden.setup import SetupStep
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def knocked(record):
    setting = Setting(hidden=(SetupStep(20.0, (4.0, -3.0, 0.0)),))
    return discover_runs([record(11, rows=40, travel_mm=150.0, setting=setting)[0]])


def text_of(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]+>", " ", page.split("</style>")[1]))


def test_a_finding_has_numbers_cause_and_remedy_and_unusual_noise_is_said(knocked):
    page = render_discovery_report(knocked.found, knocked.model, knocked.asked, ASK)
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
    assert knocked.asked is None
    for figure in ("Gap on held-out lines", "Residual along the run", "by line"):
        assert f'aria-label="{figure}' in page or figure in page
    assert not re.search(r'(?:src|href)="', page)  # it needs nothing from elsewhere
    assert "nan" not in page
    loud = replace(gap, usual_um=0.5 * gap.noise_floor_um)
    found = replace(knocked.found, gap=loud)
    said = text_of(render_discovery_report(found, knocked.model, None, ASK))
    words = "they are counted as noise, 2 times what the tracker is stated to have"
    assert words in said


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
    write_discovery(replace(knocked, asked=asked), tmp_path)
    for control in list_dialects():
        (program,) = (tmp_path / "ask" / control).iterdir()
        motion = read_program(program.read_text(), control)
        np.testing.assert_allclose(motion.position, path.position, atol=6e-4)
    (tmp_path / "ask" / "tracker.csv").touch()
    write_discovery(knocked, tmp_path)
    assert [one.name for one in (tmp_path / "ask").iterdir()] == ["tracker.csv"]
