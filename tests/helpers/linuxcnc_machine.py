"""One program on a headless LinuxCNC with three ideal axes, sampled at 1 kHz."""

import os
import threading
import time
from pathlib import Path

import numpy as np

from processes import until
from truepath_drivers.cnc.linuxcnc.rsh import RshLink
from truepath_drivers.transport.tcp_port import TcpPort
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig

TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-310, 10)}


def run_program(program, tables):
    """Return commanded and motor positions (n, 3), each millisecond of the program.

    tables : compensation table of each axis, type 0
    """
    machine = LinuxCncMachine(TRAVEL, tables)
    with LinuxCncRig(machine, watchdog=False, samples=True) as rig:
        samples = _Samples(rig.positions)
        rsh = RshLink(TcpPort(*rig.address()), "EMC", "EMCTOO", 5.0)
        rsh.open()
        file = Path(rig.motion_options["program_folder"]) / "program.ngc"
        file.write_text(program)
        for wish in ("estop off", "machine on", "mode manual", "home -1"):
            until(lambda wish=wish: rsh.order(wish), 20.0)
        until(lambda: rsh.read("joint_homed").startswith("YES YES YES"), 20.0)
        begin = len(samples.rows)
        for wish in ("mode auto", f"open {file}", "run"):
            until(lambda wish=wish: rsh.order(wish), 20.0)
        until(lambda: _has_ended(rsh), 60.0)
        time.sleep(0.3)
        assert rsh.take_errors() == []
        rsh.close()
    rows = np.array(samples.end()[begin:])
    assert (np.diff(rows[:, 0]) == 1).all()
    return rows[:, 4:], rows[:, 1:4]


class _Samples:
    """Takes what comes through a pipe, until its other end is closed."""

    def __init__(self, descriptor):
        self.rows = []
        self._descriptor = os.dup(descriptor)
        self._thread = threading.Thread(target=self._take)
        self._thread.start()

    def _take(self):
        with os.fdopen(self._descriptor) as lines:
            for line in lines:
                row = line.split()
                if len(row) == 7 and line.endswith("\n"):  # the last one may be cut
                    self.rows.append([float(word) for word in row])

    def end(self):
        self._thread.join()
        return self.rows


def _has_ended(rsh):
    status = rsh.read("program_status").upper()
    if status == "PAUSED":
        rsh.order("resume")
    return status == "IDLE"
