"""Both simulators as processes and by their command, with our drivers at the links."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import psutil
import pytest

from processes import runs, until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import MotionState, TrackerSamples
from truepath_drivers.interfaces.records import Path as MotionPath
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command import main
from truepath_simulators.errors import SimulatorError
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.machine import tracker_head
from truepath_simulators.machine_file import parse_machine

ENDS = np.array([[100.0, 100.0, 100.0], [400.0, 300.0, 100.0]])
LINE = MotionPath(("X", "Y", "Z"), ENDS, np.full(2, 6000.0), np.full(2, 0.2))

PLAY = (Backlash("X", 200.0), Backlash("Y", 100.0))
READ = bytes.fromhex("0001 0000 0006 01 03 0000 0002")


@pytest.fixture(scope="module")
def plain():
    """A bench whose faults end by themselves."""
    with Bench(seed=1) as running:
        yield running


@pytest.fixture(scope="module")
def fast():
    """A bench at five times the speed, and two masters: over TCP, and serially."""
    with (
        Bench(seed=6, speed=5.0, hidden=PLAY) as running,
        ModbusController(**running.motion_options) as tcp,
        ModbusController(**running.motion_options_rtu) as rtu,
    ):
        yield running, tcp, rtu


def read_for(tracker, duration_s):
    blocks, end_s = [], time.monotonic() + duration_s
    while time.monotonic() < end_s:
        blocks.append(tracker.read(0.1))
    return TrackerSamples.join(blocks)


def drive(motion):
    motion.start()
    return until(lambda: stands(motion), 30.0)


def stands(motion, moving=(MotionState.RUNNING,)):
    motion.send_heartbeat()
    status = motion.status()
    return None if status.state in moving else status


def test_no_sample_is_lost_and_a_fault_costs_what_it_says(plain):
    with StreamingTracker(**plain.tracker_options) as tracker:
        tracker.start(500.0)
        samples = read_for(tracker, 2.0)
        np.testing.assert_array_equal(np.diff(samples.sequence), 1)
        span_s = samples.device_time_s[-1] - samples.device_time_s[0]
        assert span_s > 1.6
        assert (len(samples) - 1) / span_s == pytest.approx(500.0, rel=1e-3)
        plain.inject("tracker:beam-break+0.2s")
        broken = read_for(tracker, 1.0).status
        assert np.count_nonzero(broken) == pytest.approx(100, abs=12)
        health = tracker.health
    assert health.frames > 1000
    assert health.crc_errors == 0
    assert health.device_overflows == 0


def test_a_fast_tracker_sees_what_the_cnc_does_and_what_the_machine_hides(fast):
    running, motion, _ = fast
    motion.load(LINE)
    assert drive(motion).state is MotionState.FINISHED
    with StreamingTracker(**running.tracker_options) as tracker:
        tracker.start(500.0)
        samples = read_for(tracker, 1.0)
    assert 1900 < len(samples) < 2750  # its clock is fast
    np.testing.assert_allclose(np.diff(samples.device_time_s), 0.002, atol=1.1e-6)
    seen = samples.position_mm.mean(axis=0)
    machine = parse_machine(running.machine)
    pose = tracker_head.random_pose(machine, 6)
    q = LINE.position[-1:]
    error_um = running.truth_at(q)
    assert np.linalg.norm(error_um) > 5.0
    stated = (q + machine.reflector().offset_mm + 1e-3 * error_um)[0]
    off = pose.position_mm + pose.rotation @ seen - stated
    # Both axes came from below: they stop short by half of their play.
    # The mean of samples keeps the slow part of the noise.
    np.testing.assert_allclose(off, [-0.1, -0.05, 0.0], atol=6e-3)


@pytest.mark.fault_row(21)
def test_masters_see_one_machine_and_drive_only_what_they_loaded_last(fast):
    _, tcp, rtu = fast
    assert tcp.connect() == rtu.connect()
    tcp.load(LINE)
    assert rtu.status().state is MotionState.READY
    with pytest.raises(errors.Refused, match="another"):
        rtu.start()  # it does not know the path
    assert drive(tcp).state is MotionState.FINISHED
    assert rtu.status().position == pytest.approx(tuple(LINE.position[-1]))
    here = tcp.status().position
    tcp.load(LINE)
    rtu.load(replace(LINE, feed_mm_min=0.5 * LINE.feed_mm_min))
    with pytest.raises(errors.Refused, match="another"):
        tcp.start()
    assert tcp.status().state is MotionState.READY
    assert tcp.status().position == here


def test_an_operator_holds_the_feed_and_lets_it_go(fast):
    running, tcp, _ = fast
    tcp.load(LINE)
    tcp.start()
    running.inject("cnc:feed-hold+4s")
    assert until(lambda: stands(tcp)).hold_reason == "operator"
    moving = (MotionState.RUNNING, MotionState.HELD)
    status = until(lambda: stands(tcp, moving))
    assert status.state is MotionState.FINISHED
    assert status.position == pytest.approx(tuple(LINE.position[-1]))


def test_broken_connections_can_be_made_anew(plain):
    where = plain.motion_options["host"], plain.motion_options["port"]
    for fault in ("cnc:disconnect", None):
        with socket.create_connection(where, 5.0) as connection:
            connection.sendall(READ)
            assert connection.recv(100)
            if fault:
                plain.inject(fault)
                assert connection.recv(100) == b""


@pytest.mark.parametrize("fault", ["cnc:exception+1s*4", "cnc:silence+1s"])
def test_a_master_notices_a_bad_link(plain, fault):
    with ModbusController(**plain.motion_options) as motion:
        plain.inject(fault)
        until(lambda: fails(motion))
        until(lambda: not fails(motion))  # it ends by itself
    assert plain.alive


def test_writes_that_are_not_applied_are_noticed(plain):
    with ModbusController(**plain.motion_options) as motion:
        plain.inject("cnc:ignore-writes+10s")
        with pytest.raises(errors.DeviceError):
            motion.load(LINE)


def fails(motion):
    try:
        motion.status()
    except errors.DeviceError:
        return True
    return False


@pytest.mark.long
def test_wrong_devices_are_refused():
    faults = ["cnc:wrong-identity", "tracker:wrong-identity"]
    with Bench(seed=1, faults=faults) as wrong:
        with pytest.raises(errors.WrongDevice):
            ModbusController(**wrong.motion_options).connect()
        with pytest.raises(errors.WrongDevice):
            StreamingTracker(**wrong.tracker_options).connect()


@pytest.mark.fault_row(6)
def test_a_pulled_cable_is_noticed_and_the_port_comes_back(plain):
    with StreamingTracker(**plain.tracker_options) as tracker:
        tracker.start(500.0)
        plain.inject("tracker:disconnect")
        with pytest.raises(errors.ConnectionLost):
            read_for(tracker, 5.0)
    with StreamingTracker(**plain.tracker_options) as tracker:
        tracker.start(500.0)
        assert len(read_for(tracker, 0.3)) > 50


@pytest.mark.long
def test_a_port_in_use_is_named():
    refused = pytest.raises(SimulatorError, match="in use")
    with socket.create_server(("127.0.0.1", 0)) as taken, refused:
        Bench(seed=1, modbus_port=taken.getsockname()[1]).start()


def test_closing_ends_both_processes_and_removes_the_links(tmp_path):
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
from truepath_simulators.bench.rig import running_rig
# A shell that starts a program in the background lets it ignore SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
bench = Bench().start()
with running_rig({}) as rig:
    print(*bench.process_ids.values(), *rig.links["pids"].values(), flush=True)
    time.sleep(60)
"""


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_simulators_and_rigs_do_not_outlive_their_parent(number):
    words, nowhere = [sys.executable, "-c", ORPHANS], subprocess.DEVNULL
    how = {"stdout": subprocess.PIPE, "stderr": nowhere, "text": True}
    with subprocess.Popen(words, **how) as parent:
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        assert all(runs(pid) for pid in pids)
        os.kill(parent.pid, number)
    until(lambda: not any(runs(pid) for pid in pids), 5.0)


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
