"""What is in no cell as the stream was disturbed there; what is no disturbance."""

from dataclasses import replace

import numpy as np
import pytest

from recorded import record_run
from truepath.alignment.align import align
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds.synthetic import Setting


def drive(rows, feed_mm_min, **setting):
    """Record a path of the demo machine."""
    places = np.array(rows, float)
    n = len(places)
    program = Program(places, np.full(n, feed_mm_min / 60.0), np.full(n, 0.4))
    return record_run(load_machine("demo"), program, setting=Setting(**setting))[0]


def zigzag(begin_mm, size_mm, lines):
    """Corners of a small box, one after another."""
    corners = np.random.default_rng(4).uniform(0.0, size_mm, (lines + 1, 3))
    corners[np.arange(lines + 1), np.arange(lines + 1) % 3] = 0.0
    corners[1::2] = size_mm - corners[1::2]
    return begin_mm + np.round(corners, 3)


def test_stamps_in_a_heap_are_left_out_and_named(record):
    run, _ = record(4, rows=12)
    time_s = run.tracker.device_time_s.copy()
    first = len(time_s) // 2
    heap = slice(first, first + 200)
    time_s[heap] = time_s[heap.stop] - 1e-5 * np.arange(200, 0, -1)
    seen = align(replace(run, tracker=replace(run.tracker, device_time_s=time_s)))
    (found,) = (each for each in seen.left_out if each.cause == "stalled")
    assert found.samples == pytest.approx(200, abs=2)
    assert found.end_s == pytest.approx(time_s[heap.stop], abs=0.01)


def test_a_line_too_short_for_its_feed_lacks_nothing():
    rows = [(50, 50, 50), (250, 60, 50), (252, 62, 50), (250, 250, 150), (50, 200, 90)]
    seen = align(drive(rows, 10_000.0))
    assert 2 not in {each.row for each in seen.passes if each.is_steady}
    assert seen.left_out == ()


@pytest.mark.parametrize(("rate_hz", "size_mm"), [(5000.0, 6.0), (50.0, 25.0)])
def test_slow_lines_at_any_rate_are_clean(rate_hz, size_mm):
    rows = zigzag(100.0, size_mm, 8)
    seen = align(drive(rows, 100.0 if rate_hz > 500 else 600.0, rate_hz=rate_hz))
    assert [each.row for each in seen.passes] == list(range(1, 9))
    assert sum(each.samples for each in seen.left_out) <= 2


def test_fast_lines_at_a_low_rate_are_found(record):
    run, _ = record(5, rows=12, feed=3000.0, setting=Setting(rate_hz=50.0))
    assert len(align(run).passes) >= 11
