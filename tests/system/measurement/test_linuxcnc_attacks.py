"""What dies or stands while LinuxCNC moves: the machine stops, the service says why."""

import os
import signal
import subprocess
import time
from pathlib import Path as FilePath

import numpy as np
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
)
from truepath.measurement.process.cell import Cell
from truepath_drivers.interfaces.records import Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence
from truepath_simulators.scenario import load_machine

ABSENT = explain_absence()
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none"),
]
TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-10, 310)}
READY = {"reset_at_connect": True, "home_at_connect": True}
SPEED = 20.0  # mm/s
WATCHDOG_S = 1.0
REPLY_S = 1.0  # in which the driver learns that linuxcncrsh does not answer
LATE_S = 0.5  # of a busy computer


def list_descendants(process):
    """Return name and id of all processes below one, in any namespace."""
    parents, names = {}, {}
    for folder in FilePath("/proc").glob("[0-9]*"):
        try:
            name, _, rest = (
                (folder / "stat").read_text().partition("(")[2].rpartition(")")
            )
        except OSError:
            continue
        pid = int(folder.name)
        parents[pid], names[pid] = int(rest.split()[1]), name
    below, fresh = {}, {process}
    while fresh:
        fresh = {pid for pid, parent in parents.items() if parent in fresh}
        below |= {names[pid]: pid for pid in fresh}
    return below


class Attacked:
    """A cell that measures a long line on LinuxCNC."""

    def __init__(self, linuxcnc, cell):
        self.linuxcnc, self.cell = linuxcnc, cell
        self.inside = list_descendants(linuxcnc._process.pid)

    def find(self, name):
        return self.cell.process_id if name == "cell" else self.inside[name]

    def motor_x(self):
        """Return where HAL sends the motor, past all that may be dead."""
        environment = {
            "RTAPI_UID": "65534",
            "RTAPI_FIFO_PATH": str(self.linuxcnc.folder / "run" / "fifo"),
            "PATH": os.environ["PATH"],
        }
        first = self.inside["halsampler"]
        enter = ["nsenter", "-t", str(first), "-n", "-i", "-m", "-p"]
        said = subprocess.run(
            [*enter, "halcmd", "-s", "getp", "joint.0.motor-pos-cmd"],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return None if said.returncode else float(said.stdout.split()[-1])


@pytest.fixture
def attacked(tmp_path):
    with (
        LinuxCncRig(LinuxCncMachine(TRAVEL), samples=True) as linuxcnc,
        Bench(source=linuxcnc.positions, source_unit_s=1e-3) as bench,
    ):
        options = linuxcnc.motion_options | READY
        cell = Cell(CellConfig("streaming", bench.tracker_options, "linuxcnc", options))
        cell.start()
        try:
            cell.connect()
            machine = machine_from_json(load_machine("demo"))
            rows = np.array([[10.0, 10, 10], [400, 10, 10]])
            path = Path(machine.axis_names, rows, np.full(2, 60.0 * SPEED), np.zeros(2))
            file = str(tmp_path / "run.sqlite")
            cell.begin(MeasurementOrder("live", file, machine, path))
            events_until(cell, is_under_way)
            yield Attacked(linuxcnc, cell)
        finally:
            cell.close()


def is_under_way(event):
    is_progress = isinstance(event, MeasurementProgress)
    return is_progress and bool(event.position) and event.position[0] > 15.0


def events_until(cell, is_wanted, within_s=30.0):
    seen, deadline_s = [], time.monotonic() + within_s
    while not any(map(is_wanted, seen)):
        assert time.monotonic() < deadline_s, seen[-5:]
        seen += cell.poll(0.1)
    return seen


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP], ids=lambda b: b.name)
@pytest.mark.parametrize(
    ("name", "within_s", "said"),
    [
        ("cell", WATCHDOG_S, ""),
        ("milltask", WATCHDOG_S, "milltask of LinuxCNC does not run"),
        ("io", WATCHDOG_S, "io of LinuxCNC does not run"),
        ("linuxcncrsh", REPLY_S + WATCHDOG_S, "127.0.0.1"),
        ("python3", REPLY_S + WATCHDOG_S, "watchdog"),
    ],
)
def test_the_machine_stops_and_the_service_says_why(
    attacked, name, within_s, said, blow
):
    before = attacked.motor_x()
    os.kill(attacked.find(name), blow)
    time.sleep(within_s + LATE_S)
    first = attacked.motor_x()
    time.sleep(0.5)
    assert attacked.motor_x() == first
    if (name, blow) == ("linuxcncrsh", signal.SIGKILL):
        assert first is None  # the display of this LinuxCNC: all ends with it
    else:
        assert before < first < before + SPEED * (within_s + 2 * LATE_S)
    if name == "cell" and blow == signal.SIGSTOP:
        os.kill(attacked.find(name), signal.SIGCONT)
        said = "watchdog"
    events_until(
        attacked.cell, lambda e: isinstance(e, FaultReported) and said in e.text
    )
