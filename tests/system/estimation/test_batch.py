"""The estimate against known truth: its map, lost motion, knocks of the set-up."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimating import estimate, estimate_one, judge_map
from following import shift
from truepath.alignment.align import align, align_all
from truepath.estimation.checks.run_segments import (
    RunSegment,
    merge_empty,
    split_at_all,
)
from truepath.estimation.checks.setup_shifts import Step
from truepath.estimation.solve import batch
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.backlash import make_half_shape, make_half_width
from truepath.kinematics.machine.machine import LinearAxis
from truepath.results.error_tables import compute_half_differences
from truepath_simulators.worlds.synthetic import Setting


def judge(run, truth, **options):
    result = estimate(align(run), **options)
    return judge_map(result, truth.deviation_mm), result


@pytest.fixture(scope="module")
def few(record_small):
    run, _ = record_small(30, rows=16)
    return run, align(run)


@pytest.mark.parametrize("chain", ["w-b-X-Y-Z-t", "w-Z-b-Y-X-t"])
def test_on_the_fly_the_map_is_found_whatever_the_chain(record, chain):
    left, result = judge(*record(21, rows=40, chain=chain))
    assert left.share < 0.05
    assert 0.85 < left.inside <= 1.0
    assert result.runs[0].lines == 39
    # Nothing is missing: residuals are noise. One target tells this much and no more.
    assert 0.85 < result.rms_mm / result.floor_mm < 1.1
    assert result.observability.rank == 67


def test_standstill_points_find_the_map_with_the_same_solver(record):
    left, _ = judge(*record(22, "standstill", rows=120))
    assert left.share < 0.06
    assert 0.85 < left.inside <= 1.0


def test_twice_the_noise_is_twice_the_uncertainty(record):
    loud = (Setting(noise_scale=scale) for scale in (1.0, 2.0))
    runs = (record(24, rows=30, setting=setting)[0] for setting in loud)
    both = (estimate(align(run)).reduce_to_targets for run in runs)
    (_, first), (_, second) = (each.part("C0Y") for each in both)
    assert np.sqrt(second / first).item() == pytest.approx(2.0, rel=0.3)


def test_the_estimate_does_not_depend_on_where_the_tracker_stands(few):
    run, seen = few
    a = estimate(seen)
    # Turned about its own vertical, the instrument's noise stays what it was.
    turn = Rotation.from_rotvec([0.0, 0.0, 1.1])
    samples = replace(run.tracker, position_mm=turn.apply(run.tracker.position_mm))
    b = estimate(align(replace(run, tracker=samples)))
    u = np.sqrt(np.diag(a.covariance))
    assert (np.abs(a.theta - b.theta) < 1e-3 * u).all()
    assert np.sqrt(np.diag(b.covariance)) == pytest.approx(u, rel=1e-3)


def test_perpendicular_only_does_not_see_what_lies_along_the_travel(few):
    _, seen = few
    along_mm = 0.01 * np.sin(seen.at.time_s)[:, None] * seen.direction
    moved_mm = seen.tracker_mm + along_mm @ seen.pose.rotation.T
    moved = replace(seen, tracker_mm=moved_mm)
    a, b = (estimate(each, perpendicular_only=True) for each in (seen, moved))
    assert np.abs(a.theta - b.theta).max() < 2e-7 + 0.01 * np.abs(a.theta).max()


def test_along_path_information_halves_what_corner_paths_leave(record_small):
    run, truth = record_small(27, corners=True)
    along, _ = judge(run, truth)
    across, _ = judge(run, truth, perpendicular_only=True)
    assert along.share < 0.6 * across.share


def test_progress_grows_and_is_complete_only_after_the_last_work(few, monkeypatch):
    told = []
    works = (batch.widen_by_unknown_precision, batch.assess_observability)

    def recorded(work, *arguments):
        told.append(work)
        return work(*arguments)

    for work in works:
        monkeypatch.setattr(batch, work.__name__, partial(recorded, work))
    estimate(few[1], on_progress=told.append)
    assert told[-4:] == [0.9, *works, 1.0]
    shares = [share for share in told if isinstance(share, float)]
    assert shares == sorted(shares)


def test_errors_of_a_millimetre_are_found_to_a_micrometre(record):
    run, truth = record(5, rows=40, setting=Setting(error_scale=25.0))
    left, _ = judge(run, truth)
    true_mm = truth.deviation_mm(truth.recording.commanded_mm[::500])
    assert np.linalg.norm(true_mm, axis=1).max() > 0.8
    assert left.left_mm < 1.5e-3
    assert left.inside > 0.85


HALF_MM = 0.003


@pytest.fixture(scope="module")
def seen(record):
    return align(record(31, rows=40)[0])


def with_backlash(seen, shape=lambda y: np.ones_like(y)):
    y = seen.at.position_mm[:, 1]
    offset = np.zeros((len(seen), 3))
    offset[:, 1] = -HALF_MM * shape(y / 400.0) * seen.at.approach[:, 1]
    return replace(seen, tracker_mm=seen.tracker_mm + offset @ seen.pose.rotation.T)


def halves(result):
    return {half.symbol: half for half in compute_half_differences(result)}


def test_a_lost_motion_is_found_with_its_size_axis_and_shape_and_nowhere_else(seen):
    sound = estimate(seen)
    assert sound.direction == "none"
    assert not halves(sound)
    result = estimate(with_backlash(seen))
    assert result.direction == "constant"
    found = halves(result)
    assert len(found) == 14
    eyy = found["EYY"]
    assert eyy.value[0] == pytest.approx(-1e3 * HALF_MM, abs=3 * eyy.uncertainty[0])
    assert eyy.uncertainty[0] < 0.5
    clear = [s for s, h in found.items() if abs(h.value[0]) > 5 * h.uncertainty[0]]
    assert clear == ["EYY"]
    result = estimate(with_backlash(seen, lambda u: 1.0 + 1.5 * np.sin(5.0 * u)))
    assert result.direction == "tables"
    eyy = halves(result)["EYY"]
    u = eyy.position_mm / 400.0
    truth = -1e3 * HALF_MM * (1.0 + 1.5 * np.sin(5.0 * u))
    inside = slice(1, -1)
    assert np.abs(eyy.value - truth)[inside].max() < 1.0


def test_the_sign_is_that_of_the_last_motion(record):
    run, _ = record(31, rows=40)
    at = make_standstill(run.machine, np.full((3, 3), 100.0))
    at = replace(at, approach=np.outer([1.0, -1.0, 0.0], [1.0, 0.0, 0.0]))
    effect = make_half_width("EXX", run.machine.linear_axes[0])
    moved = effect.displacement_mm(at, np.array([0.002]))
    assert moved[:, 0].tolist() == [0.002, -0.002, 0.0]


def test_a_shape_has_no_mean_of_its_own(rng):
    shape = make_half_shape("EYX", LinearAxis("X", -100.0, 400.0))
    at_mm = np.linspace(-100.0, 400.0, 20_001)
    theta = rng.normal(size=len(shape.parameters))
    assert np.mean(shape.rows(at_mm) @ theta) == pytest.approx(0.0, abs=1e-3)


POINT = 30


@pytest.fixture(scope="module")
def moving(record):
    return record(32, "otf", rows=24)[0]


def check(run, shift_mm):
    time_s = run.tracker.device_time_s
    share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    found = estimate_one(*align_all([shift(run, shift_mm(share))], ["run"]))
    return found, time_s[0] + np.array([0.3, 0.65]) * (time_s[-1] - time_s[0])


def test_knocks_are_found_where_they_are_and_told_from_drift(record_small):
    standing, _ = record_small(31, "standstill", rows=60)
    moved_mm = np.array([[0.03, -0.02, 0.01], [-0.01, -0.03, 0.03]])
    late = np.array([0.3, 0.65])
    found, time_s = check(standing, lambda share: (share[:, None] > late) @ moved_mm)
    assert [knock.time_s for knock in found.setup_shifts] == pytest.approx(
        time_s, abs=2.5
    )
    moved_um = [1e3 * knock.moved_mm for knock in found.setup_shifts]
    assert moved_um == pytest.approx([37.4, 43.6], abs=3.0)
    small_mm = [0.006, -0.006, 0.004]
    found, time_s = check(standing, lambda share: np.outer(share > 0.65, small_mm))
    (knock,) = found.setup_shifts
    assert knock.time_s == pytest.approx(time_s[1], abs=2.5)
    found, _ = check(standing, lambda share: np.outer(share, [0.02, -0.01, 0.01]))
    assert found.setup_shifts == ()


def test_a_knock_within_a_line_is_one_step_at_its_moment(moving):
    late = 0.52
    found, _ = check(moving, lambda share: np.outer(share > late, [0.02, -0.02, 0.01]))
    time_s = moving.tracker.device_time_s
    moment_s = time_s[0] + late * (time_s[-1] - time_s[0])
    (knock,) = found.setup_shifts
    assert knock.time_s == pytest.approx(moment_s, abs=0.2)
    assert 1e3 * knock.moved_mm == pytest.approx(30.0, abs=1.5)
    assert not any(misfit.unseen for misfit in found.misfits)


def test_what_lies_between_two_knocks_of_a_line_goes_and_is_said(moving):
    (seen,) = align_all([moving], ["run"])
    first, last = max(seen.lines, key=lambda line: line[1] - line[0])
    steps = [Step(cell, 1e4, 1e4, 0.1) for cell in (first + 6, last - 6)]
    edges = np.arange(len(seen) + 1)
    off_mm = np.full(len(seen), 0.1)
    parts = split_at_all(RunSegment(0, seen), steps, edges, off_mm)
    before, after = merge_empty(parts)
    time_s = seen.at.time_s
    assert before.seen.at.time_s[-1] < time_s[first + 6]
    assert after.seen.at.time_s[0] > time_s[last - 6]
    (said,) = before.seen.left_out
    assert said.begin_s == pytest.approx(time_s[first + 6], abs=0.2)
    assert said.off_mm == pytest.approx(0.1)
    assert before.seen.offered + after.seen.offered == seen.offered  # none is lost


@pytest.fixture(scope="module")
def clean(record):
    run, truth = record(22, "standstill", rows=60)
    seen = align(run)
    return seen, truth, estimate_one(seen)


def judge_moved(clean, rows, by_mm):
    seen, truth, checked = clean
    assert checked.left_out == ((),)
    assert checked.setup_shifts == ()
    moved = seen.tracker_mm.copy()
    moved[rows] += by_mm * np.array([0.6, -0.64, 0.48])
    found = estimate_one(replace(seen, tracker_mm=moved))
    pair = found.estimate, checked.estimate
    left, usual = (judge_map(each, truth.deviation_mm) for each in pair)
    assert left.inside > 0.85
    return found, left.share / usual.share


@pytest.mark.parametrize("off_um", [20.0, 1000.0])
def test_one_point_that_is_off_is_left_out_and_harmless(clean, off_um):
    found, worse = judge_moved(clean, clean[0].row == POINT, 1e-3 * off_um)
    assert {each.row for each in found.left_out[0]} == {POINT}
    assert worse < 1.15


def test_no_machine_bends_to_follow_a_knock_between_few_points(clean):
    found, worse = judge_moved(clean, clean[0].row >= POINT, 2.0)
    (knock,) = found.setup_shifts
    assert knock.row == POINT
    assert 1e3 * knock.moved_mm == pytest.approx(2000.0, abs=3.0)
    assert worse < 1.3
