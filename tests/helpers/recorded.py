"""Recordings of machines and programs that the shared ones do not have."""

from __future__ import annotations

from dataclasses import asdict, replace
from itertools import cycle

import numpy as np
from tests import conftest
from tests.conftest import Truth, _run

from truepath.alignment.streaming import StreamingAlignment
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.program import Arc, Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.synthetic import Setting

_made = {}


def record_run(content, program, seed=3, mode="otf", setting=None):
    made = synthetic.record(content, program, seed, mode, setting)
    return _run(made), made


def nominal_error_mm(seen):
    """How far cells lie from their nominal place, in the workpiece frame."""
    return seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm


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


def record_small(seed, mode="otf", *, rows=24, corners=False, **setting):
    """Return the Run of a small machine, and its truth.

    setting : what else a Setting takes
    """
    key = (seed, mode, rows, corners, repr(setting))
    if key not in _made:
        content = load_small("demo")
        program = conftest.choose_program(content, seed, mode, rows, 5000.0, corners)
        run, made = record_run(content, program, seed, mode, Setting(**setting))
        _made[key] = run, Truth(made)
    return _made[key]


def record_path(content, path, seed=3, mode="otf", setting=None):
    arcs = list(path.arc)
    for k, arc in enumerate(arcs):
        if arc:
            about = tuple(map("XYZ".index, arc.axes)), arc.centre_mm
            arcs[k] = Arc(*about, float(np.radians(arc.turn_deg)))
    feed_mm_s = path.feed_mm_min / 60.0
    program = Program(path.position, feed_mm_s, path.dwell_s, path.target, tuple(arcs))
    run, made = record_run(content, program, seed, mode, setting)
    return replace(run, commanded=path), made


def with_samples(run, **columns):
    return replace(run, tracker=replace(run.tracker, **columns))


def load_erring(specification=None):
    """Return a small machine whose tracker errs as is typical, or as told, and says so.

    specification : what a tracker may be off by, as a machine file has it
    """
    content = load_small("demo", 0.5)
    stated = asdict(TrackerSpecification()) if specification is None else specification
    content["tracker"]["specification"] = stated
    return content


def choose_program(content, seed, mode="otf", *, rows=24, points=50):
    count = rows if mode == "otf" else points
    return conftest.choose_program(content, seed, mode, count, 6000.0, dwell_s=0.5)
