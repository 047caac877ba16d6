"""A real controller, not ours, drives our program and corrects by our tables."""

import os
import threading
import time
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from mills import build_mill
from processes import until
from truepath.compensation.export import export_result
from truepath.compensation.tables.error_map import map_errors
from truepath.files.earlier.result_file import HalfDifference
from truepath.kinematics.machine.machine import LinearAxis
from truepath.motion.nc_programs.programs import write_program
from truepath_drivers.cnc.linuxcnc.links import RshLink
from truepath_drivers.interfaces.records import Path
from truepath_drivers.transport.tcp_port import TcpPort
from truepath_simulators.linuxcnc.files import LinuxCncMachine
from truepath_simulators.linuxcnc.rig import LinuxCncRig, explain_absence

ABSENT = explain_absence()
NEEDED = pytest.mark.skipif(bool(ABSENT), reason=ABSENT or "none")
pytestmark = [pytest.mark.long, NEEDED]

# Three rows on one line: what runs through them is no exact stop.
ROWS = [(10, 10, -10), (60, 10, -10), (110, 10, -10)]
ROWS += [(110, 60, -60), (10.1234, 10, -10), (60, 10, -10)]
FEED = [6000.0, 6000.0, 3000.0, 6000.0, 6000.0, 6000.0]
TRAVEL = {"X": (-10, 510), "Y": (-10, 410), "Z": (-310, 10)}
DWELL_S = [0.5, 0.0, 0.3, 0.0, 0.2, 0.4]


def run_program(program, tables):
    """Run a program on a headless LinuxCNC with three ideal axes, sampled at 1 kHz.

    Return commanded and motor positions (n, 3), each millisecond of the program.

    tables : compensation table of each axis, type 0
    """
    machine = LinuxCncMachine(TRAVEL, tables)
    with LinuxCncRig(machine, watchdog=False, samples=True) as rig:
        samples = _Samples(rig.positions)
        rsh = RshLink(TcpPort(*rig.address()), "EMC", "EMCTOO", 5.0)
        rsh.open()
        file = FilePath(rig.motion_options["program_folder"]) / "program.ngc"
        file.write_text(program)
        for wish in ("estop off", "machine on", "mode manual", "home -1"):
            until(lambda wish=wish: rsh.order(wish), 20.0)
        until(lambda: rsh.read("joint_homed").startswith("YES YES YES"), 20.0)
        begin = len(samples.rows)
        for wish in ("mode auto", f"open {file}", "run"):
            until(lambda wish=wish: rsh.order(wish), 20.0)
        until(lambda: _has_ended(rsh), 60.0)
        time.sleep(0.3)
        assert rsh.pop_errors() == []
        rsh.close()
    rows = np.array(samples.end()[begin:])
    assert (np.diff(rows[:, 0]) == 1).all()
    return rows[:, 4:], rows[:, 1:4]


class _Samples:
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


@pytest.fixture(scope="module")
def source(loaded):
    axis = loaded.machine.linear_axes[0]
    half = HalfDifference(np.array([axis.low, axis.high]), np.full(2, 4.0))
    return map_errors(replace(loaded, halves={"EXX": half}))


@pytest.fixture(scope="module")
def driven(source):
    axes = tuple(LinearAxis(name, *travel) for name, travel in TRAVEL.items())
    machine = replace(build_mill((0.0, 0.0, -100.0)), axes=axes)
    columns = (np.array(one, float) for one in (ROWS, FEED, DWELL_S))
    path = Path(machine.axis_names, *columns)
    files = export_result(source, "linuxcnc", "comp").files
    tables = {axis: files[f"comp-{axis}.tbl"] for axis in TRAVEL}
    return (*run_program(write_program(path, machine, "linuxcnc"), tables), tables)


def test_the_controller_comes_to_a_stand_on_every_row_at_the_feed_and_dwells(driven):
    commanded, _, _ = driven
    speed = 1e3 * np.linalg.norm(np.diff(commanded, axis=0), axis=1)  # mm/s
    begin = 0
    for row, feed in zip(ROWS, FEED, strict=True):
        away = np.linalg.norm(commanded[begin:-1] - row, axis=1)
        at = begin + int(np.argmax(away < 1e-3))
        assert away[at - begin] < 1e-3, row
        # 1000 mm/s²: within a millisecond of a stand it moves at 1 mm/s at most.
        assert speed[max(at - 1, 0) : at + 2].min() < 1.0, row
        if at > begin:
            fastest = speed[begin:at].max()
            assert fastest == pytest.approx(min(feed / 60, fastest), rel=1e-3)
        begin = at
    assert speed.max() == pytest.approx(100.0, rel=1e-3)
    still = np.concatenate([[False], speed < 1e-6, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    stands = (edges[1::2] - edges[::2]) * 1e-3
    places = commanded[edges[::2]]
    for row, dwell_s in ((2, 0.3), (4, 0.2)):
        near = np.linalg.norm(places - ROWS[row], axis=1) < 1e-3
        assert stands[near].max() == pytest.approx(dwell_s, abs=0.1)


def test_the_motor_is_sent_against_the_error_in_its_direction(driven, source):
    commanded, motor, tables = driven
    for column, axis in enumerate(TRAVEL):
        table = np.array([line.split() for line in tables[axis].splitlines()], float)
        trims = [np.interp(commanded[:, column], table[:, 0], table[:, 0] - table[:, k])
                 for k in (1, 2)]  # fmt: skip
        moved = np.diff(commanded[:, column], prepend=commanded[0, column])
        steady = np.abs(moved) > 0.04  # well off a reversal, where trims are ramped
        added = (motor - commanded)[:, column]
        for k, sign in ((0, 1), (1, -1)):
            inside = steady & (np.sign(moved) == sign)
            inside &= np.roll(inside, 20) & np.roll(inside, -20)
            if inside.any():
                np.testing.assert_allclose(added[inside], trims[k][inside], atol=2e-5)
    # At the end X came up, as it came to its zero: the error since is taken away.
    place = source.middle_mm[None]
    place[0, 0] = ROWS[-1][0]
    reference = source.middle_mm[None]
    reference[0, 0] = 0.0
    error = source.error_mm(place, 1.0) - source.error_mm(reference, 1.0)
    assert (motor - commanded)[-1, 0] == pytest.approx(-error[0, 0], abs=2e-4)
