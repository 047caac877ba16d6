"""A result of several Runs says of each what it says of one."""

import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.calibration.analysis_files import render_analysis
from truepath.errors import AlignmentError, BundleError
from truepath.files.bundle.run import number_names
from truepath.files.earlier.result_file import result_from_json
from truepath.kinematics.machine.machine import Target
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json


@pytest.fixture(scope="module")
def runs(record):
    """Two measurements of a machine: the seed makes the machine, the mode the rest."""
    moving, _ = record(61, rows=24)
    standing, _ = record(61, "standstill", rows=30)
    return replace(moving, name="on <the> fly"), replace(standing, name="points")


@pytest.fixture(scope="module")
def analysis(runs):
    return render_analysis(analyse(*runs))


def test_the_mode_is_that_of_the_run_with_most_samples_used(analysis):
    result = json.loads(json.dumps(analysis.result, allow_nan=False))
    used = {run["mode"]: run["used_samples"] for run in result["runs"]}
    assert set(used) == {"otf", "standstill"}
    assert result["mode"] == max(used, key=used.get)
    main = next(run for run in result["runs"] if run["mode"] == result["mode"])
    assert result["alignment"] == main["alignment"]
    assert result_from_json(result).mode == result["mode"]


def test_each_run_has_alignment_residuals_noise_and_origin(analysis, runs):
    for stated, run in zip(analysis.result["runs"], runs, strict=True):
        assert stated["name"] == run.name
        assert stated["samples"] == len(run.tracker)
        assert stated["alignment"]["pose"]["shift_mm"]
        assert stated["residuals"]["by_line"]
        assert stated["noise"]["white_um"]["along_beam"] > 0.0
        assert len(stated["input_sha256"]) == 64


def test_each_run_says_where_the_tracker_stood_and_what_it_brought(analysis):
    left = analysis.result["volumetric_uncertainty_um"]
    for run in analysis.result["runs"]:
        pose = run["alignment"]["pose"]
        stood = -np.array(pose["rotation"]).T @ pose["shift_mm"]
        assert run["tracker_mm"] == pytest.approx(stood, abs=1e-3)
        assert run["without_it_um"] > left > 0.0
    assert analysis.report_html.count("without this Run it would be") == 2


def test_residuals_at_the_top_are_those_of_all_cells(analysis):
    residuals = analysis.result["residuals"]
    lines = residuals["by_line"]
    assert {line["run"] for line in lines} == {0, 1}
    square = sum(line["cells"] * line["rms_um"] ** 2 for line in lines)
    whole = np.sqrt(square / sum(line["cells"] for line in lines))
    assert residuals["rms_um"] == pytest.approx(whole)


def test_the_digest_is_of_all_runs_in_their_order(analysis, runs):
    digest = analysis.result["provenance"]["input_sha256"]
    assert digest not in {run["input_sha256"] for run in analysis.result["runs"]}
    assert analysis.result["provenance"]["run"] == "on <the> fly, points"


def test_the_report_shows_every_run(analysis):
    page = analysis.report_html
    assert "Runs on &lt;the&gt; fly (on the fly), points (at standstill)" in page
    assert page.count("<h3>Run points</h3>") == 3
    assert "23 lines" in page
    assert "38 points" in page
    assert "Residual by line" in page
    assert "Residual by point" in page


def test_runs_of_one_name_are_numbered():
    assert number_names(["a", "b"]) == ["a", "b"]
    assert number_names(["run", "run"]) == ["run (1)", "run (2)"]


def test_a_run_that_cannot_be_aligned_is_named(runs, record):
    moving, standing = runs
    elsewhere = replace(
        standing, commanded=record(62, "standstill", rows=30)[0].commanded
    )
    with pytest.raises(AlignmentError, match=r"^points: "):
        analyse(moving, elsewhere)


def test_another_machine_is_refused_before_any_work(runs):
    moving, standing = runs
    machine = replace(standing.machine, workpiece_side=("X",), tool_side=("Y", "Z"))
    with pytest.raises(
        BundleError, match=r"points/machine\.json: kinematic_chain is w-X-b-Y-Z-t, but"
    ):
        analyse(moving, replace(standing, machine=machine))


def test_targets_without_a_name_take_that_of_their_run(runs):
    moving, standing = runs
    # What is said of the offset is wrong here; only how it is named counts.
    longer = replace(
        standing.machine, targets=(Target("", "tool", (20.0, 30.0, -250.0)),)
    )
    result = result_json(analyse(moving, replace(standing, machine=longer)))
    assert set(result["machine"]["targets"]) == {"on <the> fly", "points"}
