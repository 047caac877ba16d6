"""A five-axis machine on simulated devices: driven over Modbus, seen by the tracker."""

import time
from pathlib import Path as FilePath

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath_drivers.interfaces.records import Path
from truepath_simulators.bench.bench import Bench
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.turning_paths import turning_path
from truepath_simulators.scenario import load_machine

SPEED = 10.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Drive lines of all axes; the tracker goes from target to target by itself."""
    folder, content = tmp_path_factory.mktemp("rotary"), load_machine("head-table")
    machine = machine_from_json(content)
    program = turning_path(parse_machine(content), 6, 12, 20_000.0)
    path = Path(
        machine.axis_names,
        program.position,
        60.0 * program.feed_mm_s,
        program.dwell_s,
        program.target,
    )
    file = folder / "run.sqlite"
    with Bench(content, seed=3, speed=SPEED, workdir=folder / "b", rtu=False) as bench:
        config = CellConfig(
            "streaming", bench.tracker_options, "modbus", bench.motion_options
        )
        measured(Cell(config), MeasurementOrder("rotary", str(file), machine, path))
    return open_run(file)


def measured(cell: Cell, order: MeasurementOrder) -> None:
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        deadline_s = time.monotonic() + 50.0
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.1):
                assert not isinstance(event, FaultReported), event
                if isinstance(event, RunClosed):
                    return
        raise AssertionError("the run was not closed")
    finally:
        cell.close()


def test_lines_on_which_axes_turn_are_driven_and_recognised(run: Run) -> None:
    seen = align(run)
    length = compute_nominal_path(run.machine, run.commanded).length_mm
    moving = np.flatnonzero(length > 1.0).tolist()
    found = [p.row for p in seen.passes]
    # On a busy computer the hastened stream ends a little before the motion.
    assert found == moving[: len(found)]
    assert len(found) > 8
    off = seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    assert np.abs(off).max() < 0.4


def test_a_run_of_arcs_survives_its_bundle(run: Run, tmp_path: FilePath) -> None:
    write_bundle(run, tmp_path / "bundle")
    back = read_bundle(tmp_path / "bundle")
    assert back.commanded.target == run.commanded.target
    np.testing.assert_allclose(back.commanded.position, run.commanded.position)
    assert len(align(back)) == len(align(run))
