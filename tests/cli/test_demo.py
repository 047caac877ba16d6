"""`demo`: the whole job over a pty and Modbus TCP, and what it says when devices fail.

The device clocks run fast; the links, the processes and the bytes are the real ones.
"""

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.cli.demo import compare_with_truth, plan_path
from truepath.errors import PlanningError
from truepath.files.bundle.bundle import read_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.motion_times import travel_time_s
from truepath_simulators.scenario import load_machine

FAST = ["--speed", "4", "--feed", "15000"]


@pytest.fixture
def machine():
    return machine_from_json(load_machine("demo"))


@pytest.mark.timeout(120)
def test_the_main_job_ends_in_tables_that_the_truth_confirms(tmp_path, summary):
    out = tmp_path / "out"
    assert run(["demo", *FAST, "-o", str(out), "--json"]) == 0
    said = summary()
    assert said["lost_samples"] == 0
    assert said["samples"] > 10_000
    against = said["against_truth"]
    assert against["left"] < 0.1
    assert against["covered"] > 0.85
    names = {path.name for path in out.iterdir()}
    assert names >= {"result.json", "error_tables.csv", "report.html", "run.sqlite"}
    assert len(read_bundle(out / "bundle").tracker) == said["samples"]


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_circle_leaves_what_is_stated_of_the_machine(tmp_path, summary):
    out = tmp_path / "out"
    assert run(["demo", *FAST, "--compensate", "-o", str(out), "--json"]) == 0
    said = summary()
    before, left = said["against_truth"]["before_um"], said["as_left"]
    assert before > 10.0  # of the machine as found
    assert abs(left["map_scale"]["value"]) < 0.05
    assert left["volumetric_error_um"]["measured"]["mean"] < 0.15 * before
    assert (out / "as-left" / "report.html").is_file()


@pytest.mark.timeout(120)
def test_a_target_ends_the_measurement_early_with_tables(tmp_path, summary):
    out = tmp_path / "out"
    fast = ["--speed", "8", "--feed", "6000", "--target-um", "10"]
    assert run(["demo", *fast, "-o", str(out), "--json"]) == 0
    said = summary()
    whole_s = travel_time_s(read_bundle(out / "bundle").commanded)
    assert said["samples"] < 0.9 * 500 * whole_s
    assert said["lost_samples"] == 0
    assert said["against_truth"]["after_um"] < 12.0


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("tracker:silence", "no reply to HELLO"),
        ("tracker:wrong-identity", "does not speak GST/1"),
        ("cnc:wrong-identity", "this is not the register map"),
        ("cnc:alarm@row1", "the controller is in alarm"),
        ("tracker:silence@1s", "no sample has come for"),
    ],
)
def test_a_device_that_fails_is_one_line_and_a_one(fault, said, tmp_path, capsys):
    arguments = ["demo", *FAST, "-o", str(tmp_path / "out"), "--fault", fault]
    assert run(arguments) == 1
    captured = capsys.readouterr()
    *_, line = captured.err.splitlines()
    assert line.startswith("truepath: ")
    assert said in line
    assert captured.out == ""


def test_an_unknown_fault_is_bad_input(tmp_path, capsys):
    arguments = ["demo", "-o", str(tmp_path / "out"), "--fault", "tracker:boredom"]
    assert run(arguments) == 2
    assert "'tracker:boredom': unknown; known are" in capsys.readouterr().err


def test_too_short_a_time_is_bad_input_with_the_least(machine):
    with pytest.raises(PlanningError, match=r"give --minutes \d+\.\d or more"):
        plan_path(machine, 2500.0, 0.5)


@pytest.mark.parametrize("minutes", [1.0, 2.0, 4.0])
def test_the_path_takes_the_minutes_that_were_asked(machine, minutes):
    path = plan_path(machine, 6000.0, minutes)
    assert travel_time_s(path) / 60.0 == pytest.approx(minutes, rel=0.15)


def test_the_proof_is_exact_for_a_result_that_is_the_truth(analysed):
    """The truth less what the result says is nothing: 0 % left, all within 2 u."""
    import json

    from truepath.files.earlier.result_file import result_from_json
    from truepath.results.prediction import predict

    result = json.loads((analysed / "result.json").read_text())
    loaded = result_from_json(result)

    def truth_um(position_mm):
        moved = np.cross([3e-2, -1e-2, 2e-2], position_mm) + np.array([5.0, 6.0, 7.0])
        return predict(loaded, position_mm).error_um + moved

    found = compare_with_truth(result, truth_um)
    assert found.before_um > 1.0
    assert found.after_um == pytest.approx(0.0, abs=1e-6)
    assert found.covered == 1.0
