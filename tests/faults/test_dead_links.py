"""A link of a cell that measures goes dead: it stays open, nothing comes through."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.planning.lines.default_path import default_path
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

HOLE = Harm(is_hole=True)
E = TypeVar("E", bound=CellEvent)


class Measuring:
    """A cell under way, and what it has said."""

    def __init__(self, config: CellConfig, order: MeasurementOrder) -> None:
        self.said: list[CellEvent] = []
        self._cell, self._order = Cell(config), order

    def __enter__(self) -> Measuring:
        self._cell.start()
        self._cell.connect()
        self._cell.begin(self._order)
        self.until(lambda: any(p.done >= 1 for p in self.of(MeasurementProgress)))
        return self

    def __exit__(self, *_: object) -> None:
        self._cell.close()

    def of(self, kind: type[E]) -> list[E]:
        return [event for event in self.said if isinstance(event, kind)]

    @property
    def faults(self) -> set[str]:
        return {event.code for event in self.of(FaultReported)}

    def until(self, condition: Callable[[], bool], within_s: float = 60.0) -> None:
        end_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end_s, self.said[-5:]
            self.said += self._cell.poll(0.02)

    def until_closed(self) -> RunClosed:
        self.until(lambda: bool(self.of(RunClosed)))
        return self.of(RunClosed)[-1]


def order_of(bench: Bench, folder: Path) -> MeasurementOrder:
    machine = machine_from_json(bench.machine)
    path = default_path(machine, lines=4)
    return MeasurementOrder("dead", str(folder / "dead.sqlite"), machine, path)


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_controller_ends_in_a_machine_that_stands(
    tmp_path, measured
):
    with (
        Bench(seed=12, speed=4.0, rtu=False) as bench,
        LinkProxy(bench.motion_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
    ):
        config = CellConfig("streaming", bench.tracker_options, "modbus", proxy.options)
        with Measuring(config, order_of(bench, tmp_path)) as measuring:
            proxy.harm(to_host=HOLE, to_device=HOLE)
            begun_s = time.monotonic()
            measuring.until(lambda: onlooker.status().state == "held", within_s=3.0)
            measured(f"held after {time.monotonic() - begun_s:.2f} s")
            assert onlooker.status().hold_reason == "watchdog"
            measuring.until(lambda: bool(measuring.faults), within_s=4.0)
            closed = measuring.until_closed()
            here = onlooker.status().position
        assert onlooker.status().position == here
    assert (closed.outcome, closed.lost_samples) == ("faulted", 0)
    assert measuring.faults <= {"control-late", "no-answer", "link-lost"}
    assert (np.diff(open_run(closed.run_file).tracker.sequence) == 1).all()


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_tracker_holds_the_feed_within_a_second(tmp_path):
    with (
        Bench(seed=12, speed=4.0, tracker="tcp", rtu=False) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
    ):
        config = CellConfig("streaming", proxy.options, "modbus", bench.motion_options)
        with Measuring(config, order_of(bench, tmp_path)) as measuring:
            proxy.harm(to_host=HOLE)
            states = measuring.of
            measuring.until(
                lambda: states(StateChanged)[-1].state == "paused", within_s=1.5
            )
            assert onlooker.status().hold_reason == "command"
            proxy.harm()
            closed = measuring.until_closed()
    assert closed.outcome == "finished"
    assert measuring.faults == {"tracker-silent"}
    gaps = np.diff(open_run(closed.run_file).tracker.sequence) - 1
    assert closed.lost_samples == gaps.sum() > 500
