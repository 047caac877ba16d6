"""`compare`: a result against a simulated laser of six degrees of freedom."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.recorded_files import encode_reference
from truepath.files.bundle.run import DirectMeasurement
from truepath.kinematics.machine.symbols import is_turn, list_error_motions

RUNS, STEP_MM = 5, 25.0
REPEATABILITY = {"um": 0.3, "urad": 0.8}
REVERSAL = {"um": 1.5, "urad": 0.0}


def measured(truth, machine, seed=3):
    """Measure every error motion, forward and backward, five runs, exact truth."""
    rng = np.random.default_rng(seed)
    motions = truth.recording.truth.error_motions()
    rows = []
    for axis in machine.linear_axes:
        at = np.arange(axis.low + 10.0, axis.high, STEP_MM)
        for symbol in list_error_motions(axis.name):
            unit = "urad" if is_turn(symbol) else "um"
            value = motions[symbol].at(at) * (1e6 if is_turn(symbol) else 1e3)
            # A laser of its own line of sight: an offset and a slope mean nothing.
            value = value + 12.0 + (0.02 * at if unit == "um" else 0.0)
            if symbol == f"E{axis.name}{axis.name}":
                value = value - 0.02 * at
            for half, direction in ((0.5, "+"), (-0.5, "-")):
                for _ in range(RUNS):
                    noise = REPEATABILITY[unit] * rng.normal(size=len(at))
                    shown = value + half * REVERSAL[unit] + noise
                    rows.append(DirectMeasurement(symbol, direction, unit, at, shown))
    return tuple(rows)


@pytest.fixture(scope="module")
def truth_measured(record):
    run_of_truth, truth = record(1, rows=24)
    return measured(truth, run_of_truth.machine)


@pytest.fixture(scope="module")
def laser(truth_measured, tmp_path_factory):
    file = tmp_path_factory.mktemp("laser") / "reference.csv"
    file.write_bytes(encode_reference(truth_measured))
    return file


@pytest.fixture
def compare(command, result, keep, tmp_path):
    def made(measurements):
        file, out = tmp_path / "reference.csv", tmp_path / "out"
        file.write_bytes(encode_reference(tuple(measurements)))
        command.run("compare", keep(result), file, "-o", out)
        return json.loads((out / "comparison.json").read_text())

    return made


@pytest.fixture(scope="module")
def compared(analysed, laser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    arguments = [str(analysed / "result.json"), str(laser), "-o", str(folder)]
    assert run(["compare", *arguments]) == 0
    return folder


@pytest.fixture(scope="module")
def content(compared):
    return json.loads((compared / "comparison.json").read_text())


def test_compare_writes_table_figures_page_and_what_is_left_out(compared, content):
    names = {f"comparison.{kind}" for kind in ("json", "csv", "html")}
    assert {path.name for path in compared.iterdir()} == names
    assert content["schema"] == "comparison/1"
    page = (compared / "comparison.html").read_text()
    assert page.count("<svg") == 4  # three axes and the volume
    assert "http" not in page.replace("http-equiv", "")
    assert (len(content["errors"]), len(content["not_compared"])) == (14, 4)
    assert "does not tell it" in content["not_compared"]["EAZ"]
    rows = list(csv.DictReader((compared / "comparison.csv").read_text().splitlines()))
    assert len(rows) == sum(len(e["en"]) for e in content["errors"].values())
    assert next(r for r in rows if r["error"] == "EXX")["unit"] == "um"
    last = [r for r in rows if r["error"] == "ECX"][-1]
    assert float(last["en"]) == pytest.approx(content["errors"]["ECX"]["en"][-1], 1e-3)


def test_both_methods_agree_within_their_stated_uncertainties(content):
    shares = [error["share_within"] for error in content["errors"].values()]
    assert np.mean(shares) > 0.9
    assert content["kinds"]["straightness"]["largest_difference_um"] < 3.0
    assert content["kinds"]["positioning"]["largest_difference_um"] < 4.0
    volume = content["volumetric"]
    assert volume["difference_mean_um"] < 0.15 * volume["reference_mean_um"]
    # The spread of runs, ten values a position; the gauge adds that of two end points.
    stated = content["errors"]["EYX"]["reference_uncertainty_um"][3]
    alone = REPEATABILITY["um"] / np.sqrt(2 * RUNS)
    assert alone < stated < 1.6 * alone


def test_motions_that_cannot_be_told_apart_are_merged(content, compare, truth_measured):
    merged = content["errors"]["EXZ"]
    assert merged["merged"] == ["EBZ", "ECZ"]
    lone = [m for m in truth_measured if m.error not in ("EAZ", "EBZ", "ECZ")]
    alone = compare(lone)["errors"]["EXZ"]
    assert (alone["missing"], alone["merged"]) == (["EBZ", "ECZ"], [])
    assert alone["largest_difference_um"] > 1.5 * merged["largest_difference_um"]


def test_values_stand_in_the_papers_convention_reversal_in_the_directions(content):
    for symbol, error in content["errors"].items():
        unit = "urad" if is_turn(symbol) else "um"
        for side in ("result", "reference"):
            values = error[f"{side}_{unit}"]
            straight = not is_turn(symbol) and symbol[1] != symbol[2]
            assert abs(values[0]) < 1e-9
            assert (abs(values[-1]) < 1e-9) == straight
        assert error["en"][0] == 0.0
    error = content["errors"]["EXX"]
    reversal = np.subtract(error["forward_um"], error["backward_um"])
    assert np.mean(reversal) == pytest.approx(REVERSAL["um"], abs=0.3)
    mean = 0.5 * np.add(error["forward_um"], error["backward_um"])
    np.testing.assert_allclose(mean, error["reference_um"], atol=1e-9)


def test_uncertainty_of_the_laser_widens_agreement(command, analysed, laser, tmp_path):
    wide = ["--reference-um", "5", "--reference-urad", "20", "-o", tmp_path / "out"]
    said = command.json("compare", analysed / "result.json", laser, *wide)
    assert said["schema"] == "comparison-summary/1"
    assert {e["share_within"] for e in said["errors"].values()} == {1.0}
    assert len(said["files"]) == 3


@pytest.fixture
def words(analysed, tmp_path):
    def spell(*rows):
        file = tmp_path / "reference.csv"
        head = "error,position_mm,direction,value,unit"
        file.write_text("\n".join([head, *rows]) + "\n")
        return ["compare", analysed / "result.json", file, "-o", tmp_path / "out"]

    return spell


def test_squareness_is_compared_and_what_one_side_lacks_is_not(command, words, result):
    ours = result["squareness_urad"]["C0Y"]["value"]
    rows = [f"C0Y,0,+,{ours + d},urad" for d in (9.0, 10.0, 11.0)]
    rows += ["EXX,50,+,0,um", "EXX,50,-,0,um", "EXX,450,+,2,um", "EXQ,1,+,1,um"]
    order = words(*rows)
    said = command.json(*order)
    assert said["numbers"]["C0Y"]["difference_urad"] == pytest.approx(-10.0)
    assert "fewer than two positions" in said["not_compared"]["EXX"]
    shown = command.run(*order).out
    assert "C0Y" in shown
    assert "not compared: EXQ: the result does not state it" in shown


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("EXX,1,+,1,urad", "states EXX in urad; it is measured in um"),
        ("EXQ,1,+,1,um", "no error in common; the reference measures EXQ"),
        ("EXX,1,*,1,um", "row 2, column direction"),
        ("EXX,one,+,1,um", "row 2, column position_mm"),
    ],
)
def test_a_reference_that_cannot_be_used_says_why(command, words, row, message):
    assert message in command.refuse(*words(row))


def test_a_file_in_the_way_of_the_folder_is_refused(command, words, tmp_path):
    (tmp_path / "out").write_text("")
    assert "name a folder" in command.refuse(*words("EXX,1,+,1,um"))


def test_another_scale_as_stated_is_no_disagreement(compare, truth_measured, result):
    longer = [
        replace(one, value=one.value + 0.02 * one.position_mm * (one.error == "EXX"))
        for one in truth_measured
    ]
    within = {}
    for ppm in (0.0, 20.0):  # the laser is 20 ppm off the result
        # As written by a version whose tables did not contain it.
        more = {"length_scale_ppm": ppm, "length_scale_in_tables": False}
        result["provenance"] |= more
        within[ppm] = compare(longer)["errors"]["EXX"]["share_within"]
    assert within[0.0] < 0.3 < within[20.0] == 1.0
