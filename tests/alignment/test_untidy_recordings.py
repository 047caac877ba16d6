"""What metrologists record in haste: too early, too late, too long, in other units."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.errors import AlignmentError
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


def test_a_reflector_carried_to_the_spindle_and_back_is_no_part_of_the_path(
    record, rng
):
    run, _ = record(6)
    position = run.tracker.position_mm
    before = carried_by_hand(rng, position[0])
    after = carried_by_hand(rng, position[-1])[::-1]
    assert rows(stream(run, before, after)) == rows(run)


def test_a_machine_that_drives_to_the_start_and_home_again_is_no_part_of_the_path(
    record, rng
):
    run, _ = record(6)
    position = run.tracker.position_mm
    home = position.mean(axis=0)
    before = driven(rng, home, position[0])
    after = driven(rng, position[-1], home)
    assert rows(stream(run, before, after)) == rows(run)


def test_minutes_of_waiting_cost_nothing(record, rng):
    run, _ = record(6)
    still = run.tracker.position_mm[:1] + rng.normal(0.0, 0.003, (100_000, 3))
    assert rows(stream(run, before=still)) == rows(run)


@pytest.mark.parametrize("share", [0.55, 0.8])
def test_a_recording_that_ends_early_keeps_what_it_has(record, share):
    run, _ = record(6)
    cut = stream(run, keep=slice(int(share * len(run.tracker))))
    found = rows(cut)
    assert found == rows(run)[: len(found)]
    assert len(found) >= int(share * len(rows(run))) - 2


@pytest.mark.parametrize(
    ("unit", "scale"), [("m", 1e-3), ("inch", 1 / 25.4), ("µm", 1e3)]
)
def test_a_stream_in_other_units_is_refused_by_name(record, unit, scale):
    run, _ = record(6)
    scaled = replace(run.tracker, position_mm=run.tracker.position_mm * scale)
    with pytest.raises(AlignmentError, match=f"look like {unit}; convert"):
        align(replace(run, tracker=scaled))


def test_a_clock_in_milliseconds_is_refused_by_name(record):
    run, _ = record(6)
    slow = replace(run.tracker, device_time_s=run.tracker.device_time_s * 1e3)
    with pytest.raises(AlignmentError, match=r"steps by 2 at rate_hz 500.*ms"):
        align(replace(run, tracker=slow))


def test_lines_in_another_order_are_refused(record, rng):
    run, _ = record(6)
    order = rng.permutation(len(run.commanded))
    wrong = replace(run.commanded, position=run.commanded.position[order])
    with pytest.raises(AlignmentError, match="has its order"):
        align(replace(run, commanded=wrong))


def test_two_rows_that_were_swapped_cost_only_their_own_lines(record):
    run, _ = record(6)
    order = np.arange(len(run.commanded))
    order[[10, 11]] = order[[11, 10]]
    wrong = replace(run.commanded, position=run.commanded.position[order])
    found = set(rows(replace(run, commanded=wrong)))
    assert found >= set(rows(run)) - {10, 11, 12}
    seen = align(replace(run, commanded=wrong))
    left = seen.pose.invert().apply(seen.tracker_mm) - seen.at.point_mm
    assert np.abs(left).max() < 0.2
