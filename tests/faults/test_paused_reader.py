"""The process that records a stream stands still, with all its threads."""

from __future__ import annotations

import ctypes
import gc
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.measurement.messages import RunClosed
from truepath.measurement.monitors.stream_reader import StreamState, record_stream
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.run_file.run_reading import open_run
from truepath.planning.lines.default_path import default_path
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_simulators.bench.bench import Bench


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    """A machine at rest and its tracker, by the time of the wall."""
    with Bench(seed=21, rtu=False) as started:
        yield started


def hold_the_interpreter(for_s: float) -> None:
    """Let no thread of this process run Python meanwhile, as a stalled scheduler does.

    What is called by way of `PyDLL` keeps the interpreter's lock.
    """
    ctypes.PyDLL(None).poll(None, ctypes.c_ulong(0), round(1000 * for_s))


def collect_garbage() -> None:
    """Look for garbage in a huge heap, where there is none, again and again."""
    kept = [[None] for _ in range(3_000_000)]
    end_s = time.monotonic() + 2.0
    while time.monotonic() < end_s:
        gc.collect()
    kept.clear()


class Recording:
    """A stream into a Run: some samples, a stall, and what comes in half a second more.

    states : of the stream, as they were told meanwhile
    overflows : of the buffer of the device, as the driver has counted them
    """

    def __init__(self, bench: Bench, folder: Path, rate_hz: float) -> None:
        self.machine = machine_from_json(bench.machine)
        self.file, self.rate_hz = folder / "paused.sqlite", rate_hz
        self.states: list[StreamState] = []
        self.overflows = 0
        self._options = bench.tracker_options

    def record(self, stall: Callable[[], None]) -> RunClosed:
        axes = tuple(axis.name for axis in self.machine.axes)
        path = default_path(self.machine, lines=1)
        header = RunHeader("paused", self.machine, path, self.rate_hz, {}, axes)
        recorder = Recorder(self.file, header, reserve_bytes=0)
        end_s = math.inf

        def is_over(wait_s: float) -> bool:
            nonlocal end_s
            time.sleep(wait_s)
            if recorder.samples and end_s == math.inf:
                stall()
                end_s = time.monotonic() + 0.5
            return time.monotonic() > end_s

        with StreamingTracker(**self._options) as tracker:
            record_stream(tracker, recorder, self.rate_hz, is_over, self._note)
            self.overflows = tracker.health.device_overflows
        return recorder.close("finished")

    def read(self) -> Run:
        """Return the Run; its samples are as sent, by their numbers, times, places."""
        run = open_run(self.file)
        steps = np.diff(run.tracker.sequence)
        assert (steps >= 1).all()
        step_s = np.diff(run.tracker.device_time_s) / steps
        np.testing.assert_allclose(step_s, 1.0 / self.rate_hz, atol=2e-6)
        places_mm = run.tracker.position_mm
        assert np.abs(places_mm - np.median(places_mm, axis=0)).max() < 0.1
        return run

    def _note(self, _samples: int, _lost: int, state: StreamState) -> None:
        self.states.append(state)


@pytest.mark.long
@pytest.mark.fault_row(31)
@pytest.mark.parametrize(
    "stall", [lambda: hold_the_interpreter(2.0), collect_garbage], ids=["stall", "gc"]
)
def test_a_pause_of_the_recording_process_costs_no_sample(bench, tmp_path, stall):
    recording = Recording(bench, tmp_path, rate_hz=500.0)
    closed = recording.record(stall)
    tracker = recording.read().tracker
    assert (np.diff(tracker.sequence) == 1).all()
    assert (closed.lost_samples, recording.overflows) == (0, 0)
    assert set(recording.states) == {StreamState.GOOD}
    assert closed.samples == len(tracker) > 500


@pytest.mark.fault_row(31)
def test_samples_of_a_pause_beyond_the_buffers_are_counted_and_told(
    bench, tmp_path, measured
):
    recording = Recording(bench, tmp_path, rate_hz=5000.0)
    closed = recording.record(lambda: hold_the_interpreter(1.0))
    run = recording.read()
    missing = np.diff(run.tracker.sequence) - 1
    assert closed.lost_samples == missing.sum() > 1000
    assert recording.overflows >= 1
    measured(f"5 kHz, 1 s pause: {closed.lost_samples} lost, all counted and named")
    told = " ".join(event.text for event in run.events if event.kind == "gap")
    assert all(f"{gap} " in told for gap in missing[missing > 0])
