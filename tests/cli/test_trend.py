"""`trend`: a machine whose X scale warms, from short bundles to files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import read_bundle, zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.workers.science import follow_recorded
from truepath.planning.lines.default_path import default_path
from truepath.service.api.models.results.trend import TrendOut
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.bundle_files import write_bundle_files
from truepath_simulators.worlds.synthetic import Setting

HOURS, TAU_H, GROWTH = (0.0, 0.3, 0.9, 2.0), 0.5, 60e-6
AT = ",".join(map(str, HOURS))


def warm(truth, hours):
    """Return the machine with its X scale as long as it is after some hours."""
    joint = truth.joints["X"]
    strain = GROWTH * -np.expm1(-hours / TAU_H)
    axis = truth.machine.linear_axes[0]
    grown = joint.translation[0].shift(strain * (axis.low - axis.zero_mm), strain)
    joints = {
        **truth.joints,
        "X": replace(joint, translation=(grown, *joint.translation[1:])),
    }
    return replace(truth, joints=joints)


def write_bundles(content, path, folder):
    """Write a bundle of the machine at each hour; return their places."""
    truth = random_machine(parse_machine(content), 5)
    speed = path.feed_mm_min / 60.0
    program = Program(path.position, speed, path.dwell_s, target=path.target)
    places = [folder / f"run{number}" for number in range(len(HOURS))]
    for number, place in enumerate(places):
        setting = Setting(truth=warm(truth, HOURS[number]))
        recording = synthetic.record(content, program, 40 + number, "otf", setting)
        write_bundle_files(place, recording)
    return list(map(str, places))


@pytest.fixture(scope="module")
def warming(tmp_path_factory):
    """Bundles of the machine."""
    content = {**load_machine("demo")}
    content["tracker"] = {**content["tracker"], "rate_hz": 100}
    for axis in content["axes"].values():
        axis["max_mm"] = axis["min_mm"] + 300.0
    path = default_path(machine_from_json(content, file=""), 9000.0, lines=14)
    return write_bundles(content, path, tmp_path_factory.mktemp("warming"))


def find_growth_um(content):
    """Return how the far end of X grew since the first Run, and in truth."""
    times = [*content["runs"], *content["later"]]
    tables = [at["error_tables"]["EXX"] for at in times]
    far_end_um = np.array([table["value_um"][-1] for table in tables])
    length_mm = tables[0]["position_mm"][-1] - tables[0]["position_mm"][0]
    hours = np.array([at["time_h"] for at in times])
    return far_end_um - far_end_um[0], -1e3 * GROWTH * length_mm * np.expm1(
        -hours / TAU_H
    )


def test_a_scale_that_warms_is_followed_and_said_when_due(warming, tmp_path):
    asked = ["--at", AT, "--limit", "4", "--later", "1", "-o", str(tmp_path)]
    assert run(["trend", *warming, *asked]) == 0
    content = json.loads((tmp_path / "trend.json").read_text())
    assert content["schema"] == "trend/1"
    assert [at["time_h"] for at in content["runs"]] == pytest.approx(HOURS)
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    assert content["outlook"]["state"] in (
        "due",
        "cannot-be-said",
        "not-within-horizon",
    )
    TrendOut.model_validate(content, extra="forbid")
    page = (tmp_path / "report.html").read_text()
    assert content["outlook"]["sentence"] in page
    assert "spindle" in page
    assert "<svg" in page


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--at", "0,1"], "2 times are given for 4 Runs"),
        (["--at", "0,2,1,3"], "do not increase"),
        (["--at", "0,x"], "write hours"),
        ([], "--at"),
        (["--at", AT, "--temperature", "oil=20"], "has no temperature oil"),
        (["--at", AT, "--temperature", "X"], "NAME=DEGC"),
    ],
)
def test_what_is_wrong_with_times_and_temperatures_is_said(
    warming, tmp_path, capsys, options, problem
):
    assert run(["trend", *warming, "-o", str(tmp_path / "out"), *options]) == 2
    assert problem in capsys.readouterr().err


def test_the_same_bundle_twice_is_refused(warming, tmp_path, capsys):
    asked = ["--at", "0,1,2", "-o", str(tmp_path / "out")]
    assert run(["trend", *warming[:2], warming[0], *asked]) == 2
    said = capsys.readouterr().err
    assert "run0 (1) and run0 (3) are the same Run" in said


def test_the_task_of_a_job_writes_what_the_command_writes(warming, tmp_path):
    names = ["cold", "warm"]
    zipped = [tmp_path / f"{name}.zip" for name in names]
    for file, bundle in zip(zipped, warming, strict=False):
        file.write_bytes(zip_bundle(read_bundle(bundle)))
    asked = {"at_h": [8.0, 9.0], "limit_um": 4.0}
    files, stages = list(map(str, zipped)), []

    def note(share, stage):
        stages.append(stage)

    follow_recorded(files, names, str(tmp_path / "out"), asked, on_progress=note)
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    assert [at["name"] for at in content["runs"]] == names
    assert [at["time_h"] for at in content["runs"]] == [0.0, 1.0]
    assert content["outlook"]["state"] == "not-known"
    assert {"estimating", "following"} <= set(stages)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_five_axes_with_six_targets_are_followed(tmp_path):
    content = {**load_machine("trunnion")}
    content["tracker"] = {**content["tracker"], "rate_hz": 100}
    path = default_path(machine_from_json(content, file=""))
    bundles = write_bundles(content, path, tmp_path)
    asked = ["--at", AT, "--limit", "5", "-o", str(tmp_path / "out")]
    assert run(["trend", *bundles, *asked]) == 0
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    places = [at["axis_location"] for at in content["runs"]]
    assert {"YOA", "XOC"} <= places[0].keys()
    for name in ("YOA", "XOC"):
        stay = np.array([place[name]["value_um"] for place in places])
        assert np.ptp(stay) < 2.0
