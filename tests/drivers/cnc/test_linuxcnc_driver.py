"""The driver of LinuxCNC against a real one: its planner, limits and watchdog."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from truepath.motion.nc_programs.linuxcnc import LinuxCnc
from truepath_drivers.cnc.linuxcnc.driver import LinuxCncController
from truepath_drivers.cnc.linuxcnc.machine import parse_travel, read_ini
from truepath_drivers.cnc.linuxcnc.program import write_program
from truepath_drivers.conformance import motion
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    MotionFault,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Arc, MotionState, Path
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence

TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-310, 10)}
ABSENT = explain_absence()
needs_linuxcnc = pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")
SLOW_CHECKS = (motion.hold_and_resume_are_absolute,)


@pytest.fixture(scope="module")
def rig():
    with LinuxCncRig(LinuxCncMachine(TRAVEL)) as rig:
        with LinuxCncController(**rig.motion_options, **READY):
            pass
        yield rig


READY = {"reset_at_connect": True, "home_at_connect": True}


@pytest.fixture
def driver(rig):
    with LinuxCncController(**rig.motion_options, **READY) as driver:
        driver.abort()
        driver.move_to((10, 10, -10), 12_000)
        driver.wait(10.0)
        yield driver
        driver.abort()


def path_to(*rows, feed=6000.0, dwell=None):
    n = len(rows)
    dwell_s = np.zeros(n) if dwell is None else np.array(dwell, float)
    return Path(("X", "Y", "Z"), np.array(rows, float), np.full(n, feed), dwell_s)


@needs_linuxcnc
@pytest.mark.parametrize(
    "check",
    [
        pytest.param(
            c, marks=pytest.mark.long if c in SLOW_CHECKS else (), id=c.__name__
        )
        for c in MOTION_CHECKS
    ],
)
def test_it_conforms(rig, check):
    check(lambda: LinuxCncController(**rig.motion_options))


@needs_linuxcnc
def test_a_machine_that_cannot_be_driven_says_why_and_what_to_do(rig):
    with LinuxCncRig(LinuxCncMachine(TRAVEL), watchdog=False) as fresh:
        driver = LinuxCncController(**fresh.motion_options)
        with driver:
            for state, remedy, cure in (
                (MotionState.ESTOP, "release it", driver.reset),
                (MotionState.UNHOMED, "home it", lambda: driver.home(10.0)),
            ):
                status = driver.status()
                assert (status.state, remedy in status.alarm) == (state, True)
                for verb in (
                    lambda: driver.move_to((1, 1, -1), 6000),
                    lambda: driver.load(path_to((1, 1, -1))),
                    lambda: driver.wait(1.0),
                ):
                    with pytest.raises(MotionFault, match=remedy):
                        verb()
                cure()
            assert driver.status().state is MotionState.IDLE
            driver.move_to((1, 1, -1), 6000)
            assert driver.wait(5.0).position == pytest.approx((1, 1, -1))


@needs_linuxcnc
def test_an_emergency_stop_in_motion_is_told(driver):
    driver.move_to((40, 10, -10), 1200)
    driver._session.insist("estop on")
    with pytest.raises(MotionFault, match="emergency stop"):
        driver.wait(5.0)
    assert driver.status().position[0] < 30
    driver.reset()
    assert driver.status().state is MotionState.ABORTED


# At 9000 mm/min in 1 ms: once in ten thousand looks LinuxCNC's status has the axes of
# two servo cycles, as its reader looks while they are written.
CYCLE_MM = 0.15


@pytest.mark.long
@needs_linuxcnc
def test_a_circle_is_one_motion_on_its_radius(driver):
    end = 40.0 * np.cos(np.radians(12.0)), 40.0 * np.sin(np.radians(12.0))
    places = [(90.0, 50.0, -10.0), (50.0 + end[0], 50.0 + end[1], -10.0)]
    path = path_to(*np.round([*places, places[0]], 4), feed=9000.0, dwell=(0.3,) * 3)
    arcs = Arc("XY", (50.0, 50.0), 732.0), Arc("XY", (50.0, 50.0), -732.0)
    driver.load(replace(path, arc=(None, *arcs)))
    driver.start()
    seen = {1: [], 2: []}
    while (status := driver.status()).state is MotionState.RUNNING:
        driver.send_heartbeat()
        if status.line in seen:
            seen[status.line].append(status.position[:2])
    assert status.position == pytest.approx(places[0], abs=1e-3)
    for sign, places_mm in zip((1.0, -1.0), seen.values(), strict=True):
        out = np.array(places_mm) - 50.0
        off_mm = np.abs(np.hypot(*out.T) - 40.0)
        assert np.quantile(off_mm, 0.999) < 0.001
        assert off_mm.max() < CYCLE_MM
        turned = np.degrees(np.unwrap(np.arctan2(out[:, 1], out[:, 0])))
        assert sign * np.ptp(turned) * np.sign(turned[-1] - turned[0]) > 600.0


@pytest.mark.long
@needs_linuxcnc
def test_rows_are_told_while_they_are_driven_and_dwelt_at(driver):
    driver.load(
        path_to((20, 10, -10), (30, 10, -10), (40, 10, -10), dwell=(0.3, 0, 0.3))
    )
    assert driver.status().line == 0
    driver.start()
    seen = {}
    while (status := driver.status()).state is MotionState.RUNNING:
        driver.send_heartbeat()
        seen.setdefault(status.line, []).append(status.position[0])
    assert status.state is MotionState.FINISHED
    assert status.line == 2
    assert list(seen) == [0, 1, 2]
    for row, at in seen.items():
        assert 10 * (row + 1) - 0.2 <= at[-1] <= 10 * (row + 2) + 0.2
    assert sum(abs(x - 20.0) < 1e-3 for x in seen[0]) > 5


@pytest.mark.long
@needs_linuxcnc
def test_hold_and_resume_in_a_program(driver):
    driver.load(path_to((20, 10, -10), (10, 10, -10), feed=1800))
    driver.start()
    time.sleep(0.1)
    driver.hold()
    held = driver.wait(5.0)
    time.sleep(0.1)
    assert driver.status().position == held.position
    assert (held.state, held.hold_reason) == (MotionState.HELD, "command")
    with pytest.raises(Refused, match="held"):
        driver.move_to((10, 10, -10), 6000)
    driver.resume()
    assert driver.wait(10.0).state is MotionState.FINISHED


@pytest.mark.long
@needs_linuxcnc
def test_held_is_told_only_when_it_stands(driver):
    driver.move_to((110, 10, -10), 12_000)
    time.sleep(0.1)
    threading.Thread(target=driver.hold).start()
    while driver.status().state is MotionState.RUNNING:
        driver.send_heartbeat()
    first = driver.status().position
    time.sleep(0.1)
    assert driver.status().position == first


@needs_linuxcnc
def test_the_watchdog_holds_what_a_killed_host_has_begun(rig, driver):
    begin = (
        "import sys, time; from truepath_drivers.cnc.linuxcnc.driver import *\n"
        f"d = LinuxCncController(**{rig.motion_options!r}); d.connect()\n"
        "d.move_to((300, 10, -10), 1200); print('moves', flush=True)\n"
        "while True: d.send_heartbeat(); time.sleep(0.1)"
    )
    host = subprocess.Popen([sys.executable, "-c", begin], stdout=subprocess.PIPE)
    assert host.stdout.readline() == b"moves\n"
    time.sleep(1.1)
    assert driver.status().state is MotionState.RUNNING
    os.kill(host.pid, signal.SIGKILL)
    killed_s = time.monotonic()
    host.wait()
    host.stdout.close()
    status = driver.wait(5.0)
    assert time.monotonic() - killed_s < 1.5
    assert (status.state, status.hold_reason) == (MotionState.HELD, "watchdog")
    driver.abort()
    assert driver.wait(5.0).state is MotionState.ABORTED


@pytest.mark.long
@needs_linuxcnc
def test_a_driver_that_stops_beating_is_held_and_goes_on_by_resume(driver):
    driver.load(path_to((50, 10, -10), feed=1500))
    driver.start()
    time.sleep(1.1)
    status = driver.status()
    assert (status.state, status.hold_reason) == (MotionState.HELD, "watchdog")
    driver.send_heartbeat()
    time.sleep(0.1)
    assert driver.status().position == status.position  # beats alone move nothing
    driver.resume()
    assert driver.wait(10.0).state is MotionState.FINISHED


@needs_linuxcnc
def test_hold_and_abort_take_the_command_back(rig, driver):
    driver.move_to((40, 10, -10), 1200)
    with LinuxCncController(**rig.motion_options) as other:
        driver.hold()
        assert driver.wait(5.0).state is MotionState.HELD
        assert other._session._rsh.enable()
        with pytest.raises(Refused, match="another client"):
            driver.resume()
        driver.abort()
        assert driver.wait(5.0).state is MotionState.ABORTED


@needs_linuxcnc
def test_what_linuxcnc_refuses_is_refused_in_its_words(rig, driver):
    wide = {**rig.motion_options, "travel": "X -10 600, Y -10 410, Z -310 10"}
    with LinuxCncController(**wide) as other:
        with pytest.raises(Refused, match="exceed X's positive limit"):
            other.move_to((590, 10, -10), 6000)
        assert other.status().position == pytest.approx((10, 10, -10))
        other.load(path_to((12, 10, -10), (590, 10, -10)))
        with pytest.raises(Refused, match="exceed X's positive limit"):
            other.start()
        assert other.wait(5.0).state is MotionState.READY


@pytest.mark.long
@needs_linuxcnc
@pytest.mark.fault_row(21)
def test_a_program_that_somebody_opened_meanwhile_is_not_run(rig, driver):
    strange = FilePath(rig.motion_options["program_folder"]) / "strange.ngc"
    strange.write_text("G21 G90 G94 F6000\nG53 G1 X200\nM2\n")
    driver.load(path_to((20, 10, -10)))
    driver._session.demand(f"open {strange}")
    driver.start()
    status = driver.wait(5.0)
    assert status.state is MotionState.FINISHED
    assert status.position[0] == pytest.approx(20)


@pytest.mark.long
@needs_linuxcnc
def test_a_lost_connection_is_opened_again_under_way(driver):
    driver.move_to((30, 10, -10), 3000)
    driver._session._rsh._port.close()
    with pytest.raises(ConnectionLost):
        driver.status()
    assert driver.status().state is MotionState.RUNNING
    assert driver.wait(5.0).state is MotionState.FINISHED


@pytest.mark.long
@needs_linuxcnc
def test_the_override_is_read_and_limited(driver):
    driver._session.demand("feed_override 120")
    assert driver.status().override == pytest.approx(1.2)
    driver.limit_override(1.0)
    assert driver.status().override == pytest.approx(1.0)
    driver._session.demand("feed_override 50")
    driver.limit_override(1.0)
    assert driver.status().override == pytest.approx(0.5)
    driver._session.demand("feed_override 100")


@pytest.mark.long
@needs_linuxcnc
def test_a_tool_tip_that_is_followed_is_refused_or_switched_off_by_a_prologue():
    travel = dict.fromkeys("XYZ", (-300, 300)) | {"A": (-100, 50), "C": (-360, 360)}
    machine = LinuxCncMachine(
        travel,
        kinematics="xyzac-trt-kins sparm=identityfirst",
        hal="setp xyzac-trt-kins.y-offset 20\nsetp xyzac-trt-kins.z-offset 10\n"
        "net kinstype motion.analog-out-03 => motion.switchkins-type\n",
    )
    goal = (30.0, 20.0, -10.0, 10.0, 5.0)
    path = Path(tuple(travel), np.array([goal]), np.array([6000.0]), np.zeros(1))
    switched = {"prologue": "M68 E3 Q0; M66 E0 L0"}
    with LinuxCncRig(machine) as rig:
        with LinuxCncController(**rig.motion_options, **READY) as driver:
            driver.move_to((10, 50, -30, -30, 45), 6000)
            assert driver.wait(10.0).state is MotionState.FINISHED
            driver._session.demand("mdi M68 E3 Q1")
            with pytest.raises(Refused, match="RTCP"):
                driver.move_to(goal, 6000)
            driver.load(path)
            with pytest.raises(Refused, match="RTCP"):
                driver.start()
        with LinuxCncController(**rig.motion_options, **switched) as driver:
            driver.load(path)
            driver.start()
            status = driver.wait(10.0)
            assert status.state is MotionState.FINISHED
            assert status.position == pytest.approx(goal, abs=1e-3)
            driver._session.demand("mdi M68 E3 Q1")
            driver.move_to((10, 50, -30, -30, 45), 6000)
            status = driver.wait(10.0)
            assert status.position == pytest.approx((10, 50, -30, -30, 45), abs=1e-3)
            driver.move_to((0, 0, 0, 0, 0), 6000)
            driver.wait(10.0)
        # With the table at zero, coordinates do not tell that the tip is followed.
        for options in ({}, {"prologue": "G21"}):
            there_and_back = Path(
                tuple(travel),
                np.array([goal, (0.0,) * 5]),
                np.full(2, 3000.0),
                np.zeros(2),
            )
            with LinuxCncController(**rig.motion_options, **options) as driver:
                driver._session.enter_mode("mdi")
                driver._session.demand("mdi M68 E3 Q1")
                driver.load(there_and_back)
                driver.start()
                with pytest.raises(MotionFault, match="RTCP"):
                    driver.wait(10.0)
                stopped = driver.wait(10.0)
                assert stopped.state is MotionState.ABORTED
                assert 0 < stopped.position[3] < 9.9
                driver._session.enter_mode("mdi")
                driver._session.demand("mdi M68 E3 Q0")
                driver.move_to((0, 0, 0, 0, 0), 6000)
                driver.wait(10.0)


def test_a_program_is_the_path_to_a_reader_that_knows_only_the_control():
    path = path_to((20.1, 10, -10), (30, 10.25, -10), dwell=(0.3, 0), feed=1234.5)
    program = write_program(path, ())
    motion_of_control = LinuxCnc().read(program.text)
    np.testing.assert_allclose(motion_of_control.position, path.position)
    np.testing.assert_allclose(motion_of_control.feed_mm_min, path.feed_mm_min)
    np.testing.assert_allclose(motion_of_control.dwell_s, path.dwell_s)
    text = program.text.splitlines()
    assert [text[line - 1].split()[0] for line in program.lines] == ["N1", "N2"]
    assert [program.find_row(line) for line in (0, *program.lines)] == [0, 0, 1]


def test_axes_and_travel_come_from_the_ini_file(tmp_path):
    file = tmp_path / "gantry.ini"
    file.write_text(
        "[EMC]\nMACHINE = Big # ours\n[TRAJ]\nCOORDINATES = X Y Y C\n"
        "[KINS]\nKINEMATICS = trivkins coordinates=xyyc kinstype=BOTH\n"
        "[AXIS_X]\nMIN_LIMIT = -1\nMAX_LIMIT = 500\n"
        "[JOINT_0]\nMIN_LIMIT = 0\nMAX_LIMIT = 510\n[AXIS_Y]\nMAX_LIMIT = 300\n"
        "[JOINT_1]\nMIN_LIMIT = -20\nMAX_LIMIT = 400\n"
        "[JOINT_3]\nMIN_LIMIT = -360\nMAX_LIMIT = 360\n"
    )
    machine = read_ini(file)
    assert machine.name == "Big"
    assert machine.axes == ("X", "Y", "C")
    assert machine.travel == ((0, 500), (-20, 300), (-360, 360))
    assert (machine.joints, machine.joint_count) == ((0, 1, 3), 4)
    file.write_text(file.read_text() + "[TRAJ]\nLINEAR_UNITS = inch\n")
    with pytest.raises(Refused, match="not mm"):
        read_ini(file)
    with pytest.raises(Refused, match="ini_file"):
        read_ini(tmp_path / "none.ini")


@pytest.mark.parametrize(
    ("entry", "has"),
    [
        ("", False),
        ("COMP_FILE = x.tbl", True),
        ("BACKLASH = 0.0", False),
        ("BACKLASH = 0.01", True),
    ],
)
def test_the_ini_file_tells_whether_linuxcnc_compensates(tmp_path, entry, has):
    file = tmp_path / "machine.ini"
    file.write_text(
        "[KINS]\nKINEMATICS = trivkins coordinates=XY\n[JOINT_0]\nMIN_LIMIT = 0\n"
        f"[JOINT_1]\nMIN_LIMIT = 0\n{entry}\n"
    )
    assert read_ini(file).has_compensation is has
    assert parse_travel("X 0 500").has_compensation is None


def test_a_travel_that_is_none_is_said():
    assert parse_travel("X 0 500, c -360 360").axes == ("X", "C")
    with pytest.raises(ValueError, match="'X 0'"):
        parse_travel("X 0, Y 0 1")


WELCOME = [
    b"HELLO ACK EMCNETSVR 1.1\r\n",
    b"set echo off\r\n",
    b"SET VERBOSE ACK\n\r",
    b"SET ENABLE ACK\n\r",
]


@pytest.mark.parametrize(
    ("answers", "error", "said"),
    [
        ([b"220 mail ready\r\n"], WrongDevice, "welcome"),
        ([*WELCOME, b"USER_LINEAR_UNITS INCH\r\n"], WrongDevice, "INCH"),
        (
            [*WELCOME, b"USER_LINEAR_UNITS MM\r\n", b"INIFILE emc.ini\r\n"],
            Refused,
            "ini_file",
        ),
        ([*WELCOME, b"SET MODE ACK\r\n"], ConnectionLost, "out of step"),
        ([*WELCOME, b""], ConnectionLost, "closed"),
    ],
)
def test_what_cannot_be_driven_is_told_at_connect(free_port, answers, error, said):
    def serve(server):
        with server.accept()[0] as peer:
            for answer in answers:
                peer.recv(100)
                peer.sendall(answer)

    with socket.create_server(("127.0.0.1", free_port)) as server:
        thread = threading.Thread(target=serve, args=(server,))
        thread.start()
        with pytest.raises(error, match=said):
            LinuxCncController(host="127.0.0.1", port=free_port).connect()
        thread.join()
