"""Cell processes, and all that they say."""

import os
import pickle
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import psutil
import pytest

from measurement_fixtures import Told
from truepath import child_process
from truepath.measurement.messages import CellConfig, CellVerb, RunClosed
from truepath.measurement.process.cell import Cell
from truepath.measurement.time_limits import StreamTimeouts
from truepath_simulators.bench.bench import Bench

# A computer that is busy with other things is no silent tracker.
CALM = StreamTimeouts(silent_s=10.0, dead_s=30.0, beam_s=10.0)
QUICK = get_context("forkserver")
DRIVERS = ("tracker.streaming.driver", "cnc.modbus.driver")
ROOMS = ["pytest", "truepath.measurement.process.cell_process"]
QUICK.set_forkserver_preload([*ROOMS, *(f"truepath_drivers.{d}" for d in DRIVERS)])
"""Starts processes with these imported: it takes longer than a short measurement."""


class Driven(Told):
    """A cell that runs while this is entered, and all it has said.

    beats : tell it at each look that the service can be reached
    spawns : start it as the service does, with an interpreter of its own
    """

    look_s = 0.1

    def __init__(self, config, *, beats=False, spawns=False):
        with pytest.MonkeyPatch.context() as patch:
            if not spawns:
                patch.setattr(child_process, "_SPAWN", QUICK)
            self.cell = Cell(config)
        self.events = []
        self._beats = beats

    def __enter__(self):
        self.cell.start()
        return self

    def __exit__(self, *_):
        self.cell.close()

    def begin(self, order, line=0):
        self.cell.begin(order)
        if line:
            self.until_done(line)

    def until(self, condition, timeout_s=60.0):
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline_s, self.events[-5:]
            if self._beats:
                self.cell.send(CellVerb.BEAT)
            self.events += self.cell.poll(self.look_s)

    def until_fault(self, code):
        self.until(lambda: code in self.faults)

    until_line = Told.until_done

    def until_closed(self, timeout_s=60.0):
        self.until(lambda: bool(self.of(RunClosed)), timeout_s)
        return self.of(RunClosed)[-1]


def config_of(bench, **given):
    options = bench.tracker_options, bench.motion_options
    return replace(CellConfig("streaming", options[0], "modbus", options[1]), **given)


def measure_undisturbed(order, content, folder, *, speed=10.0, faults=()):
    """Measure on a bench of its own; nothing of it is a fault of the measurement."""
    how = {"seed": 3, "speed": speed, "workdir": folder / "b", "faults": faults}
    with Bench(content, rtu=False, **how) as bench, Driven(config_of(bench)) as driven:
        driven.cell.connect()
        driven.cell.begin(order)
        driven.until_closed(120.0)
    assert driven.faults == []
    return driven


PARENT = """
import pickle, sys
from pathlib import Path
from truepath.measurement.messages import MeasurementProgress
from truepath.measurement.process.cell import Cell

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    config, order = pickle.loads((folder / "given").read_bytes())
    cell = Cell(config)
    cell.start()
    cell.connect()
    cell.begin(order)
    print(cell.process_id, flush=True)
    while not (folder / "end").exists():
        for event in cell.poll(0.1):
            if isinstance(event, MeasurementProgress):
                print(event.done, flush=True)
"""


@contextmanager
def measured_by_another(folder, config, order, *paths):
    """Measure from another process until a file `end` is there.

    Yields the process, its cell, and how many lines are done at each report.
    """
    script = folder / "parent.py"
    script.write_text(PARENT)
    (folder / "given").write_bytes(pickle.dumps((config, order)))
    places = os.pathsep.join(map(str, (Path(__file__).parents[2], *paths)))
    how = {"stdout": subprocess.PIPE, "env": os.environ | {"PYTHONPATH": places}}
    parent = subprocess.Popen([sys.executable, script, folder], **how)
    try:
        told = map(int, parent.stdout or ())
        yield parent, psutil.Process(next(told)), told
    finally:
        parent.kill()
        parent.communicate()
