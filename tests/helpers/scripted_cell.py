"""Doubles that a test steps through: a cell without devices, science without sums."""

import json
import queue
import threading
from dataclasses import dataclass, field
from functools import partialmethod
from pathlib import Path as FilePath

import numpy as np

from truepath.catalogue.errors import Aborted
from truepath.catalogue.run_reader import RunReader
from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.earlier.verdict import Verdict, verdict_json
from truepath.measurement import messages
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.progress import ignore_progress
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Identity, TrackerSamples
from truepath_simulators.machine_file import load_machine

DEADLINE_S = 150.0  # a plan takes a minute of a busy core
DEVICES = {
    "tracker": Identity("Maker", "Tracker", "T-1", "1.0"),
    "motion": Identity(
        "Maker", "Controller", "C-1", "2.0", has_watchdog=True, drives_arcs=True
    ),
}


def wait_until(reached, what=""):
    """Return what `reached` gives once it is true; fail after a deadline."""
    end_s, pause_s = host_clock.now_s() + DEADLINE_S, 0.005
    while not (found := reached()):
        assert host_clock.now_s() < end_s, f"waited in vain for {what or reached}"
        host_clock.sleep_s(pause_s)
        pause_s = min(1.1 * pause_s, 0.025)  # to ask costs a busy computer its time
    return found


class ScriptedCell:
    """Answers verbs as a cell does, measures nothing, ends when the test says so.

    deaf : verbs that are heard and not obeyed
    refuses : what `connect` raises
    """

    def __init__(self, deaf=(), refuses=None):
        self.deaf, self.refuses = set(deaf), refuses
        self.heard, self.parts = [], []
        self.started, self.begun = threading.Event(), threading.Event()
        self.committed = self._samples = 0
        self.closed, self._alive = False, True
        self.order = self._recorder = None
        self._events = queue.SimpleQueue()

    # What the supervisor calls.

    @property
    def alive(self):
        return self._alive and not self.closed

    def start(self):
        self.started.set()

    def connect(self):
        self.heard.append("connect")
        if self.refuses is not None:
            raise self.refuses
        self.say_state("connecting")
        self.say_state("ready")
        return DEVICES

    def try_tracker(self, trial):
        if not trial.streams_only:
            self.heard.append("try")
        return messages.TrackerTried(42, 42, 0, 1234.0)

    def begin(self, order):
        self.heard.append("begin")
        self.order = order
        if "begin" in self.deaf:
            return
        given = order.run_name, order.machine, order.commanded, order.rate_hz
        axes = order.machine.axis_names
        header = RunHeader(*given, DEVICES, axes, job_id=order.job_id)
        how = {"on_recorded": self._note_committed, "reserve_bytes": 0}
        self._recorder = Recorder(FilePath(order.run_file), header, **how)
        self._samples = 0
        self.say_state("running")
        self.record(50)
        self.begun.set()

    def send(self, verb):
        if verb == "beat":
            return
        self.heard.append(str(verb))
        if verb in self.deaf:
            return
        if verb == "conclude":
            self.end("finished")
        elif verb == "abort":
            if self._recorder is not None:
                self.end("aborted")
        else:
            states = {"pause": ("pausing", "paused"), "resume": ("resuming", "running")}
            for state in states[verb]:
                self.say_state(state)

    def extend(self, part):
        self.heard.append("extend")
        self.parts.append(part)

    def poll(self, timeout_s):
        found = []
        try:
            found.append(host_clock.get(self._events, timeout_s))
            while True:
                found.append(self._events.get_nowait())
        except queue.Empty:
            return found

    def kill(self):
        self.heard.append("kill")

    def close(self):
        if self._recorder is not None:
            self._recorder.close("aborted")
            self._recorder = None
        self.closed = True

    # What the test does.

    def say(self, event):
        self._events.put(event)

    def say_state(self, state):
        self.say(messages.StateChanged(messages.CellState(state)))

    def fault(self, code="beam-lost", text="the beam is lost", action="lock it"):
        self.say(messages.FaultReported(code, text, action))

    def record(self, n, line_s=0.0):
        sequence = np.arange(self._samples, self._samples + n)
        columns = sequence / 500.0, np.zeros((n, 3)), np.zeros(n, np.int64)
        self._recorder.put_tracker(TrackerSamples(sequence, *columns))
        self._samples += n
        known = {"done": self._samples // 50, "total": 10, "unit": "lines"}
        known |= {"stage": "measuring", "position": (1.0, 2.0, 3.0), "line_s": line_s}
        times = {"elapsed_s": self._samples / 500.0, "remaining_s": 1.5}
        self.say(messages.MeasurementProgress(samples=self._samples, **known, **times))
        self.say(messages.LivePoints([[1.0, 2.0, 3.0]], [1.0, 2.0, 3.0], 0.1))

    def end(self, state="finished", spoil=None):
        """Close the Run, let `spoil` have its file, say how it ended."""
        recorder, self._recorder = self._recorder, None
        closed = recorder.close(state)
        if spoil is not None:
            recorder.file.chmod(0o644)
            recorder.file.write_bytes(spoil)
        self.say_state(state)
        self.say(closed)

    def die(self):
        """End as a killed process does: without a word, the Run torn."""
        if self._recorder is not None:
            self.tear()
        self._alive = False

    def tear(self):
        recorder, self._recorder = self._recorder, None
        wait_until(lambda: self.committed == self._samples, "the writer")
        log = recorder.file.with_name(recorder.file.name + "-wal")
        torn = {file: file.read_bytes() for file in (recorder.file, log)}
        recorder.close("never written")
        for file, content in torn.items():
            file.unlink(missing_ok=True)
            file.write_bytes(content)

    def _note_committed(self, samples):
        self.committed += len(samples)


@dataclass
class CellMaker:
    options: dict = field(default_factory=dict)
    cells: list[ScriptedCell] = field(default_factory=list)
    fails: int = 0

    def __call__(self):
        if self.fails:
            self.fails -= 1
            raise OSError("no more processes")
        self.cells.append(ScriptedCell(**self.options))
        return self.cells[-1]

    @property
    def cell(self):
        return wait_until(lambda: self.cells and self.cells[-1], "a cell")


class ScriptedLive:
    def __init__(self, order, show):
        self.order, self.show = order, show
        self.newest, self.is_over = None, False
        self.heard, self.parts = [], []

    def _hear(self, verb, *_):
        self.heard.append(verb)

    start = partialmethod(_hear, "start")
    offer = partialmethod(_hear, "offer")
    request_part = partialmethod(_hear, "request_part")
    extend = partialmethod(_hear, "extend")
    finish = partialmethod(_hear, "finish")
    close = partialmethod(_hear, "close")

    def pop_part(self):
        return self.parts.pop(0) if self.parts else None

    def publish(self, volumetric_uncertainty_um, done, total=10, verdict=None):
        self.newest = {
            "verdict": verdict_json(verdict or Verdict()),
            "volumetric_uncertainty_um": volumetric_uncertainty_um,
            "done": done,
            "total": total,
            "elapsed_s": 5.0 * done,
            "device_time_s": 100.0 + 5.0 * done,
            "cells": 30 * done,
            **{"is_last": False, "age_s": 0.0, "dropped_blocks": 0},
            **{"error_tables": {}, "squareness_urad": {}},
        }
        self.show(self.newest)


class ScriptedLives(list):
    """Live estimates that have been started."""

    def __call__(self, order, show):
        self.append(ScriptedLive(order, show))
        return self[-1]


class Inline:
    count = 1

    def submit(self, task, *arguments, on_progress, started):
        return _InlineComputation(task, arguments, on_progress, started)

    def close(self):
        pass


class _InlineComputation:
    def __init__(self, task, arguments, on_progress, started):
        self._task, self._arguments = task, arguments
        self._on_progress, self._started = on_progress, started
        self._cancelled = threading.Event()

    def result(self):
        self._started()

        def on_progress(fraction, stage):
            if self._cancelled.is_set():
                raise Aborted("cancelled")
            self._on_progress(fraction, stage)

        return self._task(*self._arguments, on_progress=on_progress)

    def cancel(self):
        self._cancelled.set()


class ReaderHere(RunReader):
    def _call(self, task, file):
        return task(on_progress=ignore_progress)


class _Scripted:
    """A task that does what the test says.

    hold : set it to let the task wait at its first report until it is released
    raises : what the task ends with instead
    verdict : of what it finds
    calls : what it was called with
    """

    def __init__(self):
        self.verdict, self.calls = Verdict(), []
        self.hold = self.raises = None

    def begin(self, on_progress, stage):
        on_progress(0.0, stage)
        while self.hold is not None and not host_clock.wait(self.hold, 0.01):
            on_progress(0.1, stage)
        if self.raises is not None:
            raise self.raises

    def write(self, folder, title, **documents):
        place = FilePath(folder)
        place.mkdir(parents=True)
        for name, content in documents.items():
            (place / f"{name}.json").write_text(json.dumps(content))
        (place / "report.html").write_text(f"<!DOCTYPE html><title>{title}</title>")
        return self.verdict.state


class Science(_Scripted):
    def __init__(self):
        super().__init__()
        self.trials, self.models = [], []

    def __call__(self, run_files, folder, *order, on_progress):
        perpendicular_only, monte_carlo, workers, model_file, model_id = order
        self.calls.append((run_files, folder, perpendicular_only))
        self.trials.append((monte_carlo, workers))
        self.models.append((model_file, model_id))
        self.begin(on_progress, "aligning")
        on_progress(0.5, "estimating")
        result = {"schema": "result/1", "machine": {"name": "demo"}}
        result["verdict"] = verdict_json(self.verdict)
        result["error_tables"] = {"EXX": {"position_mm": [0.0], "value_um": [1.0]}}
        result["squareness_urad"] = {"C0Y": {"value": 1.0, "uncertainty": 0.1}}
        state = self.write(folder, "Report", result=result)
        table = "error,position_mm\nEXX,0.0\n"
        (FilePath(folder) / "error_tables.csv").write_text(table)
        on_progress(1.0, "reporting")
        return state


class Explorer(_Scripted):
    """A task that writes the files of a discovery.

    machine : content of the machine file of the Runs
    rows : of the lines that it asks for; nothing is asked without them
    """

    def __init__(self):
        super().__init__()
        self.machine = load_machine("demo")
        self.rows = []

    def __call__(self, run_files, folder, model_file, model_id, *, on_progress):
        self.calls.append((run_files, model_file, model_id))
        self.begin(on_progress, "discovering")
        parent = {"version": 1, "source": model_id or "fitted", "sha256": None}
        if model_file is not None and model_file.endswith("model.json"):
            parent["version"] = json.loads(FilePath(model_file).read_text())["version"]
        text = "backlash X: width 6.1 ± 0.4 µm"
        change = {"kind": "added", "what": "backlash X", "text": text}
        grown = {"version": parent["version"] + 1, "parent": parent}
        grown["difference"] = [change]
        found = {
            "schema": "discovery/1",
            "effects": [{"name": "backlash", "axis": "X"}],
            "gap": {"unit": "um", "before": 2.0, "after": 1.0, "noise_floor": 1.0},
            "model": grown,
            "verdict": verdict_json(self.verdict),
            "ask": {"rows": self.rows} if self.rows else None,
        }
        model = {**grown, "machine": self.machine}
        state = self.write(folder, "Discovery", discovery=found, model=model)
        on_progress(1.0, "reporting")
        return state


TREND = {
    "schema": "trend/1",
    "machine": {"name": "demo"},
    "verdict": verdict_json(Verdict()),
    "states": {},
    "outlook": {"state": "not-known", "sentence": "Too few Runs."},
    **dict.fromkeys(("runs", "later", "sensors", "not_told"), ()),
}


class Verifier(_Scripted):
    def __init__(self):
        super().__init__()
        self.content = {"schema": "verification/1"}

    def __call__(self, run_files, first_row, folder, *order, on_progress):
        self.calls.append((run_files, first_row, *order))
        self.begin(on_progress, "estimating")
        return self.write(folder, "Proof", verification=self.content)


class Follower(_Scripted):
    def __call__(self, run_files, names, folder, asked, *, on_progress):
        self.calls.append((run_files, names, asked))
        self.begin(on_progress, "following")
        return self.write(folder, "Trend", trend=TREND)


PLACES = [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]


class Resumer:
    def __init__(self):
        self.calls, self.next_row, self.error = [], 4, None

    def __call__(self, files, machine, *, on_progress):
        self.calls.append(files)
        if self.error is not None:
            raise self.error
        if self.next_row is None:
            return [None for _ in files]
        reached = {"next_row": self.next_row, "row": [2, 3], "place_mm": PLACES}
        told = [
            encode_commanded_json(open_recorded(FilePath(f)).commanded) for f in files
        ]
        return [reached | {"commanded": rows} for rows in told]


class Closer:
    def __init__(self):
        self.calls, self.problem = [], ""

    def __call__(self, file, place_mm, *, on_progress):
        self.calls.append(place_mm)
        return {"step_um": 1.0, "allowed_um": 20.0, "problem": self.problem}
