"""The process that records a stream stands still, with all its threads."""

import ctypes
import gc
import math
import time

import numpy as np
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.monitors.stream_reader import StreamState, record_stream
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.run_file.run_loader import open_run
from truepath.planning.lines.default_path import default_path
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench


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
    "stall", [lambda: hold_the_interpreter(2.0), collect_garbage], ids=["stall", "gc"]
)
def test_a_pause_of_the_recording_process_costs_no_sample(bench, tmp_path, stall):
    closed, run, states, overflows = record(bench, tmp_path, 500.0, stall)
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert (closed.lost_samples, overflows) == (0, 0)
    assert states == {StreamState.GOOD}
    assert closed.samples == len(run.tracker) > 500


@pytest.mark.fault_row(31)
def test_samples_that_no_buffer_holds_are_counted_and_told(bench, tmp_path, measured):
    closed, run, _, overflows = record(
        bench, tmp_path, 5000.0, lambda: hold_the_interpreter(1.0)
    )
    missing = np.diff(run.tracker.sequence) - 1
    assert closed.lost_samples == missing.sum() > 1000
    assert overflows >= 1
    measured(f"5 kHz, 1 s pause: {closed.lost_samples} lost, all counted and named")
    told = " ".join(event.text for event in run.events if event.kind == "gap")
    assert all(f"{gap} " in told for gap in missing[missing > 0])
