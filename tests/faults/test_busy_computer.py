"""A cell measures at 500 Hz while others take the processors."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import psutil
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    CellEvent,
    FaultReported,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.planning.lines.default_path import default_path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

HOG = "import os\nwhile True: [bytearray(1 << 20) for _ in range(64)]"


@contextmanager
def hogs(count: int) -> Iterator[None]:
    """Let processes compute and take memory in vain, as many as are asked for."""
    begun = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(count)]
    try:
        yield
    finally:
        for one in begun:
            one.kill()
            one.wait()


def measure(config: CellConfig, order: MeasurementOrder) -> list[CellEvent]:
    """Return what a cell of its own says until the Run is closed."""
    cell, said = Cell(config), []
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        end_s = time.monotonic() + 300.0
        while not any(isinstance(event, RunClosed) for event in said):
            assert time.monotonic() < end_s, said[-5:]
            said += cell.poll(0.1)
    finally:
        cell.close()
    return said


def order_of(bench: Bench, tmp_path, lines: int) -> MeasurementOrder:
    machine = machine_from_json(bench.machine)
    file = str(tmp_path / "run.sqlite")
    return MeasurementOrder("busy", file, machine, default_path(machine, lines=lines))


@pytest.mark.long
@pytest.mark.fault_row(31)
def test_every_sample_is_recorded_or_counted_as_lost(tmp_path, measured):
    with Bench(seed=12) as bench, hogs(2 * (psutil.cpu_count() or 2)):
        config = CellConfig(
            "streaming", bench.tracker_options, "modbus", bench.motion_options
        )
        said = measure(config, order_of(bench, tmp_path, 4))
    closed = next(event for event in said if isinstance(event, RunClosed))
    assert closed.outcome in ("finished", "faulted")
    run = open_run(closed.run_file)
    gaps = int((np.diff(run.tracker.sequence) - 1).sum())
    assert closed.lost_samples >= gaps
    measured(f"{closed.lost_samples} of {closed.samples} samples lost, all counted")
    step_s = np.diff(run.tracker.device_time_s) / np.diff(run.tracker.sequence)
    np.testing.assert_allclose(step_s, 0.002, rtol=1e-3)
    if closed.outcome == "faulted":
        assert any(isinstance(event, FaultReported) for event in said)


@pytest.mark.long
@pytest.mark.fault_row(8)
def test_a_late_link_is_no_broken_beam_and_no_silence(tmp_path):
    with (
        Bench(seed=12, tracker="tcp", speed=4.0) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
    ):
        proxy.harm(to_host=Harm(latency_s=0.2, jitter_s=0.1))
        config = CellConfig("streaming", proxy.options, "modbus", bench.motion_options)
        said = measure(config, order_of(bench, tmp_path, 4))
    closed = next(event for event in said if isinstance(event, RunClosed))
    assert closed.outcome == "finished"
    assert closed.lost_samples == 0
    assert not [event for event in said if isinstance(event, FaultReported)]
