"""The estimate while the machine moves: it tightens; changes and trackers are named."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate, estimate_one, judge_map
from following import compare_tables, follow, follow_lines, shift
from recorded import choose_program, load_erring, record_run, with_samples
from truepath.alignment.align import align, align_all
from truepath.estimation.checks.change_detection import (
    KNOCK,
    LINE,
    LOST_MOTION,
    RANGE,
    UNNAMED,
    Change,
    revise,
)
from truepath.estimation.live.live import LiveEstimator
from truepath.estimation.live.segment_check import align_earlier
from truepath.kinematics.effects.instrument import is_tracker_error
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.planning.adaptive_plan import AdaptivePlanner
from truepath.planning.plan_request import PlanRequirements
from truepath.results.analysis import analyse
from truepath.results.result_assessment import assess, assess_live
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.worlds.synthetic import BEAM_BROKEN, Defects, Setting


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


ROWS = tuple(range(1, 21))


@pytest.fixture(scope="module")
def usual(record):
    run, _ = record(31, rows=32)
    time_s = run.tracker.device_time_s
    return run, (time_s - time_s[0]) / (time_s[-1] - time_s[0])


def test_nothing_is_noticed_where_nothing_changes_and_a_drift_is_no_knock(usual):
    run, share = usual
    told = follow_lines(run).noticed
    assert len(told) > 25
    assert not any(notices for _, notices in told)
    drifting = shift(run, np.outer(share, [0.012, 0.012, -0.012]))
    told = follow_lines(drifting).noticed
    assert [n.kind for n in told[-1][1] if not n.is_over] == ["set-up-drifts"]
    assert KNOCK not in {n.kind for _, notices in told for n in notices}


@pytest.mark.fault_row(11)
def test_a_knock_is_noticed_by_the_next_line_and_named_with_its_size(usual, measured):
    run, share = usual
    late = share > 0.7
    told = follow_lines(shift(run, np.outer(late, [0.006, -0.006, 0.006]))).noticed
    knocked_s = run.tracker.device_time_s[np.argmax(late)]
    assert not any(notices for now_s, notices in told if now_s < knocked_s)
    first_s, notices = next((now_s, n) for now_s, n in told if n)
    finished = [now_s for now_s, _ in told if knocked_s < now_s <= first_s]
    assert len(finished) <= 2
    assert notices[0].number == 1
    (notice,) = told[-1][1]
    assert (notice.kind, notice.grade, notice.is_over) == (KNOCK, "certain", False)
    assert notice.noticed_s == pytest.approx(first_s, abs=3.0)
    assert abs(1e3 * notice.size_mm - 10.4) < 4e3 * notice.sigma_mm
    assert 1e3 * notice.sigma_mm < 1.5
    measured(
        f"10.4 µm stated as {1e3 * notice.size_mm:.1f} ± "
        f"{2e3 * notice.sigma_mm:.1f} µm, {first_s - knocked_s:.0f} s after it"
    )


def test_a_knock_half_way_on_a_line_is_one_change(usual):
    run, share = usual
    moved = shift(run, np.outer(share > 0.56, [0.007, -0.007, 0.007]))
    told = follow_lines(moved).noticed
    shown = [[n.kind for n in notices if not n.is_over] for _, notices in told]
    assert max(map(len, shown)) == 1
    assert shown[-1] == [KNOCK]


def change(kind, onset, margin=30.0, size_mm=0.01, axis=""):
    return Change(kind, axis, onset, 100.0, 50.0, margin, size_mm, 0.001)


def test_a_change_has_no_name_while_another_kind_or_one_line_explains_it():
    (notice,) = revise((), [change(KNOCK, 15, margin=3.0)], ROWS, 9.0)
    assert (notice.kind, notice.grade, notice.since_row) == (UNNAMED, "possible", 16)
    (notice,) = revise((), [change(KNOCK, 19)], ROWS, 9.0)
    assert notice.kind == UNNAMED


@pytest.mark.parametrize(("margin", "grade"), [(9.0, "likely"), (21.0, "certain")])
def test_the_grade_is_how_much_worse_the_next_kind_is(margin, grade):
    (notice,) = revise((), [change(LOST_MOTION, 5, margin, axis="Y")], ROWS, 9.0)
    assert (notice.kind, notice.axis, notice.grade) == (LOST_MOTION, "Y", grade)


def test_a_notice_keeps_its_number_when_named_may_have_begun_elsewhere_and_ends():
    first = revise((), [change(LINE, 15, margin=1.0)], ROWS[:16], 9.0)
    (later,) = revise(first, [change(KNOCK, 14, size_mm=0.02)], ROWS, 30.0)
    assert (later.number, later.noticed_s, later.noticed_row) == (1, 9.0, 16)
    assert (later.kind, later.size_mm) == (KNOCK, 0.02)
    first = revise((), [change(LINE, 6, margin=1.0)], ROWS[:16], 9.0)
    (later,) = revise(first, [change(KNOCK, 14)], ROWS, 30.0)
    assert (later.number, later.kind, later.since_row) == (1, KNOCK, 15)
    both = revise((later,), [change(KNOCK, 14), change(KNOCK, 6)], ROWS, 40.0)
    assert [n.since_row for n in both] == [15, 7]
    first = revise((), [change(KNOCK, 15)], ROWS, 9.0)
    (over,) = revise(first, [], ROWS, 12.0)
    assert over == replace(first[0], is_over=True)
    both = revise((over,), [change(KNOCK, 3)], ROWS, 15.0)
    assert [(n.number, n.is_over) for n in both] == [(1, True), (2, False)]


PLACE_MM = np.array([0.03, -0.02, 0.025])
TILT_RAD = np.array([3e-5, -4e-5, 1e-5])
RANGE_MM = -0.06
LONGER = np.array([RANGE_MM, 0.0, 0.0])


def measure(seed, mode="otf", specification=None, rows=24, **setting):
    content = load_erring(specification)
    program = choose_program(content, seed, mode, rows=rows)
    setting = Setting(**(setting or {"machine_seed": seed}))
    run, made = record_run(content, program, seed, mode, setting)
    return run, made.truth


def lose_beam(run, off_mm, share=0.6):
    tracker = run.tracker
    time_s = tracker.device_time_s
    lost_s = time_s[0] + share * (time_s[-1] - time_s[0])
    late = time_s >= lost_s
    status = np.where(late & (time_s < lost_s + 0.4), 1, tracker.status)
    moved = tracker.position_mm + late[:, None] * off_mm(tracker.position_mm)
    return with_samples(run, position_mm=moved, status=status)


def lengthen(by_mm):
    return lambda place: by_mm * place / np.linalg.norm(place, axis=1)[:, None]


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_live_uncertainty_ends_as_that_of_the_analysis_and_both_hold_the_truth(mode):
    inside = []  # of the live estimate and of the analysis
    for seed in (11, 12, 13):
        run, truth = measure(seed, mode)
        followed, batch = follow_lines(run), analyse(run).estimate
        gram = compute_volumetric_gram(batch.model)
        stated_mm = float(np.sqrt(np.sum(gram * batch.covariance)))
        last = followed.last
        assert last.volumetric_sigma_mm == pytest.approx(stated_mm, rel=0.1)
        inside.append([judge_map(x, truth.deviation_mm).inside for x in (last, batch)])
        assert not any(notices for _, notices in followed.noticed)
        assert not last.check.setup_shifts
    assert (np.mean(inside, axis=0) > 0.86).all()
    assert min(of_batch for _, of_batch in inside) > 0.6


def test_a_perfect_tracker_has_no_errors_in_the_live_estimate():
    run, _ = measure(11, specification={})
    typical, _ = measure(11)
    one, other = (follow(each).last for each in (run, typical))
    assert not any(is_tracker_error(effect) for effect in one.model.effects)
    assert one.volumetric_sigma_mm < 0.8 * other.volumetric_sigma_mm


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_a_range_offset_after_a_new_lock_is_told_as_such(mode):
    run, truth = measure(12, mode)
    followed = follow_lines(lose_beam(run, lengthen(0.08)))
    (knock,) = followed.last.check.setup_shifts
    assert knock.kind == "range"
    assert knock.moved_mm == pytest.approx(0.08, abs=0.004)
    (notice,) = followed.noticed[-1][1]
    assert (notice.kind, notice.is_over) == (RANGE, False)
    assert notice.size_mm == pytest.approx(0.08, abs=4.0 * notice.sigma_mm)
    told = {n.kind for _, notices in followed.noticed for n in notices}
    assert KNOCK not in told
    assert judge_map(followed.last, truth.deviation_mm).inside > 0.86


def test_after_a_new_lock_a_knock_is_a_knock_and_an_offset_as_specified_not_told():
    run, _ = measure(12)
    followed = follow_lines(lose_beam(run, lambda _: np.array([0.03, -0.03, 0.03])))
    (notice,) = followed.noticed[-1][1]
    assert notice.kind == KNOCK
    (knock,) = followed.last.check.setup_shifts
    assert knock.kind == "place"
    followed = follow_lines(lose_beam(run, lengthen(0.004)))
    assert not any(notices for _, notices in followed.noticed)
    assert not followed.last.check.setup_shifts
    assert not followed.last.check.held


def test_more_new_locks_than_were_foreseen_leave_the_estimate_as_it_is():
    run, truth = measure(13, "standstill")
    for share in np.linspace(0.3, 0.9, 9):
        run = lose_beam(run, lengthen(0.003), share)
    last = follow_lines(run).last
    assert not last.check.held
    assert judge_map(last, truth.deviation_mm).inside > 0.8


# What is done, how large it is, and which reason of the verdict says it.
KINDS = {
    "place": (
        lambda position_mm: position_mm + PLACE_MM,
        1e3 * np.linalg.norm(PLACE_MM),
        "set-up-moved",
    ),
    "tilt": (
        lambda position_mm: position_mm + np.cross(TILT_RAD, position_mm),
        1e6 * np.linalg.norm(TILT_RAD),
        "tracker-tilted",
    ),
    "range": (
        lambda position_mm: to_cartesian(to_spherical(position_mm) + LONGER),
        1e3 * RANGE_MM,
        "range-offset-changed",
    ),
}
SAID = {said for _, _, said in KINDS.values()}


@pytest.mark.parametrize(
    ("kind", "mode", "broken_s"),
    [
        ("place", "standstill", 0.0),
        ("tilt", "standstill", 0.0),
        ("range", "standstill", 0.0),
        ("range", "otf", 0.4),
        pytest.param("place", "otf", 0.0, marks=pytest.mark.long),
        pytest.param("tilt", "otf", 0.4, marks=pytest.mark.long),
        pytest.param("range", "otf", 0.0, marks=pytest.mark.long),
    ],
)
def test_a_step_has_the_name_of_what_happened(kind, mode, broken_s):
    run, truth = measure(51, mode, rows=20, defects=Defects())
    first = int(0.57 * len(run.tracker))
    at_s = run.tracker.device_time_s[first]
    late = run.tracker.device_time_s >= at_s + broken_s
    position_mm, status = run.tracker.position_mm.copy(), run.tracker.status.copy()
    position_mm[late] = KINDS[kind][0](position_mm[late])
    status[first:][~late[first:]] = BEAM_BROKEN
    moved = with_samples(run, position_mm=position_mm, status=status)
    found = estimate_one(*align_all([moved], ["run"]))
    (knock,) = found.setup_shifts
    assert knock.kind == kind
    assert knock.time_s == pytest.approx(at_s, abs=2.5)
    _, size, said = KINDS[kind]
    (reason,) = (one for one in assess(found, ["run"]).reasons if one.kind in SAID)
    assert reason.kind == said
    told = reason.values["angle_urad" if kind == "tilt" else "distance_um"]
    assert told == pytest.approx(size, abs=5.0)
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75


def test_a_new_lock_within_the_specification_is_no_step():
    lost = Defects(beam_breaks=((30.0, 0.4),))
    run, truth = measure(53, rows=20, defects=lost)
    found = estimate_one(*align_all([run], ["run"]))
    assert found.setup_shifts == ()
    assert judge_map(found.estimate, truth.deviation_mm).inside > 0.75
