"""Record a tracker beside a CNC without any link, and leave a measurement bundle."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from app.cli.terminal import (
    list_files,
    print_files,
    print_json,
    say,
    show_progress,
)
from app.errors import BadInput
from app.files.bundle import write_bundle
from app.files.commanded_file import read_set_up
from app.measurement.messages import RunClosed
from app.measurement.recorder import Recorder
from app.measurement.run_file import RunHeader
from app.measurement.run_reading import open_run
from app.measurement.stream_reader import StreamState, record_stream
from app.plugins import load
from app.settings import load_settings
from drivers.interfaces.tracker import Tracker

RUN_FILE = "run.sqlite"
_NOTES = {
    StreamState.GOOD: "",
    StreamState.SILENT: "no samples",
    StreamState.DEAD: "no samples",
    StreamState.BEAM_LOST: "beam lost",
}


def record_bundle(
    commanded: Path,
    output: Path,
    *,
    machine: Path | None,
    config: Path | None,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Record until Ctrl-C, or for so many seconds; write the bundle.

    Raises BadInput, DeviceError; what was recorded by then is in the Run file.
    """
    settings = load_settings(config)
    machine_file = machine or settings.machine_file
    if machine_file is None:
        raise BadInput("no machine is named; give --machine MACHINE.json")
    described, planned = read_set_up(machine_file, commanded)
    header = RunHeader(
        output.name, described, planned, described.tracker.rate_hz, {}, ()
    )
    if (output / RUN_FILE).exists():
        raise BadInput(f"{output / RUN_FILE}: is there already; name another folder")
    tracker = load("truepath.trackers", settings.tracker_driver)(
        **settings.tracker_options
    )
    output.mkdir(parents=True, exist_ok=True)
    closed = _record_run(tracker, header, output / RUN_FILE, seconds)
    write_bundle(open_run(closed.run_file), output)
    _print_summary(closed, output, as_json=as_json)


def _record_run(
    tracker: Tracker, header: RunHeader, file: Path, seconds: float | None
) -> RunClosed:
    """Record, and close the Run whatever happens."""
    with (
        tracker,
        _watch_for_end(seconds) as end,
        show_progress("record") as on_progress,
    ):
        who = {"tracker": tracker.connect()}
        recorder = Recorder(file, replace(header, devices=who))
        outcome = "failed"
        start_s = time.monotonic()

        has_samples = False

        def on_samples(samples: int, lost: int, verdict: StreamState) -> None:
            nonlocal has_samples
            if samples and not has_samples:
                has_samples = True
                say("recording; press Ctrl-C 2 s after the last motion")
            elapsed_s = time.monotonic() - start_s
            note = f"{samples} samples, {lost} lost {_NOTES[verdict]}".strip()
            on_progress(min(elapsed_s / (seconds or 1e9), 1.0), "recording", note)

        try:
            record_stream(tracker, recorder, header.rate_hz, end.wait, on_samples)
            outcome = "finished"
        finally:
            closed = recorder.close(outcome)
    return closed


@contextmanager
def _watch_for_end(seconds: float | None) -> Iterator[threading.Event]:
    """Give what tells the end: Ctrl-C, the end of the process, or the time."""
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
        timer.join()
        for number, handler in before.items():
            signal.signal(number, handler)


def _print_summary(closed: RunClosed, output: Path, *, as_json: bool) -> None:
    files = list_files(output)
    if as_json:
        counts = {"samples": closed.samples, "lost_samples": closed.lost_samples}
        names = [str(file) for file in files]
        print_json({"schema": "recording-summary/1", **counts, "files": names})
        return
    print(f"{closed.samples} samples, {closed.lost_samples} lost")
    print_files(files)
