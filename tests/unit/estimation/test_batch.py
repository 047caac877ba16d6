"""The estimate against known truth: its map, and lost motion where it is."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimating import estimate, judge_map
from truepath.alignment.align import align
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
