"""The estimate while the machine moves: it tightens, and ends where the batch does."""

import time
from dataclasses import replace

import numpy as np
import pytest
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.estimation.live.live import LiveEstimator
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.results.error_tables import build_error_tables
from truepath.results.verdict import judge_live


def blocks_of(run, size=50):
    tracker = run.tracker
    for begin in range(0, len(tracker), size):
        rows = slice(begin, begin + size)
        yield tracker.select(rows)


def followed(run):
    """Return the estimates on the way and the last, with the time each took."""
    live, on_the_way = LiveEstimator(run.machine, run.commanded), []
    for block in blocks_of(run):
        begun = time.process_time()
        if live.take(block):
            on_the_way.append((live.estimate(), time.process_time() - begun))
    live.finish()
    return on_the_way, live.estimate()


@pytest.fixture(scope="module")
def moving(record):
    run, _ = record(31, rows=32)
    return run, *followed(run)


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_the_last_live_tables_are_those_of_the_batch(record, mode):
    run, _ = record(31, mode, rows=32 if mode == "otf" else 60)
    _, last = followed(run)
    batch = estimate(align(run))
    live = build_error_tables(last)
    off = [
        (live.table(table.symbol).value - table.value)
        / np.maximum(table.uncertainty, 0.05)
        for table in build_error_tables(batch).tables
    ]
    assert np.abs(np.concatenate(off)).max() < 1.0
    assert np.sqrt(np.mean(np.concatenate(off) ** 2)) < 0.3


def test_the_volumetric_uncertainty_falls_line_by_line(moving):
    _, on_the_way, last = moving
    sigma = [now.volumetric_sigma_mm for now, _ in on_the_way]
    assert sigma[0] > 5 * sigma[-1]
    assert last.volumetric_sigma_mm < 0.003
    # It may rise a little where noise or precisions were found larger than guessed.
    assert np.mean(np.diff(sigma) < 1e-6) > 0.7


def test_the_volumetric_uncertainty_is_that_of_the_map(moving):
    _, _, last = moving
    expected = np.sqrt(np.sum(compute_volumetric_gram(last.model) * last.covariance))
    assert last.volumetric_sigma_mm == pytest.approx(expected)


def test_lines_are_counted_as_they_are_finished(moving):
    run, on_the_way, last = moving
    done = [now.done for now, _ in on_the_way]
    assert done == sorted(done)
    assert last.done == len(run.commanded) - 1


def spoilt(run, first, last, shift_mm):
    """Return a Run with some of its valid samples in the wrong place."""
    moved = run.tracker.position_mm.copy()
    moved[first:last] += shift_mm
    return replace(run, tracker=replace(run.tracker, position_mm=moved))


def compare(live, clean):
    """Return how far tables are off those of a clean measurement, in u."""
    tables = build_error_tables(clean)
    return np.concatenate(
        [
            (table.value - tables.table(table.symbol).value)
            / np.maximum(table.uncertainty, 0.05)
            for table in build_error_tables(live).tables
        ]
    )


def test_a_clean_measurement_says_nothing_against_itself_on_the_way(moving):
    _, on_the_way, last = moving
    for now in [*(now for now, _ in on_the_way), last]:
        assert judge_live(now.check, now.done).state == "usable"
        assert now.check.knocks == ()
        assert now.check.held == ()


def test_a_knock_is_held_back_until_both_places_are_solved(moving):
    run, _, clean = moving
    first = int(0.6 * len(run.tracker))
    on_the_way, last = followed(spoilt(run, first, None, [0.03, -0.03, 0.02]))
    states = [judge_live(now.check, now.done).state for now, _ in on_the_way]
    assert "not-usable" in states
    for (now, _), state in zip(on_the_way, states, strict=True):
        after = now.time_s > run.tracker.device_time_s[first] + 3.0
        assert not after or state != "usable" or now.check.knocks
    (knock,) = last.check.knocks
    assert abs(knock.time_s - run.tracker.device_time_s[first]) < 3.0
    assert 1e3 * knock.moved_mm == pytest.approx(46.9, abs=2.0)
    assert judge_live(last.check, last.done).state == "usable"
    assert np.sqrt(np.mean(compare(last, clean) ** 2)) < 0.7


def test_a_large_knock_is_one_knock_and_not_small_ones_beside_it(moving):
    run, _, clean = moving
    first = int(0.35 * len(run.tracker))
    shift_mm = np.array([0.32, -0.32, 0.21])
    on_the_way, last = followed(spoilt(run, first, None, shift_mm))
    assert max(len(now.check.knocks) for now, _ in on_the_way) == 1
    checks = [now.check for now, _ in on_the_way if now.check.knocks]
    first_s, last_s = checks[0].knocks[0].between_s
    said = {x for x in checks[0].left_out if first_s < x.begin_s < last_s}
    assert said
    assert all(said <= set(check.left_out) for check in checks)
    (knock,) = last.check.knocks
    assert abs(knock.time_s - run.tracker.device_time_s[first]) < 3.0
    assert knock.moved_mm == pytest.approx(np.linalg.norm(shift_mm), abs=0.003)
    assert judge_live(last.check, last.done).state == "usable"
    assert np.sqrt(np.mean(compare(last, clean) ** 2)) < 0.7


def test_a_knock_after_which_no_row_is_found_is_told_and_where_it_began(moving):
    run, _, _ = moving
    first = int(0.35 * len(run.tracker))
    on_the_way, _ = followed(spoilt(run, first, None, [1.9, -1.9, 1.3]))
    told = [
        (now, reason)
        for now, _ in on_the_way
        for reason in judge_live(now.check, now.done).reasons
        if reason.kind == "stream-astray"
    ]
    assert judge_live(told[0][0].check, 1).state == "doubtful"
    values = [reason.values for _, reason in told]
    assert [v["to_s"] for v in values] == sorted({v["to_s"] for v in values})
    lines = np.diff(run.commanded.position, axis=0)
    assert len(values) > 0.5 * 0.65 * len(lines)
    knocked_s = run.tracker.device_time_s[first]
    for one in values:
        assert knocked_s - 1.0 < one["from_s"] < knocked_s + 10.0
        assert one["distance_um"] > 2000.0


def test_after_a_knock_rows_are_placed_as_the_tracker_stands_now(moving):
    run, _, _ = moving
    first, moved = int(0.6 * len(run.tracker)), [0.06, -0.06, 0.04]
    places = []
    for one in (run, spoilt(run, first, None, moved)):
        live = LiveEstimator(one.machine, one.commanded)
        for block in blocks_of(one):
            live.take(block)
        live.finish()
        places.append(live.find_commanded_mm())
    off = places[1] - places[0]
    assert np.abs(off - moved).max() < 0.015


@pytest.mark.fault_row(12)
def test_samples_in_the_wrong_place_are_left_out_at_once(moving):
    run, _, clean = moving
    first = int(0.6 * len(run.tracker))
    on_the_way, last = followed(spoilt(run, first, first + 300, [0.0, 0.05, 0.0]))
    disturbed_s = run.tracker.device_time_s[first]
    told = [now for now, _ in on_the_way if now.time_s > disturbed_s + 3.0]
    for now in [*told, last]:
        said = judge_live(now.check, now.done).reasons
        assert "are left out" in " ".join(map(str, said))
    for now in [*told, last]:
        assert np.sqrt(np.mean(compare(now, clean) ** 2)) < 1.5


def test_nothing_is_said_before_the_pose_is_known(record):
    run, _ = record(31, rows=32)
    live = LiveEstimator(run.machine, run.commanded)
    assert live.estimate() is None
    assert not live.finish()


def test_where_nothing_fits_anything_the_estimate_still_goes_on(moving):
    run, _, _ = moving
    tracker, rng = run.tracker, np.random.default_rng(2)
    places = rng.normal(0.0, 3.0, (len(tracker) // 400 + 1, 3))
    astray = tracker.position_mm + np.repeat(places, 400, axis=0)[: len(tracker)]
    run = replace(run, tracker=replace(tracker, position_mm=astray))
    _, last = followed(replace(run, tracker=run.tracker.select(slice(0, 12_000))))
    assert judge_live(last.check, last.done).state != "usable"
