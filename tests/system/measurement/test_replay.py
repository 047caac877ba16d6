"""Runs repeated by simulated devices; targets, five axes and circles they drive."""

import sqlite3

import numpy as np
import pytest

from driven_cell import CALM, Driven, config_of, measure_undisturbed
from paths_by_hand import ACROSS as PATH
from paths_by_hand import ENDS, path_of, two_turns
from recorded import nominal_error_mm
from truepath.alignment.align import align
from truepath.alignment.stream.nominal_path import compute_nominal_path
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    FaultReported,
    LinesDamaged,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators import errors, machine_file
from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command import main
from truepath_simulators.motion.paths import turning_path
from truepath_simulators.replay.recorded_run import read_recorded_run
from truepath_simulators.replay.replay import Replay

POINTS = Configurations(PATH.axes, PATH.position[:4], np.full(4, 2.0))
SPEED = 10.0
FAULTS = ["tracker:bit-flip@700n", "tracker:drop@1900n", "tracker:lost-bytes@2500n"]


def record(devices, file, commanded):
    machine = machine_from_json(machine_file.load_machine("demo"))
    with Driven(config_of(devices, timeouts=CALM)) as driven:
        driven.cell.connect()
        driven.cell.begin(MeasurementOrder("run", str(file), machine, commanded))
        driven.until(lambda: bool(driven.of(RunClosed) or driven.faults), 50.0)
        assert not driven.of(FaultReported)
    return open_run(file)


@pytest.fixture(scope="module")
def make_run(make_once):
    """Record a Run with damaged and lost frames, once for each order."""

    def make(commanded):
        def fill(folder):
            with Bench(seed=8, speed=SPEED, faults=FAULTS, rtu=False) as bench:
                record(bench, folder / "run.sqlite", commanded)

        name = f"replayed-{type(commanded).__name__.lower()}"
        return make_once(name, fill) / "run.sqlite"

    return make


@pytest.mark.long
@pytest.mark.parametrize(
    ("commanded", "speed"), [(PATH, 1.0), (POINTS, 3.0)], ids=["path-1", "points-3"]
)
def test_a_replay_is_recorded_as_the_same_samples(make_run, tmp_path, commanded, speed):
    recorded = make_run(commanded)
    first = open_run(recorded)
    with Replay(recorded, speed) as replay:
        second = record(replay, tmp_path / "again.sqlite", first.commanded)
    n = len(first.tracker)
    assert len(second.tracker) >= n
    for name in ("sequence", "device_time_s", "position_mm", "status"):
        once, again = (getattr(run.tracker, name) for run in (first, second))
        np.testing.assert_array_equal(again[:n], once)
    # Where the host has gone on for longer than the recording: nothing that counts.
    assert (second.tracker.status[n:] != 0).all()
    assert second.provenance["tracker"] == first.provenance["tracker"]
    aligned = [align(run) for run in (first, second)]
    for field in ("tracker_mm", "count", "row"):
        once, again = (getattr(a, field) for a in aligned)
        np.testing.assert_array_equal(again, once)


def test_a_replay_holds_what_the_run_holds_and_answers_as_its_device(make_run):
    run = read_recorded_run(make_run(PATH))
    assert run.is_exact
    assert (run.samples, len(run.moves)) == (len(open_run(make_run(PATH)).tracker), 1)
    assert run.moves[0].goal == pytest.approx(ENDS[-1])
    with (
        Replay(make_run(PATH), tracker="tcp") as replay,
        StreamingTracker(**replay.tracker_options) as tracker,
    ):
        assert tracker.connect().serial_number == "SIM-000008"
        with pytest.raises(Refused, match="recorded at 500"):
            tracker.start(100.0)
        assert replay.describe()["replay"]["is_exact"]
        assert not replay.read_state()["replay"]["streaming"]


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("DELETE FROM batch WHERE stream = 'tracker.link'", "holds no bytes"),
        ("DELETE FROM manifest WHERE key = 'closed'", "is not closed"),
        ("UPDATE batch SET payload = X'00' WHERE stream = 'tracker.link'", "no bytes"),
        ("DROP TABLE batch", "is not a Run"),
    ],
)
def test_an_unrepeatable_run_is_a_clear_line(make_run, tmp_path, order, said, capsys):
    file = tmp_path / "run.sqlite"
    file.write_bytes(make_run(PATH).read_bytes())
    with sqlite3.connect(file) as database:
        database.execute(order)
    database.close()
    with pytest.raises(errors.SimulatorError, match=said):
        read_recorded_run(file)
    assert main(["--replay", str(file)]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.long
def test_a_motion_that_a_recording_lacks_ends_where_it_does(make_run, tmp_path):
    further = (400.0, 300.0, 200.0)
    longer = path_of(*ENDS, further, feed=12_000.0, dwell_s=1.0)
    ended = pytest.raises(AssertionError, match="ended-early")
    with Replay(make_run(PATH)) as replay, ended:
        record(replay, tmp_path / "again.sqlite", longer)


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
