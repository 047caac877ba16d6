"""Several targets, five axes and circles: driven by simulated devices, recognised."""

import numpy as np
import pytest

from driven_cell import measure_undisturbed
from paths_by_hand import path_of, two_turns
from recorded import nominal_error_mm
from truepath.alignment.align import align
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import LinesDamaged, MeasurementOrder
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.configurations import Configurations
from truepath_simulators import machine_file
from truepath_simulators.motion.paths import turning_path


def measure(content, commanded, folder, **given):
    machine, file = machine_from_json(content), folder / "run.sqlite"
    order = MeasurementOrder("b", str(file), machine, commanded, feed_mm_min=20_000.0)
    driven = measure_undisturbed(order, content, folder, **given)
    run = open_run(file)
    return run, align(run), driven


def find_farthest_mm(seen):

    return np.abs(nominal_error_mm(seen)).max()


@pytest.mark.long
def test_a_stream_of_two_targets_is_of_each_in_its_rows(tmp_path):
    content = machine_file.load_machine("demo")
    offset_mm = content.pop("tool_offset_mm")
    beside_mm = [offset_mm[0] + 150.0, *offset_mm[1:]]
    places = {"T1": offset_mm, "T2": beside_mm}.items()
    content["targets"] = {n: {"on": "tool", "offset_mm": at} for n, at in places}
    machine = machine_from_json(content)
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    share = np.random.default_rng(2).uniform(0.2, 0.8, (12, 3))
    names = ("T1",) * 4 + ("T2",) * 5 + ("T1",) * 3
    position = low + share * (high - low)
    points = Configurations(machine.axis_names, position, np.full(12, 2.0), names)
    _, seen, _ = measure(content, points, tmp_path)
    assert sorted(set(seen.row.tolist())) == list(range(12))
    assert find_farthest_mm(seen) < 0.4


def test_lines_on_which_axes_turn_are_driven_recognised_and_survive_a_bundle(tmp_path):
    content = machine_file.load_machine("head-table")
    program = turning_path(machine_file.parse_machine(content), 6, 12, 20_000.0)
    given = {"dwell_s": program.dwell_s, "target": program.target}
    given["axes"] = machine_from_json(content).axis_names
    path = path_of(*program.position, feed=60.0 * program.feed_mm_s, **given)
    run, seen, _ = measure(content, path, tmp_path)
    length = compute_nominal_path(run.machine, run.commanded).length_mm
    found = [p.row for p in seen.passes]
    # On a busy computer the hastened stream ends a little before the motion.
    assert found == np.flatnonzero(length > 1.0).tolist()[: len(found)]
    assert len(found) > 8
    assert find_farthest_mm(seen) < 0.4
    write_bundle(run, tmp_path / "bundle")
    back = read_bundle(tmp_path / "bundle")
    assert back.commanded.target == run.commanded.target
    np.testing.assert_allclose(back.commanded.position, run.commanded.position)
    assert len(align(back)) == len(seen)


@pytest.mark.long
def test_a_beam_break_in_a_circle_of_simulated_devices_costs_nothing(tmp_path):
    content = machine_file.load_machine("demo")
    circles = two_turns(250.0, 200.0, 60.0, 150.0)
    corners = [(100.0, 100.0, 50.0), (400.0, 320.0, 250.0)]
    more = [(100.0, 320.0, 250.0), (400.0, 100.0, 50.0)]
    arc = (None, None, *circles.arc, *(None,) * 4)
    rows = [*corners, *circles.position, *more, *corners]
    path = path_of(*rows, feed=7500.0, dwell_s=1.0, arc=arc)
    faults = ["tracker:beam-break@14s+0.2s"]
    run, seen, driven = measure(content, path, tmp_path, speed=4.0, faults=faults)
    (first,) = driven.of(LinesDamaged)
    assert path.arc[first.row]
    arcs = run.commanded.arc
    again = [row for row in range(len(path), len(arcs)) if arcs[row]]
    whole = {arcs[arc.row] for arc in seen.arcs if arc.row in again}
    assert path.arc[first.row] in whole
