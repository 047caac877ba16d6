"""What is wrong at points does not make a machine of other errors."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import judge_map
from truepath.alignment.align import align
from truepath.estimation.checks.disturbances import estimate_checked
from truepath.kinematics.coarse_model import build_run_models

POINT = 30


@pytest.fixture(scope="module")
def standing(record):
    """Return a Run's observations, its models, its truth, and what is found in it."""
    run, truth = record(22, "standstill", rows=60)
    seen = align(run)
    models = build_run_models(run.machine, [seen.at])
    return seen, models, truth, estimate_checked(models, [seen])


def judge_moved(standing, rows, by_mm):
    """Return what is found where some rows lie elsewhere, and what it leaves."""
    seen, models, truth, clean = standing
    assert clean.left_out == ((),)
    assert clean.knocks == ()
    moved = seen.tracker_mm.copy()
    moved[rows] += by_mm * np.array([0.6, -0.64, 0.48])
    found = estimate_checked(models, [replace(seen, tracker_mm=moved)])
    left, usual = (
        judge_map(each.estimate, truth.deviation_mm) for each in (found, clean)
    )
    assert left.inside > 0.85
    return found, left.share / usual.share


@pytest.mark.parametrize("off_um", [20.0, 1000.0])
def test_one_point_that_is_off_is_left_out_and_harmless(standing, off_um):
    found, worse = judge_moved(standing, standing[0].row == POINT, 1e-3 * off_um)
    assert {each.row for each in found.left_out[0]} == {POINT}
    assert worse < 1.15


def test_no_machine_bends_to_follow_a_knock_between_few_points(standing):
    found, worse = judge_moved(standing, standing[0].row >= POINT, 2.0)
    (knock,) = found.knocks
    assert knock.row == POINT
    assert 1e3 * knock.moved_mm == pytest.approx(2000.0, abs=3.0)
    assert worse < 1.3
