"""Recordings of machines and programs that the shared ones do not have."""

from __future__ import annotations

from itertools import cycle

from tests.conftest import Truth, _run

from truepath.alignment.streaming import StreamingAlignment
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting


def record_run(content, program, seed=3, mode="otf", setting=None):
    """Return the Run of a recording, and the recording, which knows the truth."""
    made = synthetic.record(content, program, seed, mode, setting)
    return _run(made), made


def stream(run, sizes=(50,)):
    """Align a Run as it comes in blocks of these sizes, over and over.

    Return the alignment and all stretches.
    """
    live, parts, begin = StreamingAlignment(run.machine, run.commanded), [], 0
    for size in cycle(sizes):
        parts += live.add(run.tracker.select(slice(begin, begin + size)))
        begin += size
        if begin >= len(run.tracker):
            return live, parts + live.finish()


def load_small(name, share=0.4):
    """Return a machine of shorter travel, seen at 100 Hz: it is solved in little time.

    Its tables have fewer knots. share : of the travel of the machine as it is
    """
    content = load_machine(name)
    for axis in content["axes"].values():
        for end in {"min_mm", "max_mm"} & axis.keys():
            axis[end] *= share
    content["tracker"]["rate_hz"] = 100.0
    return content


_made = {}


def record_small(seed, mode="otf", *, rows=24, corners=False, **setting):
    """Return the Run of a small machine, and its truth.

    setting : what else a Setting takes
    """
    key = (seed, mode, rows, corners, repr(setting))
    if key not in _made:
        content = load_small("demo")
        machine = parse_machine(content)
        if corners:
            program = paths.corner_path(machine, 5000.0)
        elif mode == "otf":
            program = paths.chord_path(machine, seed, rows, 5000.0)
        else:
            program = paths.standstill_points(machine, seed, rows, dwell_s=0.8)
        run, made = record_run(content, program, seed, mode, Setting(**setting))
        _made[key] = run, Truth(made)
    return _made[key]
