"""The command `truepath simulate` as a process, with our drivers at its links."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import psutil
import pytest

from processes import until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.command import main


@contextmanager
def simulating(*options):
    module = "truepath_simulators.bench.command"
    words = [sys.executable, "-m", module, "--json", *options]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen(words, **pipes)
    try:
        yield process, json.loads(process.stdout.readline())
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    return tmp_path_factory.mktemp("lines")


@pytest.fixture(scope="module")
def polled(lines):
    """An instrument that is asked point by point, all links of it serial."""
    options = ["--speed", "20", "--protocol", "geocom", "--rtu", "--links", str(lines)]
    with simulating(*options) as command:
        yield command


def test_it_serves_by_tcp_and_takes_orders_by_standard_input_until_ctrl_c():
    with simulating("--tracker", "tcp") as (process, where):
        with ModbusController(**where["modbus_tcp"]) as motion:
            assert motion.status().state is MotionState.IDLE
        with StreamingTracker(**where["tracker"]) as tracker:
            tracker.start(500.0)
            with pytest.raises(DeviceError):  # a second host does not take it over
                StreamingTracker(**where["tracker"]).connect()
            before_mm = measure_range_mm(tracker)
            order(process, "move here", "move 3000,200,0")
            until(lambda: abs(measure_range_mm(tracker) - before_mm) > 500.0)
            assert measure_range_mm(tracker) == pytest.approx(3000.0, abs=400.0)
        with StreamingTracker(**where["tracker"]) as tracker:
            tracker.start(500.0)
            assert len(tracker.read(0.5)) > 0
            order(process, "tracker:beam-break")
            until(lambda: bool(tracker.read(0.1).status.any()))
        leaves_nothing(process, where, signal.SIGINT)


def leaves_nothing(process, where, number):
    process.send_signal(number)
    assert process.wait(10) == 0
    assert not any(psutil.pid_exists(pid) for pid in where["pids"].values())


@pytest.mark.long
def test_an_instrument_that_is_asked_point_by_point_follows_the_machine(polled):
    _, where = polled
    with (
        GeoComTracker(**where["tracker"]) as tracker,
        ModbusController(**where["modbus_rtu"]) as motion,
    ):
        before_mm = tracker.measure(0.0).position_mm
        begin = np.array(motion.status().position)
        motion.move_to((100.0, 200.0, 50.0), 6000.0)
        assert motion.wait(20.0).state is MotionState.FINISHED
        way_mm = np.linalg.norm(np.array([100.0, 200.0, 50.0]) - begin)
        moved_mm = tracker.measure(0.0).position_mm - before_mm
    assert np.linalg.norm(moved_mm) == pytest.approx(way_mm, abs=0.5)


@pytest.mark.long
def test_another_rig_leaves_the_lines_of_the_first_until_sigterm(polled, lines, capsys):
    process, where = polled
    assert where["tracker"]["port"] == str(lines / "tracker")
    assert main(["--rtu", "--links", str(lines)]) == 2
    assert "another rig" in capsys.readouterr().err
    with ModbusController(**where["modbus_rtu"]) as motion:
        assert motion.axes == ("X", "Y", "Z")
    leaves_nothing(process, where, signal.SIGTERM)


def order(process, *lines):
    process.stdin.writelines(f"{line}\n" for line in lines)
    process.stdin.flush()


def measure_range_mm(tracker):
    return float(np.linalg.norm(tracker.read(2.0).position_mm[-1]))
