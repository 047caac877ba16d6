"""`trend`: a machine whose X scale warms, from short bundles to files."""

import json
from unittest.mock import Mock

import numpy as np
import pytest

from truepath.files.bundle.bundle import read_bundle, zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.workers.analysis_tasks import follow_recorded
from truepath.planning.lines.default_path import default_path
from truepath.service.api.models.results.trend import TrendOut
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.bundle_files import write_bundle_files
from warm_machine import load_slow_tracker, record_warm, stretch

HOURS, TAU_H, GROWTH = (0.0, 0.3, 0.9, 2.0), 0.5, 60e-6
AT = ",".join(map(str, HOURS))


def write_bundles(content, path, folder):
    truth = random_machine(parse_machine(content), 5)
    places = [folder / f"run{number}" for number in range(len(HOURS))]
    for number, place in enumerate(places):
        strain = GROWTH * -np.expm1(-HOURS[number] / TAU_H)
        grown = stretch(truth, "X", strain)
        write_bundle_files(place, record_warm(content, path, grown, 40 + number))
    return places


@pytest.fixture(scope="module")
def warming(tmp_path_factory):
    content = load_slow_tracker("demo")
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
    grown_um = -1e3 * GROWTH * length_mm * np.expm1(-hours / TAU_H)
    return far_end_um - far_end_um[0], grown_um


def test_a_scale_that_warms_is_followed_and_said_when_due(command, warming, tmp_path):
    asked = ["--at", AT, "--limit", "4", "--later", "1", "-o", tmp_path]
    command.run("trend", *warming, *asked)
    content = json.loads((tmp_path / "trend.json").read_text())
    assert content["schema"] == "trend/1"
    assert [at["time_h"] for at in content["runs"]] == pytest.approx(HOURS)
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    said = ("due", "cannot-be-said", "not-within-horizon")
    assert content["outlook"]["state"] in said
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
def test_what_is_wrong_with_times_is_said(command, warming, tmp_path, options, problem):
    order = ["trend", *warming, "-o", tmp_path / "out", *options]
    assert problem in command.refuse(*order)


def test_the_same_bundle_twice_is_refused(command, warming, tmp_path):
    asked = ["--at", "0,1,2", "-o", tmp_path / "out"]
    said = command.refuse("trend", *warming[:2], warming[0], *asked)
    assert "run0 (1) and run0 (3) are the same Run" in said


def test_the_task_of_a_job_writes_what_the_command_writes(warming, tmp_path):
    names = ["cold", "warm"]
    zipped = [tmp_path / f"{name}.zip" for name in names]
    for file, bundle in zip(zipped, warming, strict=False):
        file.write_bytes(zip_bundle(read_bundle(bundle)))
    asked = {"at_h": [8.0, 9.0], "limit_um": 4.0}
    files, told = list(map(str, zipped)), Mock()
    follow_recorded(files, names, str(tmp_path / "out"), asked, on_progress=told)
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    assert [at["name"] for at in content["runs"]] == names
    assert [at["time_h"] for at in content["runs"]] == [0.0, 1.0]
    assert content["outlook"]["state"] == "not-known"
    stages = {call.args[1] for call in told.call_args_list}
    assert {"estimating", "following"} <= stages


@pytest.mark.long
@pytest.mark.timeout(600)
def test_five_axes_with_six_targets_are_followed(command, tmp_path):
    content = load_slow_tracker("trunnion")
    path = default_path(machine_from_json(content, file=""))
    bundles = write_bundles(content, path, tmp_path)
    asked = ["--at", AT, "--limit", "5", "-o", tmp_path / "out"]
    command.run("trend", *bundles, *asked)
    content = json.loads((tmp_path / "out" / "trend.json").read_text())
    TrendOut.model_validate(content, extra="forbid")
    found_um, grown_um = find_growth_um(content)
    assert np.abs(found_um - grown_um).max() < 1.5
    places = [at["axis_location"] for at in content["runs"]]
    assert {"YOA", "XOC"} <= places[0].keys()
    for name in ("YOA", "XOC"):
        stay = np.array([place[name]["value_um"] for place in places])
        assert np.ptp(stay) < 2.0
