"""Cells that read real Modbus sensors of a machine that warms, faults and deaths."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import summarize_run
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    FaultReported,
    MeasurementOrder,
    MeasurementProgress,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.run_file.run_repair import repair_run
from truepath.measurement.time_limits import StreamTimeouts
from truepath.planning.lines.default_path import default_path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.hidden.warming import ThermalGrowth

pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]

CALM = StreamTimeouts(silent_s=10.0, dead_s=30.0, beam_s=10.0)
WARM = ThermalGrowth("X", 11.0, 4.0, 60.0, 3.0)


@pytest.fixture
def bench(tmp_path):
    with Bench(seed=3, speed=8.0, workdir=tmp_path / "b", hidden=[WARM]) as started:
        yield started


class Driven:
    """A cell with sensors that are asked ten times a second, and all it has said."""

    def __init__(self, bench: Bench, folder, lines: int) -> None:
        rows = bench.thermometer_options["registers"]
        quick = [{**row, "period_s": 0.1} for row in rows]
        self.cell = Cell(
            CellConfig(
                "streaming",
                bench.tracker_options,
                "modbus",
                bench.motion_options,
                CALM,
                thermometer_driver="modbus-registers",
                thermometer_options={**bench.thermometer_options, "registers": quick},
            )
        )
        machine = machine_from_json(bench.machine)
        path = default_path(machine, 12_000.0, lines=lines)
        self.order = MeasurementOrder("w", str(folder / "w.sqlite"), machine, path)
        self.events: list[CellEvent] = []

    def __enter__(self) -> Driven:
        self.cell.start()
        self.who = self.cell.connect()
        self.cell.begin(self.order)
        return self

    def __exit__(self, *_: object) -> None:
        self.cell.close()

    def until(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + 90.0
        while not condition():
            assert time.monotonic() < deadline_s, self.events[-5:]
            self.events += self.cell.poll(0.1)

    def until_line(self, line: int) -> None:
        self.until(lambda: any(p.done >= line for p in self.of(MeasurementProgress)))

    def of(self, kind):
        return [event for event in self.events if isinstance(event, kind)]

    def until_closed(self) -> RunClosed:
        self.until(lambda: bool(self.of(RunClosed)))
        return self.of(RunClosed)[-1]


def test_the_scale_of_a_warm_axis_is_seen_to_warm(bench, tmp_path):
    with Driven(bench, tmp_path, lines=12) as driven:
        closed = driven.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert driven.who["thermometers"].model == "Modbus registers"
    run = open_run(driven.order.run_file)
    facts = {one.name: one for one in summarize_run(run).sensors}
    assert len(facts) == 7
    assert all(one.is_used for one in facts.values())
    at = run.temperature
    warm = at.celsius[:, at.names.index("X")]
    assert warm[-3:].mean() - warm[:3].mean() > 0.5
    assert abs(facts["Y_degC"].change) < 0.2
    cells = add_surroundings(align(run), run.commanded, run.temperature).at
    assert cells.recorded.sensors == ("X", "Y", "Z", "spindle", "air")
    column = cells.recorded.temperature_degc[:, 0]
    assert np.corrcoef(cells.time_s, column)[0, 1] > 0.9


def test_sensors_fail_one_after_another_and_nothing_else_does(bench, tmp_path):
    with Driven(bench, tmp_path, lines=12) as driven:
        driven.until_line(2)
        bench.inject("thermometers:broken-wire*1")
        bench.inject("thermometers:exception+2s*4")
        driven.until_line(4)
        bench.inject("thermometers:disconnect")
        driven.until_line(6)
        bench.inject("thermometers:silence+8s")
        closed = driven.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    codes = {fault.code for fault in driven.of(FaultReported)}
    assert codes <= {"sensor-implausible", "sensor-silent"}
    assert "sensor-implausible" in codes
    run = open_run(driven.order.run_file)
    shown = run.temperature.celsius[np.isfinite(run.temperature.celsius)]
    assert (np.abs(shown - 21.5) < 4.0).all()
    late = run.temperature.celsius[len(run.temperature.celsius) // 2 :, 0]
    assert np.isnan(late).all()
    assert any("X_degC" in text for text in summarize_run(run).sensors_told)


def test_readings_of_a_killed_cell_are_there_again(bench, tmp_path):
    with Driven(bench, tmp_path, lines=30) as driven:
        driven.until_line(4)
        driven.cell.kill()
    repair_run(driven.order.run_file)
    run = open_run(driven.order.run_file)
    assert len(run.temperature.time_s) > 5
    assert run.temperature.time_s[-1] > run.tracker.device_time_s[-1] - 10.0
