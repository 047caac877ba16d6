"""Lost motion is found where it is, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate
from truepath.alignment.align import align
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.backlash import make_half_shape, make_half_width
from truepath.kinematics.machine.machine import LinearAxis
from truepath.results.error_tables import compute_half_differences

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
