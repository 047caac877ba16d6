"""The document of the validation, and its marks on fewer machines."""

import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]
DOCUMENT = ROOT / "docs" / "validation.md"


def test_every_section_of_the_document_holds_a_table_and_every_figure_is_there():
    text = DOCUMENT.read_text(encoding="utf-8")
    sections = re.findall(r"<!-- ([\w-]+) -->\n(.*?)<!-- /\1 -->", text, re.DOTALL)
    assert len(sections) == text.count("<!-- /") > 10
    assert all("| --- |" in body for _, body in sections)
    names = re.findall(r"\]\((figures/validation/[^)]+)\)", text)
    kept = {p.name for p in (ROOT / "docs" / "figures" / "validation").iterdir()}
    assert {Path(name).name for name in names} == kept
    assert all((ROOT / "docs" / n).stat().st_size < 200_000 for n in names)


def test_sections_are_replaced_unknown_ones_refused(validation, tmp_path, monkeypatch):
    document = validation("document")
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- x -->\nold\n<!-- /x -->\nb\n", encoding="utf-8")
    monkeypatch.setattr(document, "DOCUMENT", page)
    document.write_section("x", document.table(["h", "n"], [["one", 2]]))
    text = page.read_text(encoding="utf-8")
    assert "| one | 2 |" in text
    assert "old" not in text
    assert text.startswith("a\n")
    assert text.endswith("b\n")
    with pytest.raises(KeyError):
        document.write_section("y", "")


def test_one_measurement_a_control_point_tells_the_spline(validation):
    script = validation("paper_2005_single_spline")
    independent = script.procedure(script.PRIORS["independent control points"])
    bending = script.procedure(script.PRIORS["bending"])
    left = independent.variance()
    assert script.straightness_of_fall(left) > 0.95
    assert left[7] < 0.03 * left[0]
    assert left[6] - left[7] > 4 * (left[7] - left[8])
    assert independent.shortfall <= 0.0
    assert script.ripple(independent.beliefs[0]) < 0.7
    assert script.ripple(bending.beliefs[0]) > 0.98


@pytest.mark.long
@pytest.mark.timeout(600)
def test_errors_of_the_papers_size_are_found_again(validation):
    script, study = validation("paper_2023_simulation"), validation("judging").study
    assert study(script.record_machine(2023, 0.0)).share_left < 0.003
    assert study(script.record_machine(2023, 1.0)).share_left < 0.02


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_error_left_is_near_the_information_bound(validation):
    script = validation("random_machines")
    outcomes = [script.outcome(seed) for seed in range(1, 9)]
    assert script.ratio(outcomes) < 1.15
    assert 0.90 < np.mean([o.map_covered for o in outcomes]) < 0.99
    assert 0.90 < np.mean([o.tables_covered for o in outcomes]) < 0.99


@pytest.mark.long
@pytest.mark.timeout(300)
def test_an_order_of_axes_that_data_do_not_tell_ends_no_analysis(validation):
    assert validation("instrument_errors").judge_turning(5).inside > 0.8


@pytest.mark.long
@pytest.mark.timeout(900)
def test_gantries_reach_the_information_bound(validation, perfect_trackers):
    script = validation("large_machines")
    gantry = next(world for world in script.WORLDS if world.travel_mm[0] == 3000.0)
    found = [script.outcome(gantry, seed) for seed in range(1, 5)]
    squares = [np.square([o.left, o.bound]) for o in found]
    left, bound = np.sqrt(np.mean(squares, axis=0))
    assert left < 1.15 * bound
    assert 0.90 < np.mean([o.covered for o in found]) < 0.99


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_direction_halves_what_corner_paths_leave(validation, perfect_trackers):
    script = validation("along_the_path")
    ratios = [o.ratio for o in script.outcomes(5)]
    assert np.median(ratios) < 0.5


@pytest.mark.long
@pytest.mark.timeout(900)
def test_u_carries_what_few_targets_leave_open(validation):
    script = validation("five_axes")
    for kind in script.KINDS:
        outcomes = [script.judge(kind, seed) for seed in range(1, 7)]
        for name in ("T1", script.OTHER):
            inside = np.mean([o.maps[name].inside for o in outcomes])
            assert 0.88 < inside < 0.999
        assert np.mean([o.tables_inside() for o in outcomes]) > 0.9


@pytest.mark.long
@pytest.mark.timeout(1500)
def test_files_that_carry_all_errors_leave_a_twentieth_and_what_they_state(
    validation, tmp_path, monkeypatch, perfect_trackers
):
    tables = validation("compensation_tables")
    monkeypatch.setattr(tables, "ORDERS", {"siemens": ("siemens", {})})
    outcomes = []
    for seed in range(7301, 7321):
        outcomes += tables.judge_seed(seed, tmp_path)
    assert len(outcomes) == 20
    before, after = np.array([(one.before, one.true) for one in outcomes]).T
    assert before.mean() > 20.0 * after.mean()
    assert np.median(before / after) > 20.0
    # Of 20 at a rate of 95 % fewer than 17 come once in sixty times.
    assert sum(one.is_covered for one in outcomes) >= 17
    assert (np.array([one.wrong for one in outcomes]) > 1.5 * before).all()
