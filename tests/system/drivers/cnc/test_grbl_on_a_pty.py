"""The driver of GRBL and a simulated GRBL in a process of its own, over a pty."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from truepath_drivers.cnc.grbl.driver import GrblController
from truepath_drivers.conformance.motion import MOTION_CHECKS
from truepath_drivers.interfaces import errors, records
from truepath_simulators.processes import DeviceProcess

pytestmark = pytest.mark.long  # a busy computer is slower than any board

DRIVE_AND_DIE = """
import os, sys, time
from truepath_drivers.cnc.grbl.driver import GrblController
grbl = GrblController(port=sys.argv[1])
grbl.connect()
grbl.move_to([-280.0, -1.0, -1.0], 600.0)
for _ in range(10):
    grbl.status()
    time.sleep(0.05)
os.kill(os.getpid(), 9)
"""


@pytest.fixture(scope="module")
def control() -> Iterator[tuple[DeviceProcess, dict]]:
    process = DeviceProcess("cnc.grbl", {"homes": True})
    try:
        # It shares this computer, where a board does not: it may answer later.
        options = process.listening() | {"reply_timeout_s": 2.0}
        with GrblController(**options) as grbl:
            assert grbl.status().state is records.MotionState.UNHOMED
            grbl.home(10.0)
        yield process, options
    finally:
        process.release()
        process.end()


@pytest.mark.parametrize("check", MOTION_CHECKS)
def test_it_conforms(control, check):
    process, options = control
    check(lambda: GrblController(**options))
    assert process.query_state()["overflows"] == 0


def test_a_machine_whose_host_dies_stands_soon(control):
    process, options = control
    run = [sys.executable, "-c", DRIVE_AND_DIE, options["port"]]
    assert subprocess.run(run, check=False, timeout=30).returncode == -9
    time.sleep(2.0)
    first = process.query_state()
    time.sleep(0.3)
    assert process.query_state() == first
    assert first["state"] in ("Idle", "Hold")  # held by a host that was slow before
    assert first["position"][0] > -280.0
    with GrblController(**options) as grbl:
        assert grbl.status().state is records.MotionState.IDLE


def test_door_alarm_and_silence_are_told(control):
    process, options = control
    with GrblController(**options) as grbl:
        grbl.move_to([-100.0, -1.0, -1.0], 600.0)
        process.tell("door open")
        with pytest.raises(errors.MotionFault, match="door"):
            grbl.wait(5.0)
        time.sleep(0.3)
        process.tell("door close")
        time.sleep(0.05)
        assert grbl.status().hold_reason == "operator"
        grbl.resume()
        process.tell("mute")
        with pytest.raises(errors.DeviceTimeout):
            grbl.wait(5.0)
        process.tell("speak")
        time.sleep(0.05)
        process.tell("alarm 1")
        with pytest.raises(errors.MotionFault, match="limit switch"):
            grbl.wait(5.0)
        grbl.reset()
        grbl.home(10.0)
        assert grbl.status().referenced is True
