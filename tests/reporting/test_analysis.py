"""A Run in, three files out, and predictions from one of them."""

import csv
import json
import os
from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.calibration.analysis_files import render_analysis, write_analysis
from truepath.answers.calibration.points_csv import predict_points
from truepath.errors import AlignmentError, BundleError
from truepath.files.earlier.result_file import read_result
from truepath.results.analysis import analyse
from truepath.results.prediction import predict


@pytest.fixture(scope="module")
def recorded(record):
    return record(31, rows=24)


@pytest.fixture(scope="module")
def stages() -> list[tuple[float, str]]:
    return []


@pytest.fixture(scope="module")
def analysis(recorded, stages):
    run, _ = recorded
    return render_analysis(analyse(run, on_progress=lambda *said: stages.append(said)))


@pytest.fixture
def folder(analysis, tmp_path):
    write_analysis(analysis, tmp_path / "new" / "result")
    return tmp_path / "new" / "result"


def test_progress_names_the_stages_in_order_and_never_goes_back(analysis, stages):
    shares = [share for share, _ in stages]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 0.9)  # the files are left to write
    assert list(dict.fromkeys(name for _, name in stages)) == [
        "aligning",
        "estimating",
        "reporting",
    ]


def test_three_files_are_written_and_nothing_else(folder):
    assert sorted(os.listdir(folder)) == [
        "error_tables.csv",
        "report.html",
        "result.json",
    ]


def test_a_second_result_replaces_the_first(analysis, folder):
    (folder / "report.html").write_text("old")
    write_analysis(analysis, folder)
    assert (folder / "report.html").read_text("utf-8") == analysis.report_html
    assert len(os.listdir(folder)) == 3


def test_the_written_map_removes_the_error_of_the_machine(
    recorded, folder, volume, rigid_free, tmp_path
):
    run, truth = recorded
    q = volume(run.machine)
    asked, answered = tmp_path / "p.csv", tmp_path / "d.csv"
    np.savetxt(asked, q, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    told = predict_points(folder / "result.json", asked, answered)
    assert told.warnings == ()
    with answered.open(newline="") as file:
        rows = list(csv.DictReader(file))
    predicted = np.array([[float(r[f"d{k}_um"]) for k in "xyz"] for r in rows])
    sigma = np.array([[float(r[f"u{k}_um"]) for k in "xyz"] for r in rows])
    before = rigid_free(q, 1e3 * truth.deviation_mm(q))
    left = before - rigid_free(q, predicted)
    assert np.linalg.norm(left, axis=1).mean() < 0.1 * (
        np.linalg.norm(before, axis=1).mean()
    )
    assert 0.8 < (np.abs(left) < 2 * sigma).mean() <= 1.0


def test_the_file_predicts_what_the_analysis_predicts(
    recorded, analysis, folder, volume
):
    q = volume(recorded[0].machine, 20)
    read = read_result(folder / "result.json")
    again = predict(read, q)
    whole = analysis.found.volumetric
    assert json.loads((folder / "result.json").read_text("utf-8")) == analysis.result
    grid = predict(read, whole.position_mm)
    assert grid.error_um == pytest.approx(whole.error_um, abs=1e-8)
    assert grid.uncertainty_um == pytest.approx(whole.uncertainty_um, rel=1e-6)
    assert np.isfinite(again.error_um).all()


def test_all_lines_of_the_path_are_accounted_for(analysis):
    alignment = analysis.result["alignment"]
    assert alignment["matched_lines"] == alignment["lines"] == 23
    assert alignment["rows_without_data"] == []


def test_a_stream_of_another_path_is_refused(recorded, record):
    run, _ = recorded
    other, _ = record(32, rows=24)
    with pytest.raises(AlignmentError):
        analyse(replace(run, commanded=other.commanded))


@pytest.mark.parametrize("missing", ["result", "points"])
def test_a_file_that_is_not_there_is_named(folder, tmp_path, missing):
    asked = tmp_path / "p.csv"
    asked.write_text("x_mm,y_mm,z_mm\n1,2,3\n")
    result = folder / "result.json"
    if missing == "result":
        result = tmp_path / "none.json"
    else:
        asked = tmp_path / "none.csv"
    with pytest.raises(
        BundleError, match=r"none\.(json|csv): cannot be read \(No such"
    ):
        predict_points(result, asked, tmp_path / "d.csv")


def test_a_result_that_is_cut_short_is_refused(folder, tmp_path):
    cut = tmp_path / "cut.json"
    cut.write_bytes((folder / "result.json").read_bytes()[:5000])
    with pytest.raises(BundleError, match=r"cut\.json, row 1: is not JSON"):
        read_result(cut)


def test_a_file_too_large_to_be_a_result_is_not_read(tmp_path):
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate((1 << 30) + 1)
    with pytest.raises(BundleError, match="larger than 1024 MiB"):
        read_result(large)


def test_bad_points_leave_no_answer_behind(folder, tmp_path):
    asked, answered = tmp_path / "p.csv", tmp_path / "d.csv"
    asked.write_text("x_mm,y_mm,z_mm\n1,2,nan\n")
    with pytest.raises(BundleError, match=r"p\.csv, row 2, column z_mm"):
        predict_points(folder / "result.json", asked, answered)
    assert not answered.exists()
