"""A cell that measures, as the tests of faults see it: what it has said so far."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.planning.lines.default_path import default_path
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker import Tracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

E = TypeVar("E", bound=CellEvent)
RATE_HZ = 500.0
LOST_DOUBLED_OR_HIT = [
    pytest.param(
        Harm(drop=0.15, double=0.15, swap=0.15),
        marks=pytest.mark.fault_row(2),
        id="drop-double-swap",
    ),
    pytest.param(
        Harm(noise=0.3, noise_bytes=20_000), marks=pytest.mark.fault_row(3), id="noise"
    ),
]
IN_PIECES = pytest.param(
    Harm(most_bytes=1), marks=pytest.mark.fault_row(4), id="one-byte"
)


def order_of(bench: Bench, file: Path, lines: int = 4) -> MeasurementOrder:
    machine = machine_from_json(bench.machine)
    path = default_path(machine, lines=lines)
    return MeasurementOrder(file.stem, str(file), machine, path)


class Measuring:
    def __init__(self, config: CellConfig, order: MeasurementOrder) -> None:
        self.said: list[CellEvent] = []
        self.cell, self._order = Cell(config), order

    def __enter__(self) -> Measuring:
        self.cell.start()
        try:
            self.who = self.cell.connect()
            self.cell.begin(self._order)
            self.until(lambda: any(p.done >= 1 for p in self.of(MeasurementProgress)))
        except BaseException:
            self.cell.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.cell.close()

    def of(self, kind: type[E]) -> list[E]:
        return [event for event in self.said if isinstance(event, kind)]

    @property
    def faults(self) -> set[str]:
        return {event.code for event in self.of(FaultReported)}

    def until(self, condition: Callable[[], bool], within_s: float = 60.0) -> None:
        end_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end_s, self.said[-5:]
            self.said += self.cell.poll(0.02)

    def until_closed(self, runs: int = 1, within_s: float = 60.0) -> RunClosed:
        """Return how the last Run ended, once so many have."""
        self.until(lambda: len(self.of(RunClosed)) == runs, within_s)
        return self.of(RunClosed)[-1]


def read_through(tracker: Tracker, proxy: LinkProxy, harm: Harm) -> TrackerSamples:
    """Return what a driver reads while harm is done, and half a second after it."""
    tracker.start(RATE_HZ)
    blocks = [tracker.read(1.0)]
    for now, seconds in ((harm, 0.8), (Harm(), 0.5)):
        proxy.harm(to_host=now)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            blocks.append(tracker.read(0.2))
    tracker.stop()
    return TrackerSamples.join(blocks)
