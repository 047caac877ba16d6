"""The estimate while the machine moves: it tightens, and ends where the batch does."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate
from following import compare_tables, follow, shift
from truepath.alignment.align import align
from truepath.estimation.live.live import LiveEstimator
from truepath.estimation.live.segment_check import align_earlier
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.planning.adaptive_plan import AdaptivePlanner
from truepath.planning.plan_request import PlanRequirements
from truepath.results.result_assessment import assess_live
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def run(record_small):
    return record_small(31)[0]


@pytest.fixture(scope="module")
def clean(run):
    return follow(run, with_notices=True)


def test_the_live_estimate_tightens_to_the_tables_of_the_batch(run, clean):
    last = clean.last
    off = compare_tables(last, estimate(align(run)))
    assert np.abs(off).max() < 1.0
    assert np.sqrt(np.mean(off**2)) < 0.3
    sigma = [now.volumetric_sigma_mm for now in clean.on_the_way]
    assert sigma[0] > 5 * sigma[-1]
    assert last.volumetric_sigma_mm < 0.003
    # It may rise a little where noise or precisions were found larger than guessed.
    assert np.mean(np.diff(sigma) < 1e-6) > 0.7
    expected = np.sqrt(np.sum(compute_volumetric_gram(last.model) * last.covariance))
    assert last.volumetric_sigma_mm == pytest.approx(expected)
    done = [now.done for now in clean.on_the_way]
    assert done == sorted(done)
    assert last.done == len(run.commanded) - 1
    for now in [*clean.on_the_way, clean.last]:
        assert assess_live(now.check, now.done).state == "usable"
        assert now.check.setup_shifts == ()
        assert now.check.held == ()
    assert len(clean.noticed) > 15
    assert not any(notices for _, notices in clean.noticed)


def spoil(run, share, shift_mm, last=None):
    first = int(share * len(run.tracker))
    off_mm = np.zeros((len(run.tracker), 3))
    off_mm[first : first + last if last else None] = shift_mm
    return shift(run, off_mm), run.tracker.device_time_s[first]


def assert_one_knock_is_solved(followed, clean, knocked_s, moved_mm, within_mm):
    last = followed.last
    (knock,) = last.check.setup_shifts
    assert abs(knock.time_s - knocked_s) < 3.0
    assert knock.moved_mm == pytest.approx(np.linalg.norm(moved_mm), abs=within_mm)
    assert assess_live(last.check, last.done).state == "usable"
    assert np.sqrt(np.mean(compare_tables(last, clean.last) ** 2)) < 0.7


def test_a_knock_is_held_back_until_both_places_are_solved(run, clean):
    moved_mm = np.array([0.03, -0.03, 0.02])
    spoilt, knocked_s = spoil(run, 0.6, moved_mm)
    found = follow(spoilt)
    states = [assess_live(now.check, now.done).state for now in found.on_the_way]
    assert "not-usable" in states
    for now, state in zip(found.on_the_way, states, strict=True):
        after = now.time_s > knocked_s + 3.0
        assert not after or state != "usable" or now.check.setup_shifts
    assert_one_knock_is_solved(found, clean, knocked_s, moved_mm, 0.002)
    # Rows are placed as the tracker stands now.
    places = [each.live.find_commanded_mm() for each in (clean, found)]
    assert np.abs(places[1] - places[0] - moved_mm).max() < 0.015


def test_a_large_knock_is_one_knock_and_not_small_ones_beside_it(run, clean):
    moved_mm = np.array([0.32, -0.32, 0.21])
    spoilt, knocked_s = spoil(run, 0.42, moved_mm)
    found = follow(spoilt)
    assert max(len(now.check.setup_shifts) for now in found.on_the_way) == 1
    checks = [now.check for now in found.on_the_way if now.check.setup_shifts]
    first_s, last_s = checks[0].setup_shifts[0].between_s
    said = {x for x in checks[0].left_out if first_s < x.begin_s < last_s}
    assert said
    assert all(said <= set(check.left_out) for check in checks)
    assert_one_knock_is_solved(found, clean, knocked_s, moved_mm, 0.003)


def test_a_knock_after_which_no_row_is_found_is_told_and_where_it_began(run):
    spoilt, knocked_s = spoil(run, 0.35, [1.9, -1.9, 1.3])
    some = slice(0, len(run.tracker) * 3 // 4)
    spoilt = replace(spoilt, tracker=spoilt.tracker.select(some))
    verdicts = [assess_live(x.check, x.done) for x in follow(spoilt).on_the_way]
    told = [(v, r) for v in verdicts for r in v.reasons if r.kind == "stream-astray"]
    assert told[0][0].state == "doubtful"
    values = [reason.values for _, reason in told]
    assert [v["to_s"] for v in values] == sorted({v["to_s"] for v in values})
    assert len(values) > 0.5 * 0.65 * (len(run.commanded) - 1)
    for one in values:
        assert knocked_s - 1.0 < one["from_s"] < knocked_s + 10.0
        assert one["distance_um"] > 2000.0


@pytest.mark.fault_row(12)
def test_samples_in_the_wrong_place_are_left_out_at_once(run, clean):
    spoilt, disturbed_s = spoil(run, 0.6, [0.0, 0.05, 0.0], last=60)
    found = follow(spoilt)
    told = [now for now in found.on_the_way if now.time_s > disturbed_s + 3.0]
    for now in [*told, found.last]:
        said = assess_live(now.check, now.done).reasons
        assert "are left out" in " ".join(map(str, said))
        assert np.sqrt(np.mean(compare_tables(now, clean.last) ** 2)) < 1.5


def test_nothing_is_said_before_a_pose_is_known_and_it_goes_on_where_nothing_fits(run):
    live = LiveEstimator(run.machine, run.commanded)
    assert live.estimate() is None
    assert not live.finish()
    count = len(run.tracker)
    places = np.random.default_rng(2).normal(0.0, 3.0, (count // 80 + 1, 3))
    astray = shift(run, np.repeat(places, 80, axis=0)[:count])
    half = replace(astray, tracker=astray.tracker.select(slice(0, count // 3)))
    last = follow(half).last
    assert assess_live(last.check, last.done).state != "usable"


def test_earlier_runs_add_what_they_tell_and_their_minutes_are_off(record):
    earlier = align_earlier([record(31, rows=16)[0]])
    run, _ = record(32, rows=12, setting=Setting(machine_seed=31))
    blocks = [run.tracker]
    alone, both = (follow(run, blocks=blocks, earlier=x) for x in ((), earlier))
    sigma_mm = both.last.volumetric_sigma_mm
    assert sigma_mm < 0.75 * alone.last.volumetric_sigma_mm
    whole = AdaptivePlanner(run.machine, run.commanded, PlanRequirements(minutes=60.0))
    order = PlanRequirements(minutes=whole._used_s / 60.0 + 0.5)

    def choose(earlier):
        planner = AdaptivePlanner(run.machine, run.commanded, order, earlier)
        return planner.next(both.live.findings(), sigma_mm)

    assert choose(()).commanded is not None
    assert choose(earlier).commanded is None
