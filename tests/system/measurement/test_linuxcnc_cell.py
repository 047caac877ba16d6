"""The cell on a real LinuxCNC: what it refuses, and what stays when it is killed."""

import os
import signal
import time

import numpy as np
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath_drivers.cnc.linuxcnc.driver import LinuxCncController
from truepath_drivers.interfaces.records import MotionState, Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence
from truepath_simulators.scenario import load_machine

ABSENT = explain_absence()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none"),
]
READY = {"reset_at_connect": True, "home_at_connect": True}


@pytest.fixture
def rig():
    machine = LinuxCncMachine({"X": (-10, 510), "Y": (-10, 410), "Z": (-10, 310)})
    with (
        LinuxCncRig(machine, samples=True) as linuxcnc,
        Bench(source=linuxcnc.positions, source_unit_s=1e-3) as bench,
    ):
        yield linuxcnc, bench


@pytest.fixture
def begin(rig, tmp_path):
    """Begin a long line with a cell whose driver has these options besides."""
    linuxcnc, bench = rig
    cells = []

    def begin(**options):
        motion = linuxcnc.motion_options | options
        cell = Cell(CellConfig("streaming", bench.tracker_options, "linuxcnc", motion))
        cells.append(cell)
        cell.start()
        cell.connect()
        machine = machine_from_json(load_machine("demo"))
        rows = np.array([[10.0, 10, 10], [400, 10, 10]])
        path = Path(machine.axis_names, rows, np.full(2, 1200.0), np.zeros(2))
        file = str(tmp_path / f"run{len(cells)}.sqlite")
        cell.begin(MeasurementOrder("live", file, machine, path))
        return cell

    yield begin
    for cell in cells:
        cell.close()


def events_until(cell, is_wanted, within_s=30.0):
    seen, deadline_s = [], time.monotonic() + within_s
    while not any(map(is_wanted, seen)):
        assert time.monotonic() < deadline_s, seen[-5:]
        seen += cell.poll(0.1)
    return seen


def test_a_machine_in_emergency_stop_is_not_measured(begin):
    seen = events_until(begin(), lambda e: isinstance(e, RunClosed))
    (fault,) = [e for e in seen if isinstance(e, FaultReported)]
    assert fault.code == "motion-estop"
    assert "release it" in fault.action


def test_a_killed_cell_leaves_a_machine_that_stands(begin, rig):
    cell = begin(**READY)
    events_until(
        cell,
        lambda e: (
            isinstance(e, MeasurementProgress)
            and bool(e.position)
            and e.position[0] > 15.0
        ),
    )
    os.kill(cell.process_id, signal.SIGKILL)
    events_until(cell, lambda e: isinstance(e, FaultReported) and e.code == "cell-died")
    time.sleep(1.5)
    with LinuxCncController(**rig[0].motion_options) as driver:
        first = driver.status()
        time.sleep(0.3)
        assert driver.status() == first
        assert (first.state, first.hold_reason) == (MotionState.HELD, "watchdog")
        assert first.position[0] < 100.0
        driver.abort()
    # Another cell begins anew.
    events_until(
        begin(),
        lambda e: (
            isinstance(e, MeasurementProgress)
            and bool(e.position)
            and e.position[0] > 15.0
        ),
    )
