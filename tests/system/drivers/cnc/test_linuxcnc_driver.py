"""The driver of LinuxCNC against a real one: its planner, limits and watchdog."""

import time
from pathlib import Path as FilePath

import numpy as np
import pytest

from paths_by_hand import path_of, two_turns
from truepath_drivers.cnc.linuxcnc.driver import LinuxCncController
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.conformance import motion
from truepath_drivers.interfaces.errors import ConnectionLost, MotionFault, Refused
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence
from truepath_simulators.machine_file import load_machine

TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-310, 10)}
ABSENT = explain_absence()
pytestmark = pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")
CHECKS = motion.MOTION_CHECKS
SLOW = (motion.hold_and_resume_are_absolute,)
READY = {"reset_at_connect": True, "home_at_connect": True}


def go(driver, *place, feed=6000):
    driver.move_to(place, feed)
    return driver.wait(10.0)


@pytest.fixture(scope="module")
def fresh():
    """A machine that was just switched on, and what it said until it could be driven.

    Without the watchdog's port: a driver need not have one.
    """
    with LinuxCncRig(LinuxCncMachine(TRAVEL)) as rig:
        options = {**rig.motion_options, "watchdog_port": 0}
        with LinuxCncController(**options) as driver:
            said = [(driver.status(), refusals_of(driver))]
            driver.reset()
            said.append((driver.status(), refusals_of(driver)))
            driver.home(10.0)
            said += [(driver.status(), []), (go(driver, 1, 1, -1), [])]
        yield rig, said


def refusals_of(driver):
    texts, place = [], (1, 1, -1)
    asked = (driver.move_to, place, 6000), (driver.load, path_of(place))
    for verb, *given in (*asked, (driver.wait, 1.0)):
        with pytest.raises(MotionFault) as refused:
            verb(*given)
        texts.append(str(refused.value))
    return texts


@pytest.fixture(scope="module")
def rig(fresh):
    return fresh[0]


@pytest.fixture
def driver(rig):
    with LinuxCncController(**rig.motion_options, **READY) as driver:
        driver.abort()
        go(driver, 10, 10, -10, feed=12_000)
        yield driver
        driver.abort()


@pytest.mark.parametrize(
    "check",
    [pytest.param(c, marks=pytest.mark.long) if c in SLOW else c for c in CHECKS],
)
def test_it_conforms(rig, check):
    check(lambda: LinuxCncController(**rig.motion_options))


def test_a_machine_that_cannot_be_driven_says_why_and_what_to_do(fresh):
    stopped, unhomed, (idle, _), (moved, _) = fresh[1]
    assert stopped[0].state is MotionState.ESTOP
    assert all("release it" in text for text in (stopped[0].alarm, *stopped[1]))
    assert unhomed[0].state is MotionState.UNHOMED
    assert all("home it" in text for text in (unhomed[0].alarm, *unhomed[1]))
    assert (idle.state, moved.position) == (MotionState.IDLE, pytest.approx((1, 1, -1)))


def test_an_emergency_stop_in_motion_is_told(driver):
    driver.move_to((40, 10, -10), 1200)
    driver._session.force("estop on")
    with pytest.raises(MotionFault, match="emergency stop"):
        driver.wait(5.0)
    assert driver.status().position[0] < 30
    driver.reset()
    assert driver.status().state is MotionState.ABORTED


# At 9000 mm/min in 1 ms: once in ten thousand looks LinuxCNC's status has the axes of
# two servo cycles, as its reader looks while they are written.
CYCLE_MM = 0.15


@pytest.mark.long
def test_a_circle_is_one_motion_on_its_radius(driver):
    path = two_turns(50.0, 50.0, 40.0, -10.0, feed=9000.0, dwell_s=0.3)
    driver.load(path)
    driver.start()
    seen = {1: [], 2: []}
    while (status := driver.status()).state is MotionState.RUNNING:
        driver.send_heartbeat()
        if status.line in seen:
            seen[status.line].append(status.position[:2])
    assert status.position == pytest.approx(tuple(path.position[0]), abs=1e-3)
    for sign, places_mm in zip((1.0, -1.0), seen.values(), strict=True):
        out = np.array(places_mm) - 50.0
        off_mm = np.abs(np.hypot(*out.T) - 40.0)
        assert np.quantile(off_mm, 0.999) < 0.001
        assert off_mm.max() < CYCLE_MM
        turned = np.degrees(np.unwrap(np.arctan2(out[:, 1], out[:, 0])))
        assert sign * np.ptp(turned) * np.sign(turned[-1] - turned[0]) > 600.0


@pytest.mark.long
def test_a_program_held_by_command_or_without_beats_goes_on_by_resume(driver):
    driver.load(path_of((50, 10, -10), (10, 10, -10), feed=1200))
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
    time.sleep(1.1)
    status = driver.status()
    assert (status.state, status.hold_reason) == (MotionState.HELD, "watchdog")
    driver.send_heartbeat()
    time.sleep(0.1)
    assert driver.status().position == status.position  # beats alone move nothing
    driver.resume()
    assert driver.wait(10.0).state is MotionState.FINISHED


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


def test_what_linuxcnc_refuses_is_refused_in_its_words(rig, driver):
    wide = {**rig.motion_options, "travel": "X -10 600, Y -10 410, Z -310 10"}
    with LinuxCncController(**wide) as other:
        with pytest.raises(Refused, match="exceed X's positive limit"):
            other.move_to((590, 10, -10), 6000)
        assert other.status().position == pytest.approx((10, 10, -10))
        other.load(path_of((12, 10, -10), (590, 10, -10)))
        with pytest.raises(Refused, match="exceed X's positive limit"):
            other.start()
        assert other.wait(5.0).state is MotionState.READY


@pytest.mark.long
@pytest.mark.fault_row(21)
def test_a_program_that_somebody_opened_meanwhile_is_not_run(rig, driver):
    strange = FilePath(rig.motion_options["program_folder"]) / "strange.ngc"
    strange.write_text("G21 G90 G94 F6000\nG53 G1 X200\nM2\n")
    driver.load(path_of((20, 10, -10)))
    driver._session.command(f"open {strange}")
    driver.start()
    status = driver.wait(5.0)
    assert status.state is MotionState.FINISHED
    assert status.position[0] == pytest.approx(20)


@pytest.mark.long
def test_a_lost_connection_is_opened_again_under_way(driver):
    driver.move_to((30, 10, -10), 3000)
    driver._session._rsh._port.close()
    with pytest.raises(ConnectionLost):
        driver.status()
    assert driver.status().state is MotionState.RUNNING
    assert driver.wait(5.0).state is MotionState.FINISHED


@pytest.mark.long
def test_the_override_is_read_and_limited(driver):
    driver._session.command("feed_override 120")
    assert driver.status().override == pytest.approx(1.2)
    driver.limit_override(1.0)
    assert driver.status().override == pytest.approx(1.0)
    driver._session.command("feed_override 50")
    driver.limit_override(1.0)
    assert driver.status().override == pytest.approx(0.5)
    driver._session.command("feed_override 100")


@pytest.mark.long
def test_a_tool_tip_that_is_followed_is_refused_or_switched_off_by_a_prologue():
    travel = dict.fromkeys("XYZ", (-300, 300)) | {"A": (-100, 50), "C": (-360, 360)}
    machine = LinuxCncMachine(
        travel,
        kinematics="xyzac-trt-kins sparm=identityfirst",
        hal="setp xyzac-trt-kins.y-offset 20\nsetp xyzac-trt-kins.z-offset 10\n"
        "net kinstype motion.analog-out-03 => motion.switchkins-type\n",
    )
    goal = (30.0, 20.0, -10.0, 10.0, 5.0)
    path = path_of(goal, axes=travel)
    switched = {"prologue": "M68 E3 Q0; M66 E0 L0"}
    with LinuxCncRig(machine) as rig:
        with LinuxCncController(**rig.motion_options, **READY) as driver:
            assert go(driver, 10, 50, -30, -30, 45).state is MotionState.FINISHED
            driver._session.command("mdi M68 E3 Q1")
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
            driver._session.command("mdi M68 E3 Q1")
            status = go(driver, 10, 50, -30, -30, 45)
            assert status.position == pytest.approx((10, 50, -30, -30, 45), abs=1e-3)
            go(driver, 0, 0, 0, 0, 0)
        # With the table at zero, coordinates do not tell that the tip is followed.
        there_and_back = path_of(goal, (0.0,) * 5, axes=travel, feed=3000.0)
        for options in ({}, {"prologue": "G21"}):
            with LinuxCncController(**rig.motion_options, **options) as driver:
                driver._session.enter_mode("mdi")
                driver._session.command("mdi M68 E3 Q1")
                driver.load(there_and_back)
                driver.start()
                with pytest.raises(MotionFault, match="RTCP"):
                    driver.wait(10.0)
                stopped = driver.wait(10.0)
                assert stopped.state is MotionState.ABORTED
                assert 0 < stopped.position[3] < 9.9
                driver._session.enter_mode("mdi")
                driver._session.command("mdi M68 E3 Q0")
                go(driver, 0, 0, 0, 0, 0)


@pytest.fixture(scope="module")
def gateway():
    """A LinuxCNC behind the register map, which needs a reset and homing first."""
    machine = LinuxCncMachine(TRAVEL | {"Z": (-10, 310)})
    with LinuxCncRig(machine, gateway=load_machine("demo")) as rig:
        with ModbusController(**rig.modbus_options) as controller:
            with pytest.raises(MotionFault, match="release it"):
                controller.move_to((1, 1, 1), 3000)
            controller.reset()
            with pytest.raises(MotionFault, match="home it"):
                controller.move_to((1, 1, 1), 3000)
            controller.home(10.0)
        yield rig


@pytest.mark.long
@pytest.mark.parametrize("check", CHECKS)
def test_the_register_map_before_it_conforms(gateway, check):
    check(lambda: ModbusController(**gateway.modbus_options))


@pytest.mark.long
def test_the_override_is_lowered_through_the_register_map(gateway):
    with ModbusController(**gateway.modbus_options) as controller:
        assert controller.status().override == 1.0
        for largest, left in ((0.5, 0.5), (1.0, 0.5)):
            controller.limit_override(largest)
            assert controller.status().override == left
