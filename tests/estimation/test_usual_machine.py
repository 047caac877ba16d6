"""What is wrong at points does not make a machine of other errors."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.estimation.checks.disturbances import estimate_checked
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map

POINT = 30


def move_one(seen, by_mm):
    moved = seen.tracker_mm.copy()
    moved[seen.row == POINT] += by_mm * np.array([0.6, -0.64, 0.48])
    return replace(seen, tracker_mm=moved)


@pytest.fixture
def share_left(volume, rigid_free):
    """Share of the volumetric error that is left, and of it within two sigma."""

    def measured(result, truth):
        q = volume(result.model.machine)
        at, found = (
            make_standstill(result.model.machine, q),
            build_volumetric_map(result.model),
        )
        before = rigid_free(q, truth.deviation_mm(q))
        left = before - rigid_free(q, found.error_mm(at, result.theta))
        inside = np.abs(left) < 2 * found.sigma_mm(at, result.covariance)
        sizes = (np.linalg.norm(each, axis=1).mean() for each in (left, before))
        return next(sizes) / next(sizes), float(inside.mean())

    return measured


@pytest.fixture(scope="module")
def standing(record):
    return record(22, "standstill", rows=60)


@pytest.mark.parametrize("off_um", [20.0, 1000.0])
def test_one_point_that_is_off_is_left_out_and_harmless(standing, share_left, off_um):
    run, truth = standing
    seen = align(run)
    models = build_run_models(run.machine, [seen.at.offset_mm])
    clean, spoilt = (
        estimate_checked(models, [each])
        for each in (seen, move_one(seen, 1e-3 * off_um))
    )
    share, inside = share_left(spoilt.estimate, truth)
    as_usual, _ = share_left(clean.estimate, truth)
    assert {each.row for each in spoilt.left_out[0]} == {POINT}
    assert clean.left_out == ((),)
    assert share < 1.15 * as_usual
    assert inside > 0.85


@pytest.mark.parametrize("off_um", [100.0, 2000.0])
def test_no_machine_bends_to_follow_a_knock_between_few_points(
    standing, share_left, off_um
):
    run, truth = standing
    seen = align(run)
    models = build_run_models(run.machine, [seen.at.offset_mm])
    clean = estimate_checked(models, [seen])
    moved = seen.tracker_mm.copy()
    moved[seen.row >= POINT] += 1e-3 * off_um * np.array([0.6, -0.64, 0.48])
    spoilt = estimate_checked(models, [replace(seen, tracker_mm=moved)])
    share, inside = share_left(spoilt.estimate, truth)
    as_usual, _ = share_left(clean.estimate, truth)
    (knock,) = spoilt.knocks
    assert knock.row == POINT
    assert 1e3 * knock.moved_mm == pytest.approx(off_um, abs=3.0)
    assert clean.knocks == ()
    assert share < 1.3 * as_usual
    assert inside > 0.85
