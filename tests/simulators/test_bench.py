"""Both simulators as processes, with our drivers at the other end of the wire."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceError,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import (
    MotionState,
    MotionStatus,
    TrackerSamples,
)
from truepath_drivers.interfaces.records import Path as MotionPath
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden.screws import Backlash
from truepath_simulators.machine import tracker_head
from truepath_simulators.machine_file import parse_machine

LINE = MotionPath(
    ("X", "Y", "Z"),
    np.array([[100.0, 100.0, 100.0], [400.0, 300.0, 100.0]]),
    np.full(2, 6000.0),
    np.full(2, 0.2),
)

CLIENT = """
import sys, time
import numpy as np
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.records import Path
from truepath_drivers.tracker.streaming.driver import StreamingTracker

motion = ModbusController(**eval(sys.argv[1]))
motion.connect()
tracker = StreamingTracker(**eval(sys.argv[2]))
tracker.connect()
tracker.start(500.0)
corners = np.array([[0.0, 0.0, 0.0], [500.0, 400.0, 300.0]] * 20)
n = len(corners)
motion.load(Path(("X", "Y", "Z"), corners, np.full(n, 3000.0), np.zeros(n)))
motion.start()
while True:
    motion.send_heartbeat()
    tracker.read(0.05)
    print(motion.status().state, flush=True)
"""


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(Bench(**options))


@pytest.fixture
def driven() -> Iterator[Callable[[Bench], tuple[StreamingTracker, ModbusController]]]:
    with ExitStack() as stack:

        def connect(running: Bench) -> tuple[StreamingTracker, ModbusController]:
            tracker = StreamingTracker(**running.tracker_options)
            motion = ModbusController(**running.motion_options)
            return stack.enter_context(tracker), stack.enter_context(motion)

        yield connect


def until(condition: Callable[[], Any], timeout_s: float = 10.0) -> Any:
    deadline_s = time.monotonic() + timeout_s
    while not (met := condition()):
        assert time.monotonic() < deadline_s, "waited in vain"
        select.select([], [], [], 0.02)
    return met


def read_for(tracker: StreamingTracker, duration_s: float) -> TrackerSamples:
    blocks, end_s = [], time.monotonic() + duration_s
    while time.monotonic() < end_s:
        blocks.append(tracker.read(0.1))
    return TrackerSamples.join(blocks)


def drive(motion: ModbusController) -> MotionStatus:
    """Run the loaded path, beating, until it stands."""
    motion.start()
    return until(lambda: stands(motion), 30.0)


def stands(motion: ModbusController) -> MotionStatus | None:
    motion.send_heartbeat()
    status = motion.status()
    return None if status.state is MotionState.RUNNING else status


def runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_no_sample_is_lost_at_500_hz_over_a_pty(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    tracker, _ = driven(bench(seed=1))
    tracker.start(500.0)
    samples = read_for(tracker, 4.0)
    np.testing.assert_array_equal(np.diff(samples.sequence), 1)
    span_s = samples.device_time_s[-1] - samples.device_time_s[0]
    assert span_s > 3.6
    assert (len(samples) - 1) / span_s == pytest.approx(500.0, rel=1e-3)
    health = tracker.health
    assert (health.lost_samples, health.crc_errors, health.device_overflows) == (
        0,
        0,
        0,
    )


@pytest.mark.parametrize("link", ["pty", "tcp"])
def test_no_sample_is_lost_at_5_khz(
    bench: Callable[..., Bench], driven: Callable[..., Any], link: str
) -> None:
    tracker, _ = driven(bench(seed=1, tracker=link))
    tracker.start(5000.0)
    samples = read_for(tracker, 1.0)
    assert 4000 < len(samples) < 5500
    assert tracker.health.lost_samples == 0


def test_the_tracker_sees_what_the_cnc_does(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    running = bench(seed=6, speed=5.0)
    tracker, motion = driven(running)
    motion.load(LINE)
    assert drive(motion).state is MotionState.FINISHED
    tracker.start(500.0)
    seen = read_for(tracker, 0.5).position_mm.mean(axis=0)
    machine = parse_machine(running.machine)
    q = LINE.position[-1:]
    pose = tracker_head.random_pose(machine, 6)
    expected = pose.from_table(
        q + machine.reflector().offset_mm + 1e-3 * running.truth_at(q)
    )[0]
    # The mean of a second of samples keeps the slow part of the noise.
    np.testing.assert_allclose(seen, expected, atol=5e-3)
    assert np.linalg.norm(running.truth_at(q)) > 5.0


def test_the_tracker_sees_what_the_machine_hides(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    hidden = (Backlash("X", 200.0), Backlash("Y", 100.0))
    running = bench(seed=6, speed=5.0, hidden=hidden, error_scale=0.0)
    tracker, motion = driven(running)
    motion.load(LINE)
    assert drive(motion).state is MotionState.FINISHED
    tracker.start(500.0)
    seen = read_for(tracker, 0.5).position_mm.mean(axis=0)
    machine = parse_machine(running.machine)
    pose = tracker_head.random_pose(machine, 6)
    nominal = LINE.position[-1] + machine.reflector().offset_mm
    off = pose.position_mm + pose.rotation @ seen - nominal
    # Both axes came from below: they stop short by half of their play.
    np.testing.assert_allclose(off, [-0.1, -0.05, 0.0], atol=6e-3)


def test_a_fast_clock_measures_more_in_a_second(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    tracker, _ = driven(bench(seed=1, speed=8.0))
    tracker.start(500.0)
    samples = read_for(tracker, 1.0)
    assert 3000 < len(samples) < 4400
    np.testing.assert_allclose(np.diff(samples.device_time_s), 0.002, atol=1.1e-6)


def test_tcp_and_serial_masters_see_one_machine(bench: Callable[..., Bench]) -> None:
    running = bench(seed=1, speed=5.0)
    with (
        ModbusController(**running.motion_options) as tcp,
        ModbusController(**running.motion_options_rtu) as rtu,
    ):
        assert tcp.connect() == rtu.connect()
        tcp.load(LINE)
        assert rtu.status().state is MotionState.READY
        with pytest.raises(Refused, match="another"):
            rtu.start()  # it does not know the path
        assert drive(tcp).state is MotionState.FINISHED
        assert rtu.axis_positions() == pytest.approx(tuple(LINE.position[-1]))


@pytest.mark.fault_row(21)
def test_a_path_that_another_master_has_loaded_meanwhile_is_not_driven(
    bench: Callable[..., Bench],
) -> None:
    running = bench(seed=1, speed=5.0)
    with (
        ModbusController(**running.motion_options) as tcp,
        ModbusController(**running.motion_options_rtu) as rtu,
    ):
        here = tcp.status().position
        tcp.load(LINE)
        rtu.load(replace(LINE, feed_mm_min=0.5 * LINE.feed_mm_min))
        with pytest.raises(Refused, match="another"):
            tcp.start()
        assert tcp.status().state is MotionState.READY
        assert tcp.status().position == here


def test_when_the_client_is_killed_the_machine_holds_and_serves_the_next(
    bench: Callable[..., Bench], driven: Callable[..., Any], tmp_path: Path
) -> None:
    running = bench(seed=1)
    script = tmp_path / "client.py"
    script.write_text(CLIENT)
    options = [repr(running.motion_options), repr(running.tracker_options)]
    with subprocess.Popen(
        [sys.executable, str(script), *options], stdout=subprocess.PIPE, text=True
    ) as client:
        assert client.stdout is not None
        until(lambda: client.stdout and "running" in client.stdout.readline())
        client.kill()
    tracker, motion = driven(running)
    status = until(lambda: held(motion), 5.0)
    assert status.hold_reason == "watchdog"
    tracker.start(500.0)
    samples = read_for(tracker, 0.5)
    assert len(samples) > 100
    assert running.alive
    motion.abort()


def held(motion: ModbusController) -> MotionStatus | None:
    status = motion.status()
    return status if status.state is MotionState.HELD else None


def test_an_operator_holds_the_feed_and_lets_it_go(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    _, motion = driven(bench(seed=1, speed=4.0, faults=["cnc:feed-hold@2s+2s"]))
    motion.load(LINE)
    assert drive(motion).hold_reason == "operator"
    assert until(lambda: finished(motion)).position == pytest.approx(
        tuple(LINE.position[-1])
    )


def finished(motion: ModbusController) -> MotionStatus | None:
    motion.send_heartbeat()
    status = motion.status()
    return status if status.state is MotionState.FINISHED else None


def test_an_alarm_strikes_on_its_row(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    _, motion = driven(bench(seed=1, speed=4.0, faults=["cnc:alarm@row1"]))
    motion.load(LINE)
    status = drive(motion)
    assert status.state is MotionState.ALARM
    assert "Servo alarm" in status.alarm


@pytest.mark.parametrize("fault", ["cnc:silence", "cnc:exception*4"])
def test_a_master_notices_a_bad_link(bench: Callable[..., Bench], fault: str) -> None:
    running = bench(seed=1)
    with ModbusController(**running.motion_options) as motion:
        running.inject(fault)
        until(lambda: fails(motion))
    assert running.alive


def fails(motion: ModbusController) -> bool:
    try:
        motion.status()
    except DeviceError:
        return True
    return False


def test_broken_connections_can_be_made_anew(bench: Callable[..., Bench]) -> None:
    running = bench(seed=1)
    where = running.motion_options["host"], running.motion_options["port"]
    with socket.create_connection(where, 5.0) as connection:
        connection.sendall(bytes.fromhex("0001 0000 0006 01 03 0000 0002"))
        assert connection.recv(100)
        running.inject("cnc:disconnect")
        assert connection.recv(100) == b""
    with socket.create_connection(where, 5.0) as connection:
        connection.sendall(bytes.fromhex("0001 0000 0006 01 03 0000 0002"))
        assert connection.recv(100)


def test_writes_that_are_not_applied_are_noticed(bench: Callable[..., Bench]) -> None:
    running = bench(seed=1, faults=["cnc:ignore-writes"])
    with (
        ModbusController(**running.motion_options) as motion,
        pytest.raises(DeviceError),
    ):
        motion.load(LINE)


def test_wrong_devices_are_refused(bench: Callable[..., Bench]) -> None:
    running = bench(seed=1, faults=["cnc:wrong-identity", "tracker:wrong-identity"])
    with pytest.raises(WrongDevice), ModbusController(**running.motion_options):
        pass
    with pytest.raises(WrongDevice), StreamingTracker(**running.tracker_options):
        pass


@pytest.mark.fault_row(6)
def test_a_pulled_cable_is_noticed_and_the_port_comes_back(
    bench: Callable[..., Bench],
) -> None:
    running = bench(seed=1)
    with StreamingTracker(**running.tracker_options) as tracker:
        tracker.start(500.0)
        running.inject("tracker:disconnect")
        with pytest.raises(ConnectionLost):
            read_for(tracker, 5.0)
    with StreamingTracker(**running.tracker_options) as tracker:
        tracker.start(500.0)
        assert len(read_for(tracker, 0.3)) > 50


def test_a_fault_can_be_injected_under_way(
    bench: Callable[..., Bench], driven: Callable[..., Any]
) -> None:
    running = bench(seed=1)
    tracker, _ = driven(running)
    tracker.start(500.0)
    running.inject("tracker:beam-break+0.2s")
    samples = read_for(tracker, 1.0)
    assert np.count_nonzero(samples.status) == pytest.approx(100, abs=12)


def test_a_bad_fault_is_refused_before_anything_starts() -> None:
    with pytest.raises(SimulatorError, match="fault"):
        Bench(faults=["tracker:explode"])
    with pytest.raises(SimulatorError, match="speed"):
        Bench(speed=0.0)


def test_a_port_in_use_is_named(bench: Callable[..., Bench]) -> None:
    taken = bench(seed=1).motion_options["port"]
    with pytest.raises(SimulatorError, match="in use"):
        Bench(seed=1, modbus_port=taken).start()


def test_closing_ends_both_processes_and_removes_the_links(tmp_path: Path) -> None:
    running = Bench(seed=1, workdir=tmp_path / "rig").start()
    pids = list(running.process_ids.values())
    assert {p.name for p in (tmp_path / "rig").iterdir()} == {"tracker", "modbus-rtu"}
    running.close()
    running.close()
    assert not any(runs(pid) for pid in pids)
    assert not any((tmp_path / "rig").iterdir())


ORPHANS = """
import signal, time
from truepath_simulators.bench.bench import Bench
# A shell that starts a program in the background lets it ignore SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
bench = Bench().start()
print(*bench.process_ids.values(), flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_simulators_do_not_outlive_their_parent(number: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", ORPHANS],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        assert all(runs(pid) for pid in pids)
        os.kill(parent.pid, number)
    until(lambda: not any(runs(pid) for pid in pids), 5.0)
