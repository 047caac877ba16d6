"""Cell processes, and all that they say."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import psutil
import pytest

from truepath import child_process
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    CellVerb,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.measurement.process.cell import Cell
from truepath_simulators.bench.bench import Bench
from truepath_simulators.processes import DeviceProcesses

E = TypeVar("E")
QUICK = get_context("forkserver")
QUICK.set_forkserver_preload(
    [
        "pytest",
        "truepath.measurement.process.cell_process",
        "truepath_drivers.tracker.streaming.driver",
        "truepath_drivers.cnc.modbus.driver",
    ]
)
"""Starts processes with these imported: it takes longer than a short measurement."""


class Driven:
    """A cell that runs while this is entered, and all it has said.

    beats : tell it at each look that the service can be reached
    spawns : start it as the service does, with an interpreter of its own
    """

    look_s = 0.1

    def __init__(
        self, config: CellConfig, *, beats: bool = False, spawns: bool = False
    ) -> None:
        with pytest.MonkeyPatch.context() as patch:
            if not spawns:
                patch.setattr(child_process, "_SPAWN", QUICK)
            self.cell = Cell(config)
        self.events: list[CellEvent] = []
        self._beats = beats

    def __enter__(self) -> Driven:
        self.cell.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cell.close()

    def begin(self, order: MeasurementOrder, line: int = 0) -> None:
        self.cell.begin(order)
        if line:
            self.until_line(line)

    def until(self, condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline_s, self.events[-5:]
            if self._beats:
                self.cell.send(CellVerb.BEAT)
            self.events += self.cell.poll(self.look_s)

    def of(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]

    @property
    def states(self) -> list[str]:
        return [event.state for event in self.of(StateChanged)]

    @property
    def faults(self) -> list[str]:
        return [event.code for event in self.of(FaultReported)]

    def until_state(self, state: str) -> None:
        self.until(lambda: self.states[-1:] == [state])

    def until_fault(self, code: str) -> None:
        self.until(lambda: code in self.faults)

    def until_line(self, line: int) -> None:
        self.until(lambda: any(p.done >= line for p in self.of(MeasurementProgress)))

    def until_closed(self, timeout_s: float = 45.0) -> RunClosed:
        self.until(lambda: bool(self.of(RunClosed)), timeout_s)
        return self.of(RunClosed)[-1]


def config_of(bench: DeviceProcesses, **given) -> CellConfig:
    config = CellConfig(
        "streaming", bench.tracker_options, "modbus", bench.motion_options
    )
    return replace(config, **given)


def measure_undisturbed(
    order: MeasurementOrder,
    content: dict,
    folder: Path,
    *,
    speed: float = 10.0,
    faults: Sequence[str] = (),
) -> Driven:
    """Measure on a bench of its own; nothing of it is a fault of the measurement."""
    with (
        Bench(
            content, seed=3, speed=speed, workdir=folder / "b", rtu=False, faults=faults
        ) as bench,
        Driven(config_of(bench)) as driven,
    ):
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
def measured_by_another(
    folder: Path, config: CellConfig, order: MeasurementOrder, *paths: Path
) -> Iterator[tuple[subprocess.Popen, psutil.Process, Iterator[int]]]:
    """Measure from another process until a file `end` is there.

    Yields the process, its cell, and how many lines are done at each report.
    """
    script = folder / "parent.py"
    script.write_text(PARENT)
    (folder / "given").write_bytes(pickle.dumps((config, order)))
    places = os.pathsep.join(map(str, (Path(__file__).parents[2], *paths)))
    parent = subprocess.Popen(
        [sys.executable, script, folder],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": places},
    )
    try:
        told = map(int, parent.stdout or ())
        yield parent, psutil.Process(next(told)), told
    finally:
        parent.kill()
        parent.communicate()
