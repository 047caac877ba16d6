"""The driver of GRBL against its published rules, without a port and in no time."""

import itertools

import numpy as np
import pytest

from grbl_port import GrblPort
from truepath_drivers import host_clock
from truepath_drivers.cnc.grbl import driver, motion
from truepath_drivers.cnc.grbl.program import Block, write_blocks
from truepath_drivers.cnc.grbl.protocol import parse_report, parse_settings
from truepath_drivers.cnc.grbl.stream import Stream
from truepath_drivers.conformance.motion import MOTION_CHECKS, PROVOKED_CHECKS
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    MotionFault,
    OutOfTravel,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import MotionState, Path
from truepath_simulators.cnc.grbl_device import GrblDevice

AXES = ("X", "Y", "Z")
SETTINGS = [f"${n}={v}".encode() for n, v in GrblDevice().settings.items()]


@pytest.fixture
def device():
    return GrblDevice()


@pytest.fixture
def port(clock, device, monkeypatch):
    port = GrblPort(device)
    monkeypatch.setattr(driver, "make_port", lambda *_: port)
    return port


@pytest.fixture
def grbl(port):
    with driver.GrblController(port="") as grbl:
        grbl.home(10.0)
        yield grbl


def path_to(*rows, feed=1200.0, dwell_s=0.0):
    n = len(rows)
    position = np.array(rows, float)
    return Path(AXES, position, np.full(n, feed), np.full(n, dwell_s))


def look_for(grbl, seconds, each_s=0.05):
    for _ in range(round(seconds / each_s)):
        status = grbl.status()
        host_clock.sleep_s(each_s)
    return status


@pytest.mark.parametrize("check", MOTION_CHECKS)
def test_it_keeps_what_the_interface_promises(grbl, check):
    check(lambda: driver.GrblController(port=""))


TROUBLES = {
    "an_alarm_ends_the_motion": lambda device: device.trip(1),
    "an_open_door_ends_the_motion": lambda device: device.open_door(True),
    "an_unhomed_machine_does_not_move": lambda device: device.restart(),
    "a_lost_reply_moves_nothing_twice": lambda device: setattr(device, "drops", 1),
    "a_blocked_device_is_told_in_time": lambda device: setattr(device, "is_mute", True),
}


@pytest.mark.parametrize("check", PROVOKED_CHECKS)
def test_it_keeps_in_trouble_what_the_interface_promises(grbl, device, check):
    provoke = TROUBLES[check.__name__]
    check(lambda: driver.GrblController(port=""), lambda: provoke(device))
    device.is_mute = False


def test_never_more_than_128_bytes_are_unread_and_every_line_is_sent_once(grbl, device):
    rows = [[-50.0, -50.0, -50.0], [-90.0, -20.0, -50.0], [-50.0, -50.0, -20.0]]
    grbl.load(path_to(*rows, feed=3000.0, dwell_s=0.2))
    grbl.start()
    assert grbl.wait(60.0).state is MotionState.FINISHED
    assert device.overflows == 0
    lines = [line for line in device.executed if b"X" in line]
    assert len(set(lines)) == len(lines) > 30
    assert [line for line in device.executed if line.startswith(b"G4")] == [
        b"G4P0.200"
    ] * 3
    assert device.position == pytest.approx(rows[-1], abs=1e-3)


def test_it_keeps_to_the_feed_while_it_is_asked_three_times_a_second(grbl, device):
    here = device.position.copy()
    grbl.move_to([-101.0, -1.0, -1.0], 3000.0)
    look_for(grbl, 1.5, each_s=0.33)
    assert here[0] - device.position[0] == pytest.approx(75.0, abs=8.0)


def test_it_stands_soon_after_nobody_asks_any_more(grbl, port, device):
    grbl.move_to([-280.0, -1.0, -1.0], 3000.0)
    look_for(grbl, 1.0)
    host_clock.sleep_s(2.0)
    port.pass_time()
    left_at = device.position.copy()
    assert device.state == "Idle"
    host_clock.sleep_s(5.0)
    port.pass_time()
    assert device.position == pytest.approx(left_at)
    assert left_at[0] > -120.0
    held = grbl.wait(60.0)  # asked again, it does not go on by itself
    assert (held.state, held.hold_reason) == (MotionState.HELD, "watchdog")
    grbl.resume()
    assert grbl.wait(60.0).state is MotionState.FINISHED


def test_a_hold_and_an_abort_keep_the_position(grbl, device):
    grbl.load(path_to([-50.0, -50.0, -50.0], [-150.0, -50.0, -50.0]))
    grbl.start()
    look_for(grbl, 0.5)
    grbl.hold()
    held = grbl.wait(5.0)
    assert (held.state, held.hold_reason) == (MotionState.HELD, "command")
    grbl.abort()
    status = grbl.status()
    assert (status.state, status.referenced) == (MotionState.ABORTED, True)
    assert device.state == "Idle"
    with pytest.raises(Refused, match="no path"):
        grbl.start()


def test_the_operators_hold_is_his(grbl, device, port):
    grbl.move_to([-50.0, -50.0, -50.0], 1200.0)
    look_for(grbl, 0.3)
    device.receive(b"!")
    held = grbl.wait(5.0)
    assert (held.state, held.hold_reason) == (MotionState.HELD, "operator")
    grbl.resume()
    assert grbl.wait(60.0).state is MotionState.FINISHED


def test_a_machine_that_is_not_homed_says_so_and_moves_nothing(port, device):
    with driver.GrblController(port="") as grbl:
        status = grbl.status()
        assert (status.state, status.referenced) == (MotionState.UNHOMED, False)
        with pytest.raises(MotionFault, match="not homed"):
            grbl.move_to([-10.0, -10.0, -10.0], 600.0)
        grbl.home(10.0)
        assert grbl.status().referenced is True


def test_an_alarm_has_its_name_and_needs_homing_after_its_reset(grbl, device):
    grbl.move_to([-50.0, -50.0, -50.0], 600.0)
    look_for(grbl, 0.3)
    device.trip(1)
    with pytest.raises(MotionFault, match="ALARM:1, a limit switch was hit"):
        grbl.wait(5.0)
    assert grbl.status().state is MotionState.ALARM
    grbl.reset()
    assert grbl.status().state is MotionState.UNHOMED


def test_homing_ends_an_alarm_as_well(grbl, device):
    device.trip(3)
    assert grbl.status().state is MotionState.ALARM
    grbl.home(10.0)
    assert grbl.status().referenced is True


def test_a_machine_without_homing_is_unlocked_and_never_referenced(port, device):
    device.settings[22], device.state = 0.0, "Idle"
    with driver.GrblController(port="") as grbl:
        assert grbl.status().referenced is False
        device.trip(3)
        grbl.reset()
        assert grbl.status().state is MotionState.IDLE
        with pytest.raises(Refused, match=r"\$22=0"):
            grbl.home(1.0)


def test_a_door_stops_and_waits_for_resume_when_it_is_closed(grbl, device):
    grbl.move_to([-50.0, -50.0, -50.0], 1200.0)
    look_for(grbl, 0.3)
    device.open_door(True)
    with pytest.raises(MotionFault, match="door"):
        grbl.wait(5.0)
    look_for(grbl, 0.5)
    device.open_door(False)
    status = grbl.status()
    assert (status.state, status.hold_reason) == (MotionState.HELD, "door")
    grbl.resume()
    assert grbl.wait(60.0).state is MotionState.FINISHED


def test_a_lost_reply_costs_a_moment_and_no_line_is_sent_twice(grbl, device):
    grbl.load(path_to([-20.0, -20.0, -20.0], [-60.0, -20.0, -20.0]))
    grbl.start()
    look_for(grbl, 0.3)
    device.drops = 1
    assert grbl.wait(60.0).state is MotionState.FINISHED
    lines = [line for line in device.executed if b"X" in line]
    assert len(set(lines)) == len(lines)


def test_lost_lines_end_the_motion_and_say_so(grbl, device):
    grbl.load(path_to([-20.0, -20.0, -20.0], [-60.0, -20.0, -20.0], feed=600.0))
    grbl.start()
    look_for(grbl, 0.3)
    device.drops = 1000
    status = grbl.wait(60.0)
    assert status.state is MotionState.ABORTED
    assert "owes replies" in status.alarm


def test_a_line_that_is_refused_ends_the_motion_with_its_number(
    grbl, port, monkeypatch
):
    lines = [Block(b"G21\n"), Block(b"G61.1\n"), Block(b"G4P9\n")]
    monkeypatch.setattr(motion, "write_blocks", lambda *_: lines)
    grbl.move_to([-20.0, -20.0, -20.0], 600.0)
    status = grbl.wait(5.0)
    assert status.state is MotionState.ABORTED
    assert status.alarm == "error:20 at G61.1, an unknown G-code"


def test_a_control_that_hangs_is_a_timeout_and_one_that_begins_anew_ends_the_motion(
    grbl, device
):
    grbl.move_to([-200.0, -1.0, -1.0], 1200.0)
    look_for(grbl, 0.5)
    device.is_mute = True
    with pytest.raises(DeviceTimeout, match="does not answer"):
        grbl.status()
    device.is_mute = False
    device.restart()
    status = grbl.status()
    assert status.state is MotionState.UNHOMED
    assert "begun anew" not in status.alarm
    grbl.home(10.0)
    assert grbl.status().state is MotionState.FINISHED


def test_a_cable_that_is_pulled_in_motion_is_the_end_of_it(grbl, port, device):
    grbl.move_to([-200.0, -1.0, -1.0], 1200.0)
    look_for(grbl, 0.5)
    port.is_gone = True
    with pytest.raises(ConnectionLost):
        grbl.status()
    port.is_gone = False
    host_clock.sleep_s(5.0)
    grbl.connect()
    status = grbl.status()
    assert (status.state, status.alarm) == (
        MotionState.ABORTED,
        "the connection was lost in motion",
    )
    assert device.position[0] > -60.0


def test_what_a_dead_process_has_left_running_is_ended_at_connect(grbl, port, device):
    grbl.move_to([-200.0, -1.0, -1.0], 1200.0)
    look_for(grbl, 0.5)
    assert device.state == "Run"
    other = driver.GrblController(port="")
    other.connect()
    assert device.state == "Idle"
    assert other.status().state is MotionState.IDLE
    other.close()


def test_homing_is_told_as_motion_and_can_be_aborted(grbl, device):
    device.settings[22] = 1
    grbl._motion.home()
    assert grbl.status().state is MotionState.RUNNING
    grbl.abort()
    host_clock.sleep_s(0.1)
    assert grbl.status().alarm == "ALARM:6, homing was reset"


def test_work_coordinates_are_told_as_those_of_the_machine(port, device):
    device.settings[10] = 0
    with driver.GrblController(port="") as grbl:
        grbl.home(10.0)
        assert grbl.status().position == pytest.approx((-1.0, -1.0, -1.0))


def test_the_override_is_lowered_and_told(grbl, device):
    device.receive(b"\x91\x91\x91")
    look_for(grbl, 1.0)
    assert grbl.status().override == pytest.approx(1.3)
    grbl.limit_override(0.87)
    look_for(grbl, 1.0)
    assert grbl.status().override == pytest.approx(0.87)


def test_what_is_not_the_machine_is_refused(port, device):
    with pytest.raises(WrongDevice, match="SIM-G1"):
        driver.GrblController(port="", serial_number="other").connect()
    device.settings[13] = 1
    with pytest.raises(Refused, match=r"\$13=0"):
        driver.GrblController(port="").connect()
    device.settings[13] = 0
    noise = iter([b"\x00\xfe%"] * 3)
    device.take = lambda: next(noise, b"")
    with pytest.raises(WrongDevice, match="baudrate"):
        driver.GrblController(port="").connect()
    device.is_mute, device.take = True, lambda: b""
    with pytest.raises(DeviceTimeout, match="nothing answers"):
        driver.GrblController(port="").connect()


def test_beyond_the_travel_nothing_is_sent(grbl, port):
    before = port.sent
    with pytest.raises(OutOfTravel):
        grbl.move_to([10.0, 0.0, 0.0], 600.0)
    assert port.sent == before


@pytest.mark.parametrize(
    ("line", "state", "stands"),
    [
        (b"<Idle|MPos:0.000,1.000,2.000|FS:0,0>", "Idle", True),
        (b"<Hold:1|MPos:0.000,1.000,2.000>", "Hold", False),
        (b"<Hold:0|MPos:0.000,1.000,2.000|Bf:15,128|Pn:P>", "Hold", True),
        (b"<Door:2|WPos:0.000,1.000,2.000|WCO:1.0,1.0,1.0>", "Door", False),
        (b"<Run|MPos:0.000,1.000,2.000|FS:500,0|Ov:100,100,100>", "Run", False),
    ],
)
def test_reports_are_read(line, state, stands):
    report = parse_report(line)
    assert report is not None
    assert (report.state, report.stands) == (state, stands)
    assert report.position == (0.0, 1.0, 2.0)


@pytest.mark.parametrize(
    "line",
    [b"<Idle|MPos:0.000,1.000|FS:0,0>", b"<Idle|MP", b"<Run|MPos:0.0,1.0,x>", b"<>"],
)
def test_damaged_reports_are_none(line):
    assert parse_report(line) is None


def test_an_origin_set_by_homing_turns_the_travel_over():
    lines = [*SETTINGS, b"$23=1"]
    usual = parse_settings(lines, [b"[OPT:V,15,128]"])
    assert usual.travel == ((-300.0, 0.0), (-200.0, 0.0), (-100.0, 0.0))
    origin = parse_settings(lines, [b"[OPT:VZ,15,254]"])
    assert origin.travel[0] == (0.0, 300.0)
    assert origin.buffer_bytes == 254


def test_settings_that_are_lost_are_not_guessed():
    with pytest.raises(ConnectionLost, match="130"):
        parse_settings([s for s in SETTINGS if b"$130" not in s], [])


def test_pieces_are_long_enough_to_come_to_a_stand_in():
    slow = parse_settings([*SETTINGS, b"$120=10", b"$121=10", b"$122=10"], [])
    fast = parse_settings(SETTINGS, [])
    path = path_to([-200.0, 0.0, 0.0], feed=3000.0)
    count = [len(list(write_blocks(path, (0.0, 0.0, 0.0), s))) for s in (slow, fast)]
    assert count[0] < count[1] / 2
    # GRBL's queue at 50 mm/s and 10 mm/s2 holds the 125 mm of the brake.
    assert 15 * 200.0 / (count[0] - 2) >= 125.0


def test_a_stream_counts_characters(clock):
    blocks = write_blocks(
        path_to([-10.0, -10.0, -10.0]), (0.0, 0.0, 0.0), parse_settings(SETTINGS, [])
    )
    stream = Stream(itertools.islice(blocks, 10), 128)
    taken = stream.take()
    assert 80 < len(taken) <= 128
    assert stream.take() == b""
    first = stream.answer()
    assert first is not None
    assert len(stream.take()) <= 128 - len(taken) + len(first.text)
