from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_simulators.bench.command import main

Command = tuple["subprocess.Popen[str]", dict[str, Any]]


@pytest.fixture
def simulate() -> Iterator[Callable[..., Command]]:
    started: list[subprocess.Popen[str]] = []

    def run(*options: str) -> Command:
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "truepath_simulators.bench.command",
                "--json",
                *options,
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        return process, json.loads(process.stdout.readline())

    yield run
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_a_signal_and_leaves_nothing(
    simulate: Callable[..., Command], number: signal.Signals
) -> None:
    process, where = simulate("--tracker", "tcp")
    with ModbusController(**where["modbus_tcp"]) as motion:
        assert motion.status().state is MotionState.IDLE
    with StreamingTracker(**where["tracker"]) as tracker:
        tracker.start(500.0)
        assert len(tracker.read(2.0)) > 0
    process.send_signal(number)
    assert process.wait(10) == 0
    assert not any(psutil.pid_exists(pid) for pid in where["pids"].values())


def test_a_rig_finds_the_serial_lines_by_name(
    simulate: Callable[..., Command], tmp_path: Path
) -> None:
    _, where = simulate("--rtu", "--links", str(tmp_path))
    assert where["tracker"]["port"] == str(tmp_path / "tracker")
    with ModbusController(**where["modbus_rtu"]) as motion:
        assert motion.axes == ("X", "Y", "Z")


def test_a_line_on_standard_input_is_a_fault(
    simulate: Callable[..., Command],
) -> None:
    process, where = simulate("--tracker", "tcp")
    with StreamingTracker(**where["tracker"]) as tracker:
        tracker.start(500.0)
        order(process, "tracker:beam-break")
        wait_until(lambda: bool(tracker.read(0.1).status.any()))


def test_a_line_on_standard_input_moves_the_tracker(
    simulate: Callable[..., Command],
) -> None:
    process, where = simulate("--tracker", "tcp")
    with StreamingTracker(**where["tracker"]) as tracker:
        tracker.start(500.0)
        before_mm = measure_range_mm(tracker)
        order(process, "move here", "move 3000,200,0")
        wait_until(lambda: abs(measure_range_mm(tracker) - before_mm) > 500.0)
        assert measure_range_mm(tracker) == pytest.approx(3000.0, abs=400.0)


@pytest.mark.parametrize(
    ("options", "driver"),
    [
        (("--protocol", "geocom"), GeoComTracker),
        (("--protocol", "geocom", "--tracker", "tcp"), GeoComTracker),
        (("--protocol", "t2sa", "--tracker", "tcp"), T2saTracker),
    ],
)
def test_an_instrument_that_is_asked_point_by_point_follows_the_machine(
    simulate: Callable[..., Command],
    options: tuple[str, ...],
    driver: type[GeoComTracker | T2saTracker],
) -> None:
    _, where = simulate("--speed", "20", *options)
    with (
        driver(**where["tracker"]) as tracker,
        ModbusController(**where["modbus_tcp"]) as motion,
    ):
        before_mm = tracker.measure(0.0).position_mm
        begin = np.array(motion.status().position)
        motion.move_to((100.0, 200.0, 50.0), 6000.0)
        assert motion.wait(20.0).state is MotionState.FINISHED
        way_mm = np.linalg.norm(np.array([100.0, 200.0, 50.0]) - begin)
        moved_mm = tracker.measure(0.0).position_mm - before_mm
    assert np.linalg.norm(moved_mm) == pytest.approx(way_mm, abs=0.5)


def test_killed_it_takes_its_simulators_along(
    simulate: Callable[..., Command],
) -> None:
    process, where = simulate()
    os.kill(process.pid, signal.SIGKILL)
    process.wait(10)
    wait_until(lambda: not any(runs(pid) for pid in where["pids"].values()))


def order(process: subprocess.Popen[str], *lines: str) -> None:
    """Write lines to a command's standard input."""
    assert process.stdin is not None
    process.stdin.writelines(f"{line}\n" for line in lines)
    process.stdin.flush()


def wait_until(is_met: Callable[[], bool]) -> None:
    """Wait for a condition, five seconds at most."""
    deadline_s = time.monotonic() + 5.0
    while not is_met():
        assert time.monotonic() < deadline_s


def measure_range_mm(tracker: StreamingTracker) -> float:
    """Return the distance of the last sample that has come."""
    return float(np.linalg.norm(tracker.read(2.0).position_mm[-1]))


def runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--machine", "nowhere.json"], "nowhere.json"),
        (["--fault", "tracker:explode"], "explode"),
        (["--speed", "0"], "speed"),
        (["--speed", "nan"], "speed"),
        (["--seed", "-1"], "seed"),
        (["--tracker-port", "99999"], "tracker-port"),
        (["--modbus-port", "-5"], "modbus-port"),
        (["--error-scale", "inf"], "error-scale"),
        (["--protocol", "t2sa"], "over TCP alone"),
    ],
)
def test_bad_input_is_exit_status_2_and_a_clear_line(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status: object = main(options)
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert said in capsys.readouterr().err


def test_it_is_found_by_its_entry_point() -> None:
    (point,) = entry_points(group="truepath.simulators", name="command")
    assert point.load() is main


def test_a_file_of_somebody_else_is_not_touched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tracker"
    file.write_text("kept")
    assert main(["--links", str(tmp_path)]) == 2
    assert "exists" in capsys.readouterr().err
    assert file.read_text() == "kept"


def test_a_second_rig_leaves_the_links_of_the_first(
    simulate: Callable[..., Command],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, where = simulate("--rtu", "--links", str(tmp_path))
    assert main(["--rtu", "--links", str(tmp_path)]) == 2
    assert "another rig" in capsys.readouterr().err
    with ModbusController(**where["modbus_rtu"]) as motion:
        assert motion.axes == ("X", "Y", "Z")


def test_a_second_host_does_not_take_over_a_running_tracker(
    simulate: Callable[..., Command],
) -> None:
    _, where = simulate("--tracker", "tcp")
    with StreamingTracker(**where["tracker"]) as tracker:
        tracker.start(500.0)
        with pytest.raises(DeviceError):
            StreamingTracker(**where["tracker"]).connect()
        tracker.read(0.2)
        assert len(tracker.read(0.5)) > 0
    with StreamingTracker(**where["tracker"]) as tracker:
        tracker.start(500.0)
        assert len(tracker.read(0.5)) > 0
