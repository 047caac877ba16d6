"""`demo`: the whole job over a pty and Modbus TCP, and what it says when devices fail.

The device clocks run fast; the links, the processes and the bytes are the real ones.
What each fault of a device is answered with is held in tests/simulators and
tests/measurement: here stand one at the beginning and one under way.
"""

import pytest

from truepath.files.bundle.bundle import read_bundle
from truepath.motion.motion_times import travel_time_s

SILENT = pytest.param("tracker:silence", "no reply to HELLO", marks=pytest.mark.long)
FAST = ("--speed", "8", "--feed", "15000")


@pytest.mark.timeout(120)
def test_the_main_job_ends_in_tables_that_the_truth_confirms(command, tmp_path):
    out = tmp_path / "out"
    said = command.json("demo", *FAST, "-o", out)
    assert said["lost_samples"] == 0
    assert said["samples"] > 10_000
    against = said["against_truth"]
    assert against["left"] < 0.1
    assert against["covered"] > 0.85
    names = {path.name for path in out.iterdir()}
    assert names >= {"result.json", "error_tables.csv", "report.html", "run.sqlite"}
    assert len(read_bundle(out / "bundle").tracker) == said["samples"]


@pytest.mark.long
@pytest.mark.timeout(120)
def test_a_target_ends_the_measurement_early_with_tables(command, tmp_path):
    out = tmp_path / "out"
    fast = ("--speed", "8", "--feed", "6000", "--target-um", "10")
    said = command.json("demo", *fast, "-o", out)
    whole_s = travel_time_s(read_bundle(out / "bundle").commanded)
    assert said["samples"] < 0.9 * 500 * whole_s
    assert said["lost_samples"] == 0
    assert said["against_truth"]["after_um"] < 12.0


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_circle_leaves_what_is_stated_of_the_machine(command, tmp_path):
    out = tmp_path / "out"
    said = command.json("demo", *FAST, "--compensate", "-o", out)
    before, left = said["against_truth"]["before_um"], said["as_left"]
    assert before > 10.0  # of the machine as found
    assert abs(left["map_scale"]["value"]) < 0.05
    assert left["volumetric_error_um"]["measured"]["mean"] < 0.15 * before
    assert (out / "as-left" / "report.html").is_file()


@pytest.mark.parametrize(
    ("fault", "line"), [SILENT, ("cnc:alarm@row1", "the controller is in alarm")]
)
def test_a_device_that_fails_is_one_line_and_a_one(fault, line, command, tmp_path):
    order = ["demo", *FAST, "-o", tmp_path / "out", "--fault", fault]
    assert line in command.refuse(*order, status=1)
