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


def measured(truth, machine, axes="XYZ", seed=3):
    """Measure every error motion, forward and backward, five runs, exact truth."""
    rng = np.random.default_rng(seed)
    motions = truth.recording.truth.error_motions()
    rows = []
    for axis in machine.linear_axes:
        if axis.name not in axes:
            continue
        at = np.arange(axis.low + 10.0, axis.high, STEP_MM)
        for symbol in list_error_motions(axis.name):
            unit = "urad" if is_turn(symbol) else "um"
            value = motions[symbol].at(at) * (1e6 if is_turn(symbol) else 1e3)
            # A laser of its own line of sight: an offset and a slope mean nothing.
            value = value + 12.0 + (0.02 * at if unit == "um" else 0.0)
            if symbol == f"E{axis.name}{axis.name}":
                value = value - 0.02 * at
            for sign, direction in ((1.0, "+"), (-1.0, "-")):
                for _ in range(RUNS):
                    noise = REPEATABILITY[unit] * rng.normal(size=len(at))
                    half = 0.5 * sign * REVERSAL[unit]
                    rows.append(
                        DirectMeasurement(
                            symbol, direction, unit, at, value + half + noise
                        )
                    )
    return tuple(rows)


@pytest.fixture(scope="module")
def laser(record, tmp_path_factory):
    """The `reference.csv` of the machine that was analysed."""
    run_of_truth, truth = record(1, rows=24)
    file = tmp_path_factory.mktemp("laser") / "reference.csv"
    file.write_bytes(encode_reference(measured(truth, run_of_truth.machine)))
    return file


@pytest.fixture(scope="module")
def compared(analysed, laser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    arguments = [str(analysed / "result.json"), str(laser), "-o", str(folder)]
    assert run(["compare", *arguments]) == 0
    return folder, json.loads((folder / "comparison.json").read_text())


def test_compare_writes_table_figures_and_page(compared):
    folder, content = compared
    assert {path.name for path in folder.iterdir()} == {
        "comparison.json",
        "comparison.csv",
        "comparison.html",
    }
    assert content["schema"] == "comparison/1"
    page = (folder / "comparison.html").read_text()
    assert page.count("<svg") == 4  # three axes and the volume
    assert "http" not in page.replace("http-equiv", "")


def test_what_the_result_tells_is_compared_and_the_rest_is_named(compared):
    _, content = compared
    assert len(content["errors"]) == 14
    assert len(content["not_compared"]) == 4
    assert "does not tell it" in content["not_compared"]["EAZ"]


def test_both_methods_agree_within_their_stated_uncertainties(compared):
    _, content = compared
    shares = [error["share_within"] for error in content["errors"].values()]
    assert np.mean(shares) > 0.9
    assert content["kinds"]["straightness"]["largest_difference_um"] < 3.0
    assert content["kinds"]["positioning"]["largest_difference_um"] < 4.0
    volume = content["volumetric"]
    assert volume["difference_mean_um"] < 0.15 * volume["reference_mean_um"]


def test_motions_that_one_target_cannot_tell_are_merged_before_comparing(
    compared, analysed, record, tmp_path
):
    _, content = compared
    assert content["errors"]["EXZ"]["merged"] == ["EBZ", "ECZ"]
    lone = [
        m
        for m in measured(record(1, rows=24)[1], record(1, rows=24)[0].machine)
        if m.error not in ("EAZ", "EBZ", "ECZ")
    ]
    (tmp_path / "lone.csv").write_bytes(encode_reference(tuple(lone)))
    out = tmp_path / "out"
    arguments = [str(analysed / "result.json"), str(tmp_path / "lone.csv")]
    assert run(["compare", *arguments, "-o", str(out)]) == 0
    alone = json.loads((out / "comparison.json").read_text())["errors"]["EXZ"]
    assert alone["missing"] == ["EBZ", "ECZ"]
    assert alone["merged"] == []
    merged = content["errors"]["EXZ"]
    assert alone["largest_difference_um"] > 2.0 * merged["largest_difference_um"]


def test_values_stand_in_the_papers_convention(compared):
    _, content = compared
    for symbol, error in content["errors"].items():
        unit = "urad" if is_turn(symbol) else "um"
        for side in ("result", "reference"):
            values = error[f"{side}_{unit}"]
            straight = not is_turn(symbol) and symbol[1] != symbol[2]
            assert abs(values[0]) < 1e-9
            assert (abs(values[-1]) < 1e-9) == straight
        assert error["en"][0] == 0.0


def test_the_reversal_is_seen_in_the_directions_not_in_the_mean(compared):
    _, content = compared
    error = content["errors"]["EXX"]
    reversal = np.subtract(error["forward_um"], error["backward_um"])
    assert np.mean(reversal) == pytest.approx(REVERSAL["um"], abs=0.3)
    mean = 0.5 * np.add(error["forward_um"], error["backward_um"])
    np.testing.assert_allclose(mean, error["reference_um"], atol=1e-9)


def test_the_spread_of_runs_is_the_uncertainty_of_the_reference(compared):
    _, content = compared
    stated = content["errors"]["EYX"]["reference_uncertainty_um"][3]
    # Ten values a position; the gauge adds what its two end points scatter.
    alone = REPEATABILITY["um"] / np.sqrt(2 * RUNS)
    assert alone < stated < 1.6 * alone


def test_the_csv_says_the_same_a_row_a_position(compared):
    folder, content = compared
    rows = list(csv.DictReader((folder / "comparison.csv").read_text().splitlines()))
    assert len(rows) == sum(len(e["en"]) for e in content["errors"].values())
    row = next(r for r in rows if r["error"] == "EXX")
    assert row["unit"] == "um"
    last = [r for r in rows if r["error"] == "ECX"][-1]
    assert float(last["en"]) == pytest.approx(content["errors"]["ECX"]["en"][-1], 1e-3)


def test_uncertainty_of_the_instrument_widens_what_agrees(
    analysed, laser, tmp_path, summary
):
    arguments = [str(analysed / "result.json"), str(laser), "-o", str(tmp_path / "out")]
    wide = ["--reference-um", "5", "--reference-urad", "20", "--json"]
    assert run(["compare", *arguments, *wide]) == 0
    said = summary()
    assert said["schema"] == "comparison-summary/1"
    assert {e["share_within"] for e in said["errors"].values()} == {1.0}
    assert len(said["files"]) == 3


def test_squareness_is_compared_where_the_reference_has_it(
    analysed, tmp_path, summary, capsys
):
    result = json.loads((analysed / "result.json").read_text())
    ours = result["squareness_urad"]["C0Y"]["value"]
    rows = [f"C0Y,0,+,{ours + d},urad" for d in (9.0, 10.0, 11.0)]
    rows += ["EXX,50,+,0,um", "EXX,50,-,0,um", "EXX,450,+,2,um"]
    file = tmp_path / "reference.csv"
    file.write_text("error,position_mm,direction,value,unit\n" + "\n".join(rows) + "\n")
    arguments = [str(analysed / "result.json"), str(file), "-o", str(tmp_path / "out")]
    assert run(["compare", *arguments, "--json"]) == 0
    said = summary()
    assert said["numbers"]["C0Y"]["difference_urad"] == pytest.approx(-10.0)
    assert "fewer than two positions" in said["not_compared"]["EXX"]
    assert run(["compare", *arguments]) == 0
    assert "C0Y" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("EXX,1,+,1,urad", "states EXX in urad; it is measured in um"),
        ("EXX,1,+,1,um\nEXX,2,+,1,um\nEXQ,1,+,1,um", ""),
        ("EXQ,1,+,1,um", "no error in common; the reference measures EXQ"),
        ("EXX,1,*,1,um", "row 2, column direction"),
        ("EXX,one,+,1,um", "row 2, column position_mm"),
    ],
)
def test_a_reference_that_cannot_be_used_says_why(
    analysed, tmp_path, capsys, rows, message
):
    file = tmp_path / "reference.csv"
    file.write_text(f"error,position_mm,direction,value,unit\n{rows}\n")
    arguments = [str(analysed / "result.json"), str(file), "-o", str(tmp_path / "out")]
    assert run(["compare", *arguments]) == (2 if message else 0)
    said = capsys.readouterr()
    assert message in said.err
    if not message:
        assert "not compared: EXQ: the result does not state it" in said.out


def test_a_file_in_the_way_of_the_folder_is_refused(analysed, laser, tmp_path, capsys):
    (tmp_path / "out").write_text("")
    arguments = [str(analysed / "result.json"), str(laser), "-o", str(tmp_path / "out")]
    assert run(["compare", *arguments]) == 2
    assert "name a folder" in capsys.readouterr().err


def test_another_scale_of_lengths_is_no_disagreement_beyond_what_is_stated(
    analysed, record, tmp_path
):
    _, truth = record(1, rows=24)
    longer = tuple(
        replace(one, value=one.value + 0.02 * one.position_mm)
        if one.error == "EXX"
        else one
        for one in measured(truth, record(1, rows=24)[0].machine)
    )
    laser = tmp_path / "longer.csv"
    laser.write_bytes(encode_reference(longer))
    content = json.loads((analysed / "result.json").read_text())
    within = {}
    for ppm in (0.0, 20.0):  # the laser is 20 ppm off the result
        content["provenance"]["length_scale_ppm"] = ppm
        result, out = tmp_path / "result.json", tmp_path / f"by {ppm:g}"
        result.write_text(json.dumps(content))
        assert run(["compare", str(result), str(laser), "-o", str(out)]) == 0
        compared = json.loads((out / "comparison.json").read_text())
        within[ppm] = compared["errors"]["EXX"]["share_within"]
    assert within[20.0] == 1.0
    assert within[0.0] < 0.3
