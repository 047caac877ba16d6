"""Recording of a tracker with a CNC without link."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from truepath.cli.terminal import say, show_progress
from truepath.driver_border import list_origins
from truepath.files.environment import choose_refraction
from truepath.measurement.faults import Fault
from truepath.measurement.messages import RunClosed
from truepath.measurement.monitors.environment_reader import (
    EnvironmentReader,
    list_groups,
    name_channels,
)
from truepath.measurement.monitors.stream_reader import StreamState, record_stream
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath_drivers import host_clock
from truepath_drivers.interfaces.thermometers import Thermometers
from truepath_drivers.interfaces.tracker import Tracker
from truepath_drivers.interfaces.tracker_records import Light

_NOTES = {
    StreamState.GOOD: "",
    StreamState.SILENT: "no samples",
    StreamState.DEAD: "no samples",
    StreamState.DAMAGED: "samples bad or lost",
    StreamState.BEAM_LOST: "beam lost",
}


def record_run(
    tracker: Tracker,
    header: RunHeader,
    file: Path,
    seconds: float | None,
    *,
    thermometers: Thermometers | None = None,
    light: Light | None = None,
) -> RunClosed:
    """Record until Ctrl-C, or for so many seconds; close the Run in any case.

    Raises DeviceError; data recorded by then are in the Run file.
    """
    with (
        tracker,
        _watch_for_end(seconds) as end,
        show_progress("record") as on_progress,
    ):
        who = {"tracker": tracker.connect()}
        groups = list_groups(tracker, thermometers)
        header = replace(
            header,
            devices=who,
            plugins=list_origins(tracker=tracker, thermometers=thermometers),
            channels=name_channels(groups),
            refraction=choose_refraction(tracker.capabilities, light),
        )
        recorder = Recorder(file, header)

        def on_notice(notice: Fault) -> None:
            recorder.event(notice.code, notice.text)
            say(notice.text)

        environment = EnvironmentReader(groups, recorder, on_notice)
        environment.start()
        outcome = "failed"
        start_s = host_clock.now_s()
        has_samples = False

        def on_samples(samples: int, lost: int, verdict: StreamState) -> None:
            nonlocal has_samples
            if samples and not has_samples:
                has_samples = True
                say("recording; press Ctrl-C 2 s after the last motion")
            elapsed_s = host_clock.now_s() - start_s
            note = f"{samples} samples, {lost} lost {_NOTES[verdict]}".strip()
            on_progress(min(elapsed_s / (seconds or 1e9), 1.0), "recording", note)

        def wait_for_end(duration_s: float) -> bool:
            return host_clock.wait(end, duration_s)

        try:
            record_stream(tracker, recorder, header.rate_hz, wait_for_end, on_samples)
            outcome = "finished"
        finally:
            environment.stop()
            if thermometers is not None:
                thermometers.close()
            closed = recorder.close(outcome)
    return closed


@contextmanager
def _watch_for_end(seconds: float | None) -> Iterator[threading.Event]:
    end = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {n: signal.signal(n, lambda *_: end.set()) for n in numbers}
    timer = threading.Timer(seconds or threading.TIMEOUT_MAX, end.set)
    timer.daemon = True
    timer.start()
    try:
        yield end
    finally:
        timer.cancel()
        host_clock.join(timer)
        for number, handler in before.items():
            signal.signal(number, handler)
