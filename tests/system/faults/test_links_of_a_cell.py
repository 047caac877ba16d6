"""A cell measures while links die, are late or pulled, and while others compute."""

import ctypes
import gc
import math
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import psutil
import pytest

from driven_cell import Driven, config_of
from measuring import Measuring, measuring_on, order_of
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement import messages
from truepath.measurement.monitors.stream_reader import StreamState, record_stream
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.run_file.run_loader import open_run
from truepath.planning.default_path import default_path
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.records import Path
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

HOLE = Harm(is_hole=True)


def run_on(bench, folder, lines=4, **options):
    return measuring_on(bench, folder / "run.sqlite", lines, **options)


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_controller_ends_in_a_machine_at_rest(tmp_path, measured):
    with (
        Bench(seed=12, speed=4.0, rtu=False) as bench,
        LinkProxy(bench.motion_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
    ):
        with run_on(bench, tmp_path, motion_options=proxy.options) as measuring:
            proxy.harm(to_host=HOLE, to_device=HOLE)
            begun_s = time.monotonic()
            measuring.until(lambda: onlooker.status().state == "held", timeout_s=3.0)
            measured(f"held after {time.monotonic() - begun_s:.2f} s")
            assert onlooker.status().hold_reason == "watchdog"
            measuring.until(lambda: bool(measuring.faults), timeout_s=4.0)
            closed = measuring.until_closed()
            here = onlooker.status().position
        assert onlooker.status().position == here
    assert (closed.outcome, closed.lost_samples) == ("faulted", 0)
    assert measuring.faults <= {"control-late", "no-answer", "link-lost"}
    assert (np.diff(open_run(closed.run_file).tracker.sequence) == 1).all()


@pytest.mark.long
@pytest.mark.fault_row(16)
def test_a_dead_link_to_the_tracker_holds_the_feed_within_a_second(tmp_path):
    with (
        Bench(seed=12, speed=4.0, tracker="tcp", rtu=False) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
        ModbusController(**bench.motion_options) as onlooker,
        run_on(bench, tmp_path, tracker_options=proxy.options) as measuring,
    ):
        proxy.harm(to_host=HOLE)
        told = partial(measuring.of, messages.StateChanged)
        measuring.until(lambda: told()[-1].state == "paused", 1.5)
        assert onlooker.status().hold_reason == "command"
        proxy.harm()
        closed = measuring.until_closed()
    assert (closed.outcome, measuring.faults) == ("finished", {"tracker-silent"})
    gaps = np.diff(open_run(closed.run_file).tracker.sequence) - 1
    assert closed.lost_samples == gaps.sum() > 500


ROWS = np.array([[100.0, 100.0, 100.0], [300.0, 200.0, 100.0]] * 4)
TO_AND_FRO = Path(("X", "Y", "Z"), ROWS, np.full(8, 9000.0), np.full(8, 0.2))
HOG = "import os\nwhile True: [bytearray(1 << 20) for _ in range(64)]"


@contextmanager
def hogs(count):
    begun = [subprocess.Popen([sys.executable, "-c", HOG]) for _ in range(count)]
    try:
        yield
    finally:
        for one in begun:
            one.kill()
            one.wait()


@pytest.mark.long
@pytest.mark.fault_row(31)
def test_every_sample_is_recorded_or_counted_as_lost(tmp_path, measured):
    with Bench(seed=12, rtu=False) as bench:
        order = replace(order_of(bench, tmp_path / "busy.sqlite"), commanded=TO_AND_FRO)
        cores = psutil.cpu_count() or 2
        with Measuring(config_of(bench), order) as measuring, hogs(2 * cores):
            closed = measuring.until_closed(timeout_s=120.0)
    assert closed.outcome in ("finished", "faulted")
    run = open_run(closed.run_file)
    assert closed.lost_samples >= (np.diff(run.tracker.sequence) - 1).sum()
    measured(f"{closed.lost_samples} of {closed.samples} samples lost, all counted")
    step_s = np.diff(run.tracker.device_time_s) / np.diff(run.tracker.sequence)
    np.testing.assert_allclose(step_s, 0.002, rtol=1e-3)
    assert measuring.faults or closed.outcome == "finished"


@pytest.mark.long
@pytest.mark.fault_row(8)
def test_a_late_link_is_no_broken_beam_and_no_silence(tmp_path):
    with (
        Bench(seed=12, tracker="tcp", speed=4.0) as bench,
        LinkProxy(bench.tracker_options, seed=3) as proxy,
    ):
        proxy.harm(to_host=Harm(latency_s=0.2, jitter_s=0.1))
        with run_on(bench, tmp_path, 2, tracker_options=proxy.options) as measuring:
            closed = measuring.until_closed()
    assert (closed.outcome, closed.lost_samples) == ("finished", 0)
    assert measuring.faults == set()


def point_to(link, proxy):
    """Let the name of the device lead to the terminal that it has now."""
    link.unlink(missing_ok=True)
    link.symlink_to(proxy.options["port"])


@pytest.mark.long
@pytest.mark.fault_row(6)
def test_a_pulled_cable_ends_the_run_and_a_renumbered_port_is_opened_by_name(tmp_path):
    link = tmp_path / "tracker-by-id"
    with Bench(seed=3, speed=10.0, rtu=False) as bench:
        options = {**bench.tracker_options, "port": str(link)}
        with Driven(config_of(bench, tracker_options=options), spawns=True) as driven:
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                was = driven.cell.connect()
                driven.begin(order_of(bench, tmp_path / "pulled.sqlite", 6))
                driven.until(lambda: bool(driven.of(messages.MeasurementProgress)))
                time.sleep(0.5)
                taken = os.readlink(link)
                keep = os.open(taken, os.O_RDWR | os.O_NOCTTY)  # another number next
            closed = driven.until_closed()
            assert closed.outcome == "faulted"
            fault = driven.of(messages.FaultReported)[0]
            assert str(link) in fault.text + closed.failure
            run = open_run(closed.run_file)
            assert len(run.tracker.sequence) == closed.samples > 0
            driven.events.clear()
            with LinkProxy(bench.tracker_options, seed=1) as proxy:
                point_to(link, proxy)
                assert os.readlink(link) != taken
                os.close(keep)
                assert driven.cell.connect() == was
                driven.begin(order_of(bench, tmp_path / "again.sqlite", 2))
                closed = driven.until_closed()
            assert (closed.outcome, closed.lost_samples) == ("finished", 0)


HARMS = {
    "late": Harm(latency_s=0.35),
    "halved": Harm(halve=True),
    "of another request": Harm(renumber=True),
    "half a second late": Harm(latency_s=0.6),
}

# The machine's own watchdog is later than what the age of a status brings about.
PATIENT = {"watchdog_s": 2.0}


@pytest.fixture
def measuring(tmp_path):
    with (
        Bench(seed=12, speed=2.0, rtu=False) as bench,
        LinkProxy(bench.motion_options, seed=3) as proxy,
        ModbusController(**bench.motion_options, **PATIENT) as onlooker,
        run_on(bench, tmp_path, motion_options=proxy.options | PATIENT) as one,
    ):
        yield one, bench, proxy, onlooker


def until_it(measuring, onlooker, is_so, within_s):
    begun_s = time.monotonic()
    measuring.until(lambda: is_so(onlooker.status()), timeout_s=within_s)
    return time.monotonic() - begun_s


@pytest.mark.fault_row(44)
def test_no_status_holds_the_feed_by_the_age_of_the_last_one(measuring, measured):
    running, _, proxy, onlooker = measuring
    for name, harm in HARMS.items():
        proxy.harm(to_host=harm)
        held_s = until_it(running, onlooker, lambda s: s.state == "held", 2.0)
        measured(f"{name}: held after {held_s:.2f} s")
        assert onlooker.status().hold_reason == "command"
        proxy.harm()
        until_it(running, onlooker, lambda s: s.state == "running", 6.0)
        running.until(lambda: running.of(messages.StateChanged)[-1].state == "running")
    assert running.faults == {"control-late"}
    assert not running.of(messages.RunClosed)


@pytest.mark.fault_row(44)
def test_a_controller_that_is_busy_for_long_is_named_as_that(measuring):
    """Exception 6 for three seconds of the wall: its watchdog holds meanwhile."""
    running, bench, _, onlooker = measuring
    bench.inject("cnc:exception+6s*6")
    running.until(lambda: bool(running.faults), timeout_s=5.0)
    assert running.faults == {"control-busy"}
    running.until_closed(timeout_s=10.0)
    assert running.faults == {"control-busy"}
    assert onlooker.status().state == "held"


@pytest.mark.long
@pytest.mark.fault_row(41)
@pytest.mark.fault_row(42)
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("cnc:zeroed+30s", "position-implausible"),
        ("cnc:shifted+30s", "position-implausible"),
        ("tracker:frozen", "tracker-frozen"),
    ],
)
def test_what_cannot_be_is_held_over_real_links(measuring, fault, code):
    running, bench, _, onlooker = measuring
    bench.inject(fault)
    until_it(running, onlooker, lambda s: s.state == "held", 8.0)
    running.until(lambda: running.of(messages.StateChanged)[-1].state == "paused")
    assert running.faults == {code}


@pytest.fixture(scope="module")
def bench():
    """A machine at rest and its tracker, by the time of the wall."""
    with Bench(seed=21, rtu=False) as started:
        yield started


def hold_the_interpreter(for_s):
    """Let no thread of this process run Python meanwhile, as a stalled scheduler does.

    What is called by way of `PyDLL` keeps the interpreter's lock.
    """
    ctypes.PyDLL(None).poll(None, ctypes.c_ulong(0), round(1000 * for_s))


def collect_garbage():
    kept = [[None] for _ in range(3_000_000)]
    end_s = time.monotonic() + 2.0
    while time.monotonic() < end_s:
        gc.collect()
    kept.clear()


def record(bench, folder, rate_hz, stall):
    """Record some samples, a stall, and what comes in half a second more.

    Returns how it was closed, the Run, whose samples are as sent by their numbers,
    times and places, the states that were told, and the overflows of the device.
    """
    machine, file = machine_from_json(bench.machine), folder / "paused.sqlite"
    axes = tuple(axis.name for axis in machine.axes)
    path = default_path(machine, lines=1)
    header = RunHeader("paused", machine, path, rate_hz, {}, axes)
    recorder = Recorder(file, header, reserve_bytes=0)
    states = set()
    end_s = math.inf

    def is_over(wait_s):
        nonlocal end_s
        time.sleep(wait_s)
        if recorder.samples and end_s == math.inf:
            stall()
            end_s = time.monotonic() + 0.5
        return time.monotonic() > end_s

    def note(_samples, _lost, state):
        states.add(state)

    with StreamingTracker(**bench.tracker_options) as tracker:
        record_stream(tracker, recorder, rate_hz, is_over, note)
        overflows = tracker.health.device_overflows
    closed, run = recorder.close("finished"), open_run(file)
    steps = np.diff(run.tracker.sequence)
    assert (steps >= 1).all()
    step_s = np.diff(run.tracker.device_time_s) / steps
    np.testing.assert_allclose(step_s, 1.0 / rate_hz, atol=2e-6)
    places_mm = run.tracker.position_mm
    assert np.abs(places_mm - np.median(places_mm, axis=0)).max() < 0.1
    return closed, run, states, overflows


@pytest.mark.long
@pytest.mark.fault_row(31)
@pytest.mark.parametrize(
    "stall", [partial(hold_the_interpreter, 2.0), collect_garbage], ids=["stall", "gc"]
)
def test_a_pause_of_the_recording_process_costs_no_sample(bench, tmp_path, stall):
    closed, run, states, overflows = record(bench, tmp_path, 500.0, stall)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (closed.lost_samples, overflows) == (0, 0)
    assert states == {StreamState.GOOD}
    assert closed.samples == len(run.tracker) > 500


@pytest.mark.fault_row(31)
def test_samples_that_no_buffer_holds_are_counted_and_told(bench, tmp_path, measured):
    stall = partial(hold_the_interpreter, 1.0)
    closed, run, _, overflows = record(bench, tmp_path, 5000.0, stall)
    missing = np.diff(run.tracker.sequence) - 1
    assert closed.lost_samples == missing.sum() > 1000
    assert overflows >= 1
    measured(f"5 kHz, 1 s pause: {closed.lost_samples} lost, all counted and named")
    told = " ".join(event.text for event in run.events if event.kind == "gap")
    assert all(f"{gap} " in told for gap in missing[missing > 0])
