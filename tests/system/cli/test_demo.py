"""`demo` and `record`: whole jobs over a pty and Modbus TCP, and devices that fail."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle import commanded_file, machine_file
from truepath.files.bundle.bundle import read_bundle
from truepath.motion.motion_times import travel_time_s
from truepath.motion.nc_programs.programs import read_program, write_program
from truepath.planning.default_path import default_path
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces import errors, records
from truepath_simulators.bench.bench import Bench

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


MAIN = "from truepath.cli.command import main; main()"
SPEED, OVERRIDE = 16.0, 0.8
PATIENCE_S = 40.0


@pytest.fixture
def bench():
    with Bench(seed=4, speed=SPEED, tracker="tcp", rtu=False) as bench:
        yield bench


@pytest.fixture
def files(bench, tmp_path, monkeypatch):
    machine = machine_file.machine_from_json(bench.machine)
    path = default_path(machine, 15_000.0, lines=8)
    (tmp_path / "machine.json").write_text(json.dumps(bench.machine))
    (tmp_path / "path.csv").write_bytes(commanded_file.encode_commanded(path))
    (tmp_path / "path.h").write_text(write_program(path, machine, "heidenhain"))
    (tmp_path / "settings.toml").write_text('thermometer_driver = "modbus-registers"')
    for device in ("tracker", "thermometer"):
        options = json.dumps(getattr(bench, f"{device}_options"))
        monkeypatch.setenv(f"TRUEPATH_{device.upper()}_OPTIONS", options)
    return tmp_path


@pytest.fixture
def recording(files):
    started = []

    def begin(*more):
        words = ["record", "path.csv", "-o", "bundle", "--machine", "machine.json"]
        words += ["--config", "settings.toml", *more]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        how = {"cwd": files, "env": {**os.environ, "OMP_NUM_THREADS": "1"}, **pipes}
        process = subprocess.Popen([sys.executable, "-c", MAIN, *words], **how)
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def until_it_records(process):
    deadline_s = time.monotonic() + PATIENCE_S
    while "press Ctrl-C" not in (line := process.stderr.readline()):
        assert line, process.communicate()
        assert time.monotonic() < deadline_s


def stand(bench, seconds):
    """Let so much of the machine's time pass, on the tracker's own clock."""
    end_s = time.monotonic() + seconds / SPEED
    while (left_s := end_s - time.monotonic()) > 0:
        select.select([], [], [], left_s)


def until_it_stands(cnc):
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        cnc.send_heartbeat()
        try:
            return cnc.wait(0.2)
        except errors.DeviceTimeout:
            assert time.monotonic() < deadline_s


def test_a_cnc_without_link_is_calibrated(bench, files, recording, volume, rigid_free):
    motion = read_program((files / "path.h").read_text(), "heidenhain")
    process = recording("--json")
    until_it_records(process)
    stand(bench, 2.0)
    # What the control does with the program, over a link the recorder has not.
    with ModbusController(**bench.motion_options) as cnc:
        cnc.move_to(motion.position[0], 15_000.0)
        until_it_stands(cnc)
        feed_mm_min = OVERRIDE * motion.path.feed_mm_min
        cnc.load(replace(motion.path, feed_mm_min=feed_mm_min))
        cnc.start()
        assert until_it_stands(cnc).state is records.MotionState.FINISHED
    stand(bench, 2.0)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    said = json.loads(out)
    assert said["lost_samples"] == 0
    bundle = files / "bundle"
    names = "machine.json path.csv tracker.parquet environment.csv run.sqlite"
    assert {p.name for p in bundle.iterdir()} == set(names.split())
    recorded = read_bundle(bundle)
    assert len(recorded.tracker) == said["samples"] > 5000
    assert recorded.temperature.names == ("X", "Y", "Z", "spindle", "air")
    assert run(["analyse", str(bundle), "-o", str(files / "result")]) == 0
    machine = machine_file.machine_from_json(bench.machine)
    q = volume(machine)
    np.savetxt(files / "q.csv", q, "%.6f", ",", header="x_mm,y_mm,z_mm", comments="")
    arguments = ["--points", str(files / "q.csv"), "-o", str(files / "map.csv")]
    assert run(["predict", str(files / "result" / "result.json"), *arguments]) == 0
    found = np.genfromtxt(files / "map.csv", delimiter=",", names=True)
    error = np.stack([found[f"d{axis}_um"] for axis in "xyz"], axis=1)
    true = bench.truth.deviation_mm(q)
    before, left = (rigid_free(q, e) for e in (true, true - 1e-3 * error))
    assert np.sqrt(np.mean(left**2)) < 0.15 * np.sqrt(np.mean(before**2))


def test_a_recording_ends_after_the_seconds_that_were_given(recording, files):
    process = recording("--seconds", "1")
    out, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert "samples, 0 lost" in out
    assert (files / "bundle" / "tracker.parquet").is_file()


def test_a_silent_tracker_ends_the_recording_and_keeps_it(bench, recording, files):
    process = recording()
    until_it_records(process)
    bench.inject("tracker:silence")
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "no sample has come for some seconds" in err
    assert (files / "bundle" / "run.sqlite").is_file()


def test_without_machine_or_beside_a_recording_it_says_so(files, command, monkeypatch):
    monkeypatch.chdir(files)
    words = ["record", "path.csv", "-o", "bundle", "--config", "settings.toml"]
    assert "--machine MACHINE.json" in command.refuse(*words)
    (files / "bundle").mkdir()
    (files / "bundle" / "run.sqlite").write_text("")
    said = command.refuse(*words, "--machine", "machine.json")
    assert "name another folder" in said
