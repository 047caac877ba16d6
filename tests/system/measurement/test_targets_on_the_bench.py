"""Two targets of a simulated machine: its tracker goes from one to the other."""

import time
from pathlib import Path as FilePath

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.motion.configurations import Configurations
from truepath_simulators.bench.bench import Bench
from truepath_simulators.scenario import load_machine


@pytest.mark.long
def test_a_stream_of_two_targets_is_of_each_in_its_rows(tmp_path: FilePath) -> None:
    content = load_machine("demo")
    offset_mm = content.pop("tool_offset_mm")
    content["targets"] = {
        "T1": {"on": "tool", "offset_mm": offset_mm},
        "T2": {"on": "tool", "offset_mm": [offset_mm[0] + 150.0, *offset_mm[1:]]},
    }
    machine = machine_from_json(content)
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    rng = np.random.default_rng(2)
    position = rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low), (12, 3))
    names = ("T1",) * 4 + ("T2",) * 5 + ("T1",) * 3
    points = Configurations(machine.axis_names, position, np.full(12, 2.0), names)
    order = MeasurementOrder(
        "two", str(tmp_path / "run.sqlite"), machine, points, feed_mm_min=20_000.0
    )
    with Bench(content, seed=3, speed=10.0, workdir=tmp_path / "b", rtu=False) as bench:
        config = CellConfig(
            "streaming", bench.tracker_options, "modbus", bench.motion_options
        )
        drive(Cell(config), order)
    run = open_run(order.run_file)
    seen = align(run)
    assert sorted(set(seen.row.tolist())) == list(range(12))
    off = seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    assert np.abs(off).max() < 0.4


def drive(cell: Cell, order: MeasurementOrder) -> None:
    cell.start()
    try:
        cell.connect()
        cell.begin(order)
        deadline_s = time.monotonic() + 60.0
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.1):
                assert not isinstance(event, FaultReported), event
                if isinstance(event, RunClosed):
                    return
        raise AssertionError("the run was not closed")
    finally:
        cell.close()
