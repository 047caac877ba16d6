"""A driver of somebody else: installed, found, conforming, measured with."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from driven_cell import CALM
from measuring import Measuring
from paths_by_hand import ACROSS
from tracker_peers import read_samples
from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import CellConfig, MeasurementOrder
from truepath.measurement.run_file.run_loader import open_run
from truepath.plugins import load
from truepath.settings import load_settings
from truepath_drivers.conformance import checking
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.errors import DeviceTimeout, Refused
from truepath_simulators import errors, machine_file
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.replay.recorded_run import read_recorded_run

pytestmark = pytest.mark.long
EXAMPLE = Path(__file__).parents[3] / "docs" / "example-driver"
NAME = "othermake-lt50"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which the distribution is installed, as anybody installs it."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(EXAMPLE, folder / "source")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
    command += ["--no-index", "--no-build-isolation", "--target", str(folder / "site")]
    subprocess.run([*command, str(source)], check=True, capture_output=True)
    return folder / "site"


@pytest.fixture(autouse=True)
def installed(site, monkeypatch):
    monkeypatch.syspath_prepend(site)


@pytest.fixture(scope="module")
def rig():
    with running_rig({"seed": 6, "speed": 10.0}) as started:
        yield started


@contextmanager
def imitate(rig, share=0.0):
    """Start an instrument that looks at the rig's machine; yield where it listens."""
    script = EXAMPLE / "imitate_othermake.py"
    command = [sys.executable, script, rig.control, str(share)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield {"host": "127.0.0.1", "port": int(process.stdout.readline())}
        process.kill()


@pytest.fixture(scope="module")
def options(rig):
    with imitate(rig) as options:
        yield options


@pytest.mark.parametrize("check", TRACKER_CHECKS)
def test_it_conforms(options, check):
    make = load("truepath.trackers", NAME)
    with checking.on_terms(rate_hz=50.0):
        check(lambda: make(**options))


@pytest.fixture(scope="module")
def control():
    command = [sys.executable, EXAMPLE / "imitate_control.py", "4"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield {"host": "127.0.0.1", "port": int(process.stdout.readline())}
        process.kill()


@pytest.mark.parametrize("check", MOTION_CHECKS, ids=lambda check: check.__name__)
def test_the_control_conforms(control, check):
    make = load("truepath.motion_controllers", "othermake-c7")
    check(lambda: make(**control))


def test_a_control_that_stops_answering_is_told_and_hung_up():
    make = load("truepath.motion_controllers", "othermake-c7")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        away = make("127.0.0.1", silent.getsockname()[1], reply_timeout_s=0.2)
        with pytest.raises(DeviceTimeout, match=r"no reply to WHO in 0\.2 s; check"):
            away.connect()
        heard, _ = silent.accept()
        with heard:
            assert heard.recv(100) == b"WHO\r\n"
            assert heard.recv(100) == b"", "and it has hung up"


def test_it_says_when_it_is_away_and_where_to_give_another_rate(options, free_port):
    make = load("truepath.trackers", NAME)
    away = partial(make, "127.0.0.1", free_port)
    checking.a_device_that_is_not_there_is_a_device_error(away)
    with make(**options) as tracker, pytest.raises(Refused, match="rate_hz in machine"):
        tracker.start(500.0)


def test_damaged_lines_are_counted_and_never_samples(rig):
    make = load("truepath.trackers", NAME)
    with imitate(rig, share=0.2) as worn, make(**worn) as tracker:
        tracker.start(50.0)
        read = read_samples(tracker, 300)
        health = tracker.health

    assert health.crc_errors > 20
    assert read.lost > 20
    assert np.ptp(read.position_mm, axis=0).max() < 0.1


def test_it_measures_by_the_settings_alone(rig, options, tmp_path):
    file = tmp_path / "truepath.toml"
    file.write_text(
        f'tracker_driver = "{NAME}"\n'
        "[tracker_options]\n"
        f'host = "{options["host"]}"\n'
        f"port = {options['port']}\n"
        "reply_timeout_s = 2.0\n"
        "[motion_options]\n"
        f'host = "{rig.motion_options["host"]}"\n'
        f"port = {rig.motion_options['port']}\n"
    )
    run_file = tmp_path / "run.sqlite"
    settings, content = load_settings(file), machine_file.load_machine("demo")
    content["tracker"]["rate_hz"] = 50.0
    tracker = settings.tracker_driver, settings.tracker_options
    motion = settings.motion_driver, settings.motion_options
    config = CellConfig(*tracker, *motion, CALM)
    machine = machine_from_json(content)
    order = MeasurementOrder("theirs", str(run_file), machine, ACROSS, rate_hz=50.0)
    with Measuring(config, order) as measuring:
        closed = measuring.until_closed()
    assert measuring.faults == set()
    run = open_run(run_file)
    assert closed.lost_samples == 0
    assert "Othermake LT-50 4711" in run.provenance["tracker"]
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert np.median(np.diff(run.tracker.device_time_s)) == pytest.approx(0.02)
    # Right-handed, in mm and s: the lines are found, and each is as long as it was.
    passes = align(run).passes
    assert [p.row for p in passes] == [1, 2, 3, 4]
    with pytest.raises(errors.SimulatorError, match="GST/1"):  # it is another protocol
        read_recorded_run(run_file)
