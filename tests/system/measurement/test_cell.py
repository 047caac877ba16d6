"""Cell processes on simulated devices, over a pseudo-terminal and Modbus.

What the engine alone proves as quickly (`test_measurement.py`) is long here.
"""

import os
import signal
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import psutil
import pytest

from driven_cell import CALM, Driven, config_of, measured_by_another
from measurement_fixtures import standing_at
from processes import until
from recorded import nominal_error_mm
from truepath.alignment.align import align
from truepath.errors import MeasurementFailed, OutOfTravel, TruepathError
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement import messages, time_limits
from truepath.measurement.process import cell as cell_module
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_loader import open_run, repair_run
from truepath.planning.default_path import default_path
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import ConnectionLost, WrongDevice
from truepath_drivers.tracker.streaming import codec, framing
from truepath_simulators.bench.bench import Bench

SPEED = 10.0
RATE_HZ = 100.0  # a fifth of the usual one: less work for the same motion
HELD_S = 3.0  # by then a watchdog of one second holds, on a busy computer too

PATIENT = time_limits.StreamTimeouts(search_s=0.0)
"""The patience of the service, which asks for no search."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """One bench for all: every fault that is injected ends by itself."""
    folder = tmp_path_factory.mktemp("bench")
    with Bench(seed=3, speed=SPEED, workdir=folder) as started:
        yield started


@pytest.fixture
def start(bench):
    with ExitStack() as stack:

        def start(*, connects=True, spawns=False, **given):
            config = config_of(bench, **{"timeouts": CALM, **given})
            driven = stack.enter_context(Driven(config, spawns=spawns))
            if connects:
                driven.cell.connect()
            return driven

        yield start


@pytest.fixture
def driven(start):
    return start(connects=False)


@pytest.fixture
def connected(start):
    return start()


@pytest.fixture
def watchful(start):
    return start(timeouts=PATIENT)


@pytest.fixture(scope="module")
def orders(bench):
    """Orders of paths by their number of lines: planning takes longer than starting."""
    machine = machine_from_json(bench.machine)
    paths = {lines: default_path(machine, lines=lines) for lines in (4, 7)}
    order = partial(messages.MeasurementOrder, "bench", "", machine)
    return {lines: order(path, RATE_HZ) for lines, path in paths.items()}


@pytest.fixture
def order(orders, tmp_path):
    return replace(orders[4], run_file=str(tmp_path / "bench.sqlite"))


@pytest.fixture
def long_order(orders, tmp_path):
    """Some four seconds of motion: time to do something to it."""
    return replace(orders[7], run_file=str(tmp_path / "bench.sqlite"))


@pytest.fixture
def machine_state(bench):

    with ModbusController(**bench.motion_options) as controller:
        yield controller.status


def moves(run):
    position, time_s = run.tracker.position_mm, run.tracker.device_time_s
    n = round(0.05 / float(np.median(np.diff(time_s))))
    speed = np.linalg.norm(position[n:] - position[:-n], axis=1) / 0.05
    return int((np.diff((speed > 2.0).astype(int)) == 1).sum())


def test_over_rtu_a_cell_reads_sensors_tries_trackers_and_measures(bench, start, order):
    sensors = {"thermometer_driver": "modbus-registers"}
    sensors["thermometer_options"] = bench.thermometer_options
    driven = start(motion_options=bench.motion_options_rtu, **sensors)
    driven.until(lambda: bool(driven.of(messages.TemperaturesRead)))
    readings = driven.of(messages.TemperaturesRead)[0].readings
    assert readings
    assert all(10.0 < value < 40.0 for value in readings.values()), readings
    driven.until(lambda: bool(driven.of(messages.ControllerRead)))
    read = driven.of(messages.ControllerRead)[0]
    assert (len(read.status.position), read.axes) == (len(read.axes), ("X", "Y", "Z"))
    trial = messages.TrackerTrial(500.0, 0.2, streams_only=True)
    tried = driven.cell.try_tracker(trial)
    assert tried.rate_hz == pytest.approx(500.0, rel=0.01)
    assert tried.usable == tried.samples
    driven.cell.begin(order)
    assert driven.until_closed().outcome == "finished"


def test_a_run_over_serial_and_modbus_loses_nothing(connected, order, read_link_bytes):
    connected.cell.begin(replace(order, rate_hz=500.0))
    closed = connected.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert connected.states == ["connecting", "ready", "running", "finished"]
    run = open_run(order.run_file)
    samples = run.tracker
    assert (np.diff(samples.sequence) == 1).all()
    assert (samples.status == 0).all()
    assert moves(run) == 4
    # The bytes of the link, which are kept, decode to the samples again.
    link = read_link_bytes(order.run_file)
    assert len(link) > 44 * len(samples)
    again = codec.SampleDecoder().decode(framing.FrameReader().feed(link)).samples
    at = np.searchsorted(again.device_time_s, samples.device_time_s[0] - 1e-4)
    decoded = again.position_mm[at : at + len(samples)]
    np.testing.assert_array_equal(decoded, samples.position_mm)


def test_a_cell_measures_points_again_until_enough_is_known(connected, order, tmp_path):
    quick = replace(order, feed_mm_min=9000.0)
    corners = order.commanded.position
    connected.cell.begin(standing_at(quick, corners[:3], 2.0))
    closed = connected.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    run = open_run(order.run_file)
    assert (run.mode, moves(run)) == ("standstill", 2)
    assert connected.of(messages.MeasurementProgress)[-1].done == 3
    connected.events.clear()
    points = standing_at(quick, corners[:4], 8.0)
    second = replace(points, run_file=str(tmp_path / "second.sqlite"))
    connected.begin(second, line=1)
    connected.cell.send(messages.CellVerb.CONCLUDE)
    closed = connected.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    run = open_run(second.run_file)
    done = sum(event.kind == "point" for event in run.events)
    assert 1 <= done < 4
    assert [e.kind for e in run.events].count("concluded") == 1
    assert moves(run) == done - 1


def test_a_cell_says_who_answers_and_takes_no_order_that_cannot_be_driven(start, order):
    driven = start(connects=False, spawns=True)
    environment = psutil.Process(driven.cell.process_id).environ()
    assert environment["OMP_NUM_THREADS"] == "1"
    assert environment["OPENBLAS_NUM_THREADS"] == "1"
    driven.cell.begin(order)
    closed = driven.until_closed()
    assert (closed.outcome, closed.run_file) == ("failed", "")
    assert driven.faults == ["not-connected"]
    devices = driven.cell.connect()
    assert devices["tracker"].model == "Simulated tracker"
    assert devices["motion"].model == "Simulated CNC"
    assert driven.cell.connect() == devices
    far = replace(order.commanded, position=order.commanded.position + 9000.0)
    with pytest.raises(OutOfTravel, match="row 1: X"):
        driven.cell.begin(replace(order, commanded=far))


def test_verbs_reach_the_machine_and_a_second_order_does_not(
    connected, long_order, machine_state, tmp_path
):
    connected.begin(long_order, line=1)
    connected.cell.begin(replace(long_order, run_file=str(tmp_path / "other.sqlite")))
    connected.until_fault("busy")
    assert connected.states[-1] == "running"
    assert connected.cell.connect()["motion"].model == "Simulated CNC"
    connected.cell.send(messages.CellVerb.PAUSE)
    connected.until_state("paused")
    held = machine_state()
    assert (held.state, held.hold_reason) == ("held", "command")
    assert machine_state().position == held.position
    connected.cell.send(messages.CellVerb.RESUME)
    connected.until_state("running")
    connected.cell.send(messages.CellVerb.ABORT)
    assert connected.until_closed().outcome == "aborted"
    assert machine_state().state == "aborted"
    run = open_run(long_order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (run.provenance["outcome"], connected.faults) == ("aborted", ["busy"])
    assert not (tmp_path / "other.sqlite").exists()


@pytest.mark.fault_row(23)
def test_killing_the_cell_leaves_a_run_and_a_machine_that_holds(
    start, connected, order, long_order, machine_state, tmp_path
):
    connected.begin(long_order, line=2)
    recorded = connected.of(messages.MeasurementProgress)[-1].samples
    os.kill(connected.cell.process_id, signal.SIGKILL)
    until(lambda: machine_state().state != "running", HELD_S)
    status = machine_state()
    assert (status.state, status.hold_reason) == ("held", "watchdog")
    connected.until_state("faulted")
    assert connected.faults == ["cell-died"]
    assert not connected.cell.alive
    assert connected.cell.poll(0.0) == []
    with pytest.raises(MeasurementFailed, match="not alive"):
        connected.cell.send(messages.CellVerb.PAUSE)
    run = open_run(long_order.run_file)
    # What was on its way to the disk, at ten times the usual rate, may be missing.
    assert len(run.tracker) > recorded - 0.5 * RATE_HZ * SPEED
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert run.provenance["outcome"] == "torn"
    assert moves(run) >= 2
    assert repair_run(long_order.run_file).samples == len(run.tracker)
    second = start()
    second.cell.begin(replace(order, run_file=str(tmp_path / "second.sqlite")))
    assert second.until_closed().outcome == "finished", "another one takes over"


def assert_held(status):
    """By the cell on its way out; on a busy computer the watchdog may be faster."""
    assert status.state == "held"
    assert status.hold_reason in ("command", "watchdog")


def test_an_orphaned_cell_holds_and_ends(bench, long_order, tmp_path, machine_state):
    given = tmp_path, config_of(bench), long_order
    with measured_by_another(*given) as (parent, cell, told):
        next(done for done in told if done)
        parent.kill()
        cell.wait(25.0)
    assert_held(machine_state())
    run = open_run(long_order.run_file)
    assert run.provenance["outcome"] == "aborted"
    assert moves(run) >= 1


@pytest.mark.parametrize("is_closed", [False, True])
def test_an_ended_cell_holds_the_feed(connected, long_order, machine_state, is_closed):
    connected.begin(long_order, line=1)
    if is_closed:
        connected.cell.close()
        connected.cell.close()
        assert not connected.cell.alive
    else:
        os.kill(connected.cell.process_id, signal.SIGTERM)
        connected.until_closed()
    assert_held(machine_state())
    assert open_run(long_order.run_file).provenance["outcome"] == "aborted"


SILENCE = f"tracker:silence+{1.2 * SPEED}s"
FLIPS = f"tracker:bit-flip+{0.5 * SPEED}s*0.95"
HOLD, STOP = f"cnc:feed-hold+{SPEED}s", f"cnc:override+{13 * SPEED}s*0"


@pytest.mark.long
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        pytest.param(SILENCE, "tracker-silent", marks=pytest.mark.fault_row(5)),
        pytest.param(FLIPS, "stream-damaged", marks=pytest.mark.fault_row(1)),
        pytest.param("cnc:disconnect", "", marks=pytest.mark.fault_row(16)),
        pytest.param(HOLD, "held-at-machine", marks=pytest.mark.fault_row(20)),
        pytest.param(STOP, "feed-override", marks=pytest.mark.fault_row(20)),
    ],
)
def test_faults_that_pass_are_borne(bench, watchful, long_order, fault, code, measured):
    watchful.begin(long_order, line=1)
    bench.inject(fault)
    closed = watchful.until_closed()
    assert (closed.outcome, set(watchful.faults)) == ("finished", {code} - {""})
    if fault.startswith("tracker"):
        least_s = 0.5 if code == "tracker-silent" else 0.3
        assert closed.lost_samples > least_s * SPEED * RATE_HZ
    else:
        assert closed.lost_samples == 0
        assert moves(open_run(closed.run_file)) >= len(long_order.commanded) - 1
    measured(f"{closed.lost_samples} samples lost and counted, Run finished")


@pytest.mark.fault_row(30)
def test_a_service_that_falls_silent_is_a_hold_that_a_person_ends(connected, order):
    """Whoever has told the cell once that it can be reached has to go on."""
    connected.cell.send(messages.CellVerb.BEAT)
    connected.cell.begin(order)
    connected.until_state("paused")
    assert set(connected.faults) == {"service-silent"}
    connected.cell.send(messages.CellVerb.RESUME)
    connected.until(lambda: "resuming" in connected.states)

    def beat():
        connected.cell.send(messages.CellVerb.BEAT)
        return bool(connected.of(messages.RunClosed))

    connected.until(beat, 45.0)
    assert connected.of(messages.RunClosed)[-1].outcome == "finished"


@contextmanager
def suspended(*process_ids):
    for process_id in process_ids:
        os.kill(process_id, signal.SIGSTOP)
    try:
        yield
    finally:
        for process_id in process_ids:
            os.kill(process_id, signal.SIGCONT)


SHORT = ("tracker", 0.6), ("cnc", 0.6), ("tracker cnc", 0.6), ("cell", 0.7)
LONGER = ("cnc", 1.4), ("tracker cnc", 1.4), ("tracker", 2.0)
OTHERS = [pytest.param(*given, marks=pytest.mark.long) for given in SHORT + LONGER]


@pytest.mark.parametrize(("who", "for_s"), [("tracker cnc cell", 1.4), *OTHERS])
@pytest.mark.fault_row(30)
def test_processes_that_stand_for_a_moment_cost_time_and_no_sample(
    bench, watchful, long_order, who, for_s, measured
):
    ids = bench.process_ids | {"cell": watchful.cell.process_id}
    watchful.begin(long_order, line=1)
    with suspended(*(ids[name] for name in who.split())):
        time.sleep(for_s)  # what is tested is that time passes
    closed = watchful.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert set(watchful.faults) <= {"tracker-silent", "control-late"}
    run = open_run(long_order.run_file)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert moves(run) >= len(long_order.commanded) - 1
    measured(f"{who} for {for_s} s: {closed.lost_samples} samples lost")


@pytest.mark.fault_row(23)
def test_a_cell_that_stands_is_held_by_the_watchdog_and_waits_for_somebody(
    bench, watchful, long_order, machine_state, measured
):
    watchful.begin(long_order, line=1)
    with suspended(watchful.cell.process_id):
        begun_s = time.monotonic()
        until(lambda: machine_state().state == "held", HELD_S)
        measured(f"held {time.monotonic() - begun_s:.2f} s after the cell stood")
        assert machine_state().hold_reason == "watchdog"
    watchful.until_state("paused")
    watchful.until(lambda: watchful.faults[-1:] == ["held-at-machine"])
    assert "watchdog" in watchful.of(messages.FaultReported)[-1].text
    assert machine_state().state == "held"
    watchful.cell.send(messages.CellVerb.RESUME)
    closed = watchful.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)


@pytest.mark.long
@pytest.mark.fault_row(9)
def test_a_target_that_only_a_search_finds_needs_nobody(bench, start, order):
    searching = start(timeouts=time_limits.StreamTimeouts())
    searching.begin(order, line=2)
    bench.inject("tracker:beam-lost")
    assert searching.until_closed().outcome == "finished"
    assert searching.faults == ["beam-lost"]
    run = open_run(order.run_file)
    kinds = [event.kind for event in run.events]
    assert kinds.count("found") == 1
    assert "again" in kinds
    assert (run.tracker.status != 0).any()
    assert len(run.commanded) > len(order.commanded)
    seen = align(run)
    assert np.abs(nominal_error_mm(seen)).max() < 0.4
    missing = set(range(1, len(run.commanded))) - set(seen.row.tolist())
    assert len(missing) <= 1  # the line that the beam was lost on


@pytest.mark.long
@pytest.mark.fault_row(7)
def test_a_wrong_device_on_the_port_is_refused_by_name(tmp_path, measured):
    faults = ["tracker:wrong-identity"]
    with (
        Bench(speed=SPEED, faults=faults, workdir=tmp_path / "b", rtu=False) as bench,
        Driven(config_of(bench)) as driven,
    ):
        begun_s = time.monotonic()
        with pytest.raises(WrongDevice):
            driven.cell.connect()
        measured(f"refused after {time.monotonic() - begun_s:.2f} s")


def test_a_cell_that_hangs_is_ended_by_force(driven, monkeypatch):
    monkeypatch.setattr(cell_module, "CLOSE_S", 0.2)
    monkeypatch.setattr(cell_module, "FORCE_S", 0.2)
    monkeypatch.setattr(cell_module, "CONNECT_S", 0.2)
    process = psutil.Process(driven.cell.process_id)
    process.suspend()
    with pytest.raises(MeasurementFailed, match=r"did not answer in 0\.2 s"):
        driven.cell.connect()
    driven.cell.close()
    assert not process.is_running()


def test_a_cell_that_dies_while_it_connects_says_so(driven):
    process = psutil.Process(driven.cell.process_id)
    process.suspend()
    killer = threading.Timer(0.3, process.kill)
    killer.start()
    with pytest.raises(MeasurementFailed, match="died"):
        driven.cell.connect()
    killer.join()


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"tracker_driver": "none"}, TruepathError, "no trackers called 'none'"),
        ({"tracker_options": {"prot": "x"}}, TruepathError, "prot"),
        ({"tracker_options": {"port": "/dev/gone"}}, ConnectionLost, "/dev/gone"),
    ],
)
def test_an_unknown_driver_option_or_port_is_named(start, given, error, said):
    driven = start(connects=False, **given)
    with pytest.raises(error, match=said):
        driven.cell.connect()


def test_a_cell_that_was_never_started_can_be_closed():
    cell = Cell(messages.CellConfig("streaming", {}, "modbus", {}))
    assert not cell.alive
    assert cell.poll(0.0) == []
    with pytest.raises(MeasurementFailed, match="not alive"):
        cell.connect()
    cell.close()
