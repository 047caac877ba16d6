"""The cell on a real LinuxCNC: what it refuses, and what dies or stands meanwhile."""

import os
import signal
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path as FilePath

import pytest

from driven_cell import Driven
from paths_by_hand import path_of
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement import messages
from truepath_drivers.cnc.linuxcnc.driver import LinuxCncController
from truepath_drivers.interfaces.records import MotionState
from truepath_simulators.bench.bench import Bench
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence
from truepath_simulators.machine_file import load_machine

ABSENT = explain_absence()
pytestmark = [pytest.mark.long, pytest.mark.skipif(bool(ABSENT), reason=str(ABSENT))]
TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-10, 310)}
SPEED = 20.0  # mm/s
WATCHDOG_S = 1.0
REPLY_S = 1.0  # in which the driver learns that linuxcncrsh does not answer
LATE_S = 0.5  # of a busy computer


def list_descendants(process):
    parents, names = {}, {}
    for folder in FilePath("/proc").glob("[0-9]*"):
        try:
            stat = (folder / "stat").read_text()
        except OSError:
            continue
        name, _, rest = stat.partition("(")[2].rpartition(")")
        pid = int(folder.name)
        parents[pid], names[pid] = int(rest.split()[1]), name
    below, fresh = {}, {process}
    while fresh:
        fresh = {pid for pid, parent in parents.items() if parent in fresh}
        below |= {names[pid]: pid for pid in fresh}
    return below


class OnLinuxCnc:
    """Cells that measure a long line on LinuxCNC, one after another."""

    def __init__(self, linuxcnc, bench, folder, stack):
        self.linuxcnc, self.bench = linuxcnc, bench
        self._folder, self._stack = folder, stack
        self.inside = list_descendants(linuxcnc._process.pid)

    def begin(self, **options):
        motion = self.linuxcnc.motion_options | options
        tracker = self.bench.tracker_options
        config = messages.CellConfig("streaming", tracker, "linuxcnc", motion)
        self.driven = driven = self._stack.enter_context(Driven(config))
        driven.cell.connect()
        machine = machine_from_json(load_machine("demo"))
        path = path_of((10.0, 10, 10), (400, 10, 10), feed=60.0 * SPEED)
        file = str(self._folder / f"{driven.cell.process_id}.sqlite")
        driven.begin(messages.MeasurementOrder("live", file, machine, path))
        return driven

    def drive_on(self, **options):
        driven = self.begin(**options)

        def is_on_its_way():
            return any(p.position and p.position[0] > 15.0 for p in driven.progress)

        driven.until(is_on_its_way)

    def find(self, name):
        return self.driven.cell.process_id if name == "cell" else self.inside[name]

    def motor_x(self):
        """Return where HAL sends the motor, past all that may be dead."""
        environment = {"RTAPI_UID": "65534", "PATH": os.environ["PATH"]}
        environment["RTAPI_FIFO_PATH"] = str(self.linuxcnc.folder / "run" / "fifo")
        first = str(self.inside["halsampler"])
        enter = ["nsenter", "-t", first, "-n", "-i", "-m", "-p"]
        command = [*enter, "halcmd", "-s", "getp", "joint.0.motor-pos-cmd"]
        how = {"env": environment, "capture_output": True, "text": True}
        said = subprocess.run(command, check=False, **how)
        return None if said.returncode else float(said.stdout.split()[-1])


@pytest.fixture
def rig(tmp_path):
    with (
        LinuxCncRig(LinuxCncMachine(TRAVEL), samples=True) as linuxcnc,
        Bench(source=linuxcnc.positions, source_unit_s=1e-3) as bench,
        ExitStack() as stack,
    ):
        yield OnLinuxCnc(linuxcnc, bench, tmp_path, stack)


def test_a_machine_in_emergency_stop_is_not_measured(rig):
    driven = rig.begin()
    driven.until_closed()
    (fault,) = driven.of(messages.FaultReported)
    assert fault.code == "motion-estop"
    assert "release it" in fault.action


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
def test_the_machine_stops_and_the_service_says_why(rig, name, within_s, said, blow):
    rig.drive_on(**{"reset_at_connect": True, "home_at_connect": True})
    before = rig.motor_x()
    os.kill(rig.find(name), blow)
    time.sleep(within_s + LATE_S)
    first = rig.motor_x()
    time.sleep(0.5)
    assert rig.motor_x() == first
    if (name, blow) == ("linuxcncrsh", signal.SIGKILL):
        assert first is None  # the display of this LinuxCNC: all ends with it
    else:
        assert before < first < before + SPEED * (within_s + 2 * LATE_S)
    if name == "cell" and blow == signal.SIGSTOP:
        os.kill(rig.find(name), signal.SIGCONT)
        said = "watchdog"
    driven = rig.driven
    driven.until(lambda: any(said in f.text for f in driven.of(messages.FaultReported)))
    if (name, blow) == ("cell", signal.SIGKILL):
        assert driven.faults == ["cell-died"]
        with LinuxCncController(**rig.linuxcnc.motion_options) as driver:
            status = driver.status()
            assert (status.state, status.hold_reason) == (MotionState.HELD, "watchdog")
            driver.abort()
        rig.drive_on()  # another cell begins anew
