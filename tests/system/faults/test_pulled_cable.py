"""A tracker's cable is pulled while a cell measures; its port is renumbered."""

from __future__ import annotations

import os
import time

import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement import messages
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_loader import open_run
from truepath.planning.lines.default_path import default_path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import LinkProxy

SPEED = 10.0


def point_to(link, proxy):
    """Let the name of the device lead to the terminal that it has now."""
    link.unlink(missing_ok=True)
    link.symlink_to(proxy.options["port"])


def listen(cell, kind):
    """Return what the cell says until something of that kind has come."""
    said = []
    end_s = time.monotonic() + 45.0
    while not any(isinstance(event, kind) for event in said):
        assert time.monotonic() < end_s, said[-5:]
        said += cell.poll(0.1)
    return said


def order_of(bench, file, lines):
    machine = machine_from_json(bench.machine)
    path = default_path(machine, lines=lines)
    return messages.MeasurementOrder(file.stem, str(file), machine, path)


@pytest.mark.long
@pytest.mark.fault_row(6)
def test_a_pulled_cable_ends_the_run_and_the_renumbered_port_is_opened_by_its_name(
    tmp_path,
):
    link = tmp_path / "tracker-by-id"
    with Bench(seed=3, speed=SPEED, rtu=False) as bench:
        config = messages.CellConfig(
            "streaming",
            {**bench.tracker_options, "port": str(link)},
            "modbus",
            bench.motion_options,
        )
        cell = Cell(config)
        cell.start()
        try:
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                was = cell.connect()
                cell.begin(order_of(bench, tmp_path / "pulled.sqlite", 6))
                listen(cell, messages.MeasurementProgress)
                time.sleep(0.5)
                taken = os.readlink(link)
                keep = os.open(taken, os.O_RDWR | os.O_NOCTTY)  # another number next
            said = listen(cell, messages.RunClosed)
            closed = next(
                event for event in said if isinstance(event, messages.RunClosed)
            )
            fault = next(
                event for event in said if isinstance(event, messages.FaultReported)
            )
            assert closed.outcome == "faulted"
            assert str(link) in fault.text + closed.failure
            run = open_run(closed.run_file)
            assert len(run.tracker.sequence) == closed.samples > 0
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                assert os.readlink(link) != taken
                os.close(keep)
                assert cell.connect() == was
                cell.begin(order_of(bench, tmp_path / "again.sqlite", 2))
                said = listen(cell, messages.RunClosed)
            closed = next(
                event for event in said if isinstance(event, messages.RunClosed)
            )
            assert (closed.outcome, closed.lost_samples) == ("finished", 0)
        finally:
            cell.close()
