"""A circle that simulated devices could not measure whole is driven again."""

from pathlib import Path as FilePath

import numpy as np
import pytest

from driven_cell import measure_undisturbed
from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import LinesDamaged, MeasurementOrder
from truepath.measurement.run_file.run_reading import open_run
from truepath_drivers.interfaces.arcs import turn_about
from truepath_drivers.interfaces.records import Arc, Path
from truepath_simulators.scenario import load_machine


def make_small_circles() -> Path:
    """Return two circles of 60 mm radius, six seconds each, between straight lines."""
    centre, turn_deg = (250.0, 200.0), 732.0
    begin = np.array([310.0, 200.0, 150.0])
    arcs = [Arc("XY", centre, turn_deg), Arc("XY", centre, -turn_deg)]
    axes = ("X", "Y", "Z")
    (end,) = turn_about(axes, begin, arcs[0], np.array([turn_deg]))
    corners = np.array([[100.0, 100.0, 50.0], [400.0, 320.0, 250.0]])
    more = np.array([[100.0, 320.0, 250.0], [400.0, 100.0, 50.0]])
    rows = np.vstack([corners, begin, end, begin, more, corners])
    count = len(rows)
    arc = (None, None, None, *arcs, *(None,) * (count - 5))
    return Path(axes, rows, np.full(count, 7500.0), np.full(count, 1.0), arc=arc)


@pytest.mark.long
def test_a_beam_break_in_a_circle_of_simulated_devices_costs_nothing(
    tmp_path: FilePath,
) -> None:
    content = load_machine("demo")
    machine = machine_from_json(content)
    path = make_small_circles()
    order = MeasurementOrder(
        "circles", str(tmp_path / "run.sqlite"), machine, path, feed_mm_min=20_000.0
    )
    faults = ["tracker:beam-break@14s+0.2s"]
    driven = measure_undisturbed(order, content, tmp_path, speed=4.0, faults=faults)
    run = open_run(order.run_file)
    seen = align(run)
    (first,) = driven.of(LinesDamaged)
    assert isinstance(run.commanded, Path)
    assert path.arc[first.row]
    again = [
        row for row in range(len(path), len(run.commanded)) if run.commanded.arc[row]
    ]
    whole = {run.commanded.arc[arc.row] for arc in seen.arcs if arc.row in again}
    assert path.arc[first.row] in whole
