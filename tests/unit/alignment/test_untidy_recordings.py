"""What metrologists record in haste: too early, too late, too long."""

from dataclasses import replace

import numpy as np

from truepath.alignment.align import align
from truepath_drivers.interfaces.records import TrackerSamples

STEP_S = 0.002


def stream(run, before=None, after=None, keep=slice(None)):
    """The run's stream with positions recorded before and after it."""
    kept = run.tracker.position_mm[keep]
    clock = run.tracker.device_time_s[keep]
    before = np.empty((0, 3)) if before is None else before
    after = np.empty((0, 3)) if after is None else after
    early = clock[0] - STEP_S * np.arange(len(before), 0, -1)
    late = clock[-1] + STEP_S * np.arange(1, len(after) + 1)
    n = len(before) + len(kept) + len(after)
    status = np.zeros(n, np.int64)
    status[len(before) : len(before) + len(kept)] = run.tracker.status[keep]
    time_s = np.concatenate([early, clock, late])
    position = np.concatenate([before, kept, after])
    return replace(run, tracker=TrackerSamples(np.arange(n), time_s, position, status))


def carried_by_hand(rng, to_mm, count=4000):
    """A reflector carried from its nest, where it lay for ten seconds."""
    way = np.cumsum(np.cumsum(rng.normal(size=(count, 3)), axis=0), axis=0)
    way *= 400.0 / np.abs(way).max()
    way += to_mm - way[-1]
    nest = way[:1] + rng.normal(0.0, 0.003, (5000, 3))
    return np.concatenate([nest, way])


def driven(rng, start_mm, end_mm, count=3000):
    """The machine drives a line that is not of the path, and stands at its end."""
    share = np.concatenate([np.linspace(0.0, 1.0, count), np.ones(1500)])
    way = start_mm + share[:, None] * (end_mm - start_mm)
    return way + rng.normal(0.0, 0.003, way.shape)


def rows(run):
    return [p.row for p in align(run).passes]


def test_what_comes_before_and_after_is_no_part_of_the_path(record, rng):
    """A reflector carried to the spindle and back; the way to the start and home."""
    run, _ = record(6)
    usual, position = rows(run), run.tracker.position_mm
    before = carried_by_hand(rng, position[0])
    after = carried_by_hand(rng, position[-1])[::-1]
    assert rows(stream(run, before, after)) == usual
    home = position.mean(axis=0)
    before = driven(rng, home, position[0])
    after = driven(rng, position[-1], home)
    assert rows(stream(run, before, after)) == usual
    still = run.tracker.position_mm[:1] + rng.normal(0.0, 0.003, (100_000, 3))
    assert rows(stream(run, before=still)) == usual


def test_a_recording_that_ends_early_keeps_what_it_has(record):
    run, _ = record(6)
    usual = rows(run)
    for share in (0.55, 0.8):
        found = rows(stream(run, keep=slice(int(share * len(run.tracker)))))
        assert found == usual[: len(found)]
        assert len(found) >= int(share * len(usual)) - 2


def test_two_rows_that_were_swapped_cost_only_their_own_lines(record):
    run, _ = record(6)
    order = np.arange(len(run.commanded))
    order[[10, 11]] = order[[11, 10]]
    wrong = replace(run.commanded, position=run.commanded.position[order])
    seen = align(replace(run, commanded=wrong))
    assert {p.row for p in seen.passes} >= set(rows(run)) - {10, 11, 12}
    left = seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    assert np.abs(left).max() < 0.2
