"""Runs repeated by simulated devices: the same samples, the same tables."""

import sqlite3

import numpy as np
import pytest

from driven_cell import CALM, Driven, config_of
from paths_by_hand import ACROSS as PATH
from paths_by_hand import ENDS, path_of
from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import FaultReported, MeasurementOrder, RunClosed
from truepath.measurement.run_file.run_loader import open_run
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators import errors, machine_file
from truepath_simulators.bench.bench import Bench
from truepath_simulators.bench.command import main
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
