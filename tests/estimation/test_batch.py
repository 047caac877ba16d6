"""The estimate against known truth that shares no physics with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.estimation.solve import batch
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.worlds.synthetic import Setting


@pytest.fixture(scope="module")
def judge(record, rigid_free, volume, at_rest):
    """Return (share of the error left, share of truth inside 2u, estimate)."""

    def judged(run, truth, **options):
        result = estimate(align(run), **options)
        q = volume(run.machine)
        at = at_rest(run.machine, q)
        maps = build_volumetric_map(result.model)
        before = rigid_free(q, truth.deviation_mm(q))
        left = before - rigid_free(q, maps.error_mm(at, result.theta))
        u = maps.sigma_mm(at, result.covariance)
        share = (
            np.linalg.norm(left, axis=1).mean() / np.linalg.norm(before, axis=1).mean()
        )
        return share, float((np.abs(left) < 2 * u).mean()), result

    return judged


@pytest.mark.parametrize(
    "chain", ["w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-Y-b-X-Z-t", "w-X-Y-b-Z-t", "w-Z-b-Y-X-t"]
)
def test_on_the_fly_the_map_is_found_whatever_the_chain(record, judge, chain):
    share, inside, result = judge(*record(21, rows=40, chain=chain))
    assert share < 0.05
    assert 0.85 < inside <= 1.0
    assert result.runs[0].lines == 39


def test_standstill_points_find_the_map_with_the_same_solver(record, judge):
    share, inside, _ = judge(*record(22, "standstill", rows=120))
    assert share < 0.06
    assert 0.85 < inside <= 1.0


@pytest.mark.long
@pytest.mark.timeout(600)
def test_stated_uncertainty_covers_the_truth_at_the_stated_rate(record, judge):
    inside = [judge(*record(seed, rows=30))[1] for seed in range(40, 60)]
    assert 0.92 < np.mean(inside) < 0.98


def test_the_slow_part_of_the_noise_is_found_in_the_data(record, judge):
    air = Setting(air=Air(share=0.25, tau_s=0.8))
    _, _, result = judge(*record(23, rows=40, setting=air))
    assert result.runs[0].noise.ou == pytest.approx((0.25, 0.25), rel=0.35)
    assert 0.4 < result.runs[0].noise.ou_time_s < 1.6


def test_twice_the_noise_is_twice_the_uncertainty(record, judge):
    _, _, once = judge(*record(24, rows=30))
    _, _, twice = judge(*record(24, rows=30, setting=Setting(noise_scale=2.0)))
    (_, first), (_, second) = (e.at_targets.part("C0Y") for e in (once, twice))
    ratio = np.sqrt(second / first)
    assert ratio.item() == pytest.approx(2.0, rel=0.3)


def test_the_estimate_does_not_depend_on_where_the_tracker_stands(record, rng):
    run, _ = record(25)
    seen = align(run)
    # Turned about its own vertical, the instrument's noise stays what it was.
    turn = Rotation.from_rotvec([0.0, 0.0, 1.1])
    samples = replace(run.tracker, position_mm=turn.apply(run.tracker.position_mm))
    a, b = estimate(seen), estimate(align(replace(run, tracker=samples)))
    u = np.sqrt(np.diag(a.covariance))
    assert (np.abs(a.theta - b.theta) < 1e-3 * u).all()
    assert np.sqrt(np.diag(b.covariance)) == pytest.approx(u, rel=1e-3)


def test_perpendicular_only_does_not_see_what_lies_along_the_travel(record):
    run, _ = record(26)
    seen = align(run)
    pushed = (
        seen.pose.rotation @ (seen.direction * 0.01 * np.sin(seen.at.time_s)[:, None]).T
    )
    moved = replace(seen, tracker_mm=seen.tracker_mm + pushed.T)
    a = estimate(seen, perpendicular_only=True)
    b = estimate(moved, perpendicular_only=True)
    assert np.abs(a.theta - b.theta).max() < 2e-7 + 0.01 * np.abs(a.theta).max()


def test_along_path_information_halves_what_corner_paths_leave(record, judge):
    recorded = record(27, corners=True)
    along, _, _ = judge(*recorded)
    across, _, _ = judge(*recorded, perpendicular_only=True)
    assert along < 0.6 * across


def test_residuals_are_noise_when_nothing_is_missing(record, judge):
    _, _, result = judge(*record(28, rows=40))
    ratio = result.rms_mm / result.floor_mm
    assert 0.85 < ratio < 1.1


def test_squareness_is_unseen_when_only_one_axis_moves(record):
    run, _ = record(29)
    position = run.commanded.position
    assert np.ptp(position, axis=0).min() > 100.0
    result = estimate(align(run))
    assert result.observability.rank == 67


def test_more_lines_leave_less(record, judge):
    few, _, a = judge(*record(30, rows=16))
    many, _, b = judge(*record(30, rows=60))
    c0y = a.model.slices["C0Y"]
    assert b.covariance[c0y, c0y].item() < a.covariance[c0y, c0y].item()
    assert many < few


def test_progress_is_told_from_start_to_end(record):
    run, _ = record(25)
    told: list[float] = []
    estimate(align(run), on_progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_progress_is_complete_only_after_the_last_work(record, monkeypatch):
    run, _ = record(25)
    order: list[object] = []
    works = (batch.widen_by_unknown_precision, batch.assess_observability)
    for work in works:

        def recorded(*arguments, work=work):
            order.append(work)
            return work(*arguments)

        monkeypatch.setattr(batch, work.__name__, recorded)
    estimate(align(run), on_progress=order.append)
    assert order[-4:] == [0.9, *works, 1.0]
