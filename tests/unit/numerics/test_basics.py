"""Rigid motions, Sobol points, the index of air, and equality of values."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from truepath.kinematics.splines import natural_spline
from truepath.numerics.air_index import compute_air_index
from truepath.numerics.rigid import RigidTransform, cross_matrix, fit_rigid
from truepath.numerics.sobol import MOST_DIMENSIONS, compute_sobol_points
from truepath.numerics.value_equality import ValueEquality


@pytest.fixture
def motion(rng):
    rotation = Rotation.random(rng=rng).as_matrix()
    return RigidTransform(rotation, np.array([300.0, -200.0, 50.0]))


@pytest.fixture
def points(rng):
    return rng.uniform(0, 500, (10, 3))


def test_motions_are_undone_and_small_ones_precede_the_pose(points, motion, rng):
    assert np.allclose(motion.invert().apply(motion.apply(points)), points)
    rotation, translation = np.array([1e-5, -2e-5, 3e-5]), np.array([0.01, -0.02, 0.03])
    moved = motion.apply(points + np.cross(rotation, points) + translation)
    small_first = motion.precede_small(rotation, translation)
    assert np.allclose(small_first.apply(points), moved, atol=1e-6)
    turn = rng.normal(size=3)
    assert np.allclose(cross_matrix(points) @ turn, np.cross(turn, points))


def test_a_rigid_motion_is_found_and_a_mirror_image_when_asked(points, motion):
    found = fit_rigid(points, motion.apply(points))
    assert np.allclose(found.rotation, motion.rotation, atol=1e-12)
    assert np.allclose(found.translation_mm, motion.translation_mm, atol=1e-9)
    mirrored = motion.apply(points * [1, 1, -1])
    fits = (fit_rigid(points, mirrored, mirrored=flag) for flag in (False, True))
    proper, improper = (np.abs(fit.apply(points) - mirrored).max() for fit in fits)
    assert improper < 1e-9
    assert proper > 10.0


@pytest.mark.parametrize("dimensions", range(1, MOST_DIMENSIONS + 1))
@pytest.mark.parametrize("count", [1, 2, 256])
def test_points_are_those_of_scipy(dimensions, count):
    expected = qmc.Sobol(dimensions, rng=np.random.default_rng(0)).random(count)
    assert np.array_equal(compute_sobol_points(dimensions, count), expected)


def index_of(wavelength_nm, degc, hpa, percent, *, is_group=False):
    state = (np.array([float(value)]) for value in (degc, hpa, percent))
    return float(compute_air_index(wavelength_nm, *state, is_group=is_group)[0])


@pytest.mark.parametrize(
    ("wavelength_nm", "degc", "hpa", "percent", "published"),
    [  # the calculator of NIST's engineering metrology toolbox, Ciddor, 450 ppm of CO2
        (321.456, 20, 1013.25, 50, 1.000283543),
        (500.0, 20, 1013.25, 50, 1.000273781),
        (633.0, 20, 1013.25, 50, 1.000271373),
        (700.0, 20, 1013.25, 50, 1.000270657),
        (1000.987, 20, 1013.25, 50, 1.000269038),
        (1500.8, 20, 1013.25, 50, 1.000268190),
        (633.0, 20, 1013.25, 0, 1.000271800),
        (633.0, 0, 1013.25, 0, 1.000291767),
        (633.0, 40, 1013.25, 0, 1.000254398),
        (633.0, 20, 500.0, 0, 1.000134099),
        (633.0, 20, 1200.0, 0, 1.000321916),
    ],
)
def test_the_phase_index_is_that_of_nist(wavelength_nm, degc, hpa, percent, published):
    found = index_of(wavelength_nm, degc, hpa, percent)
    assert found == pytest.approx(published, abs=1.1e-9)


@pytest.mark.parametrize("wavelength_nm", [670.0, 780.0, 850.0, 1310.0])
def test_the_group_index_is_that_of_the_geodesists(wavelength_nm):
    """IUGG 1999, resolution 3: dry air at 0 °C, 1013.25 hPa, 375 ppm of CO2."""
    um = 1e-3 * wavelength_nm
    ppm = 287.6155 + 4.88660 / um**2 + 0.06800 / um**4
    found = 1e6 * (index_of(wavelength_nm, 0, 1013.25, 0, is_group=True) - 1.0)
    assert found == pytest.approx(ppm, abs=0.03)  # 75 ppm of CO2 are 0.012


@pytest.mark.parametrize("percent", [0.0, 80.0])
def test_the_group_index_is_that_of_its_definition(percent):
    wavelength_nm, step_nm = 780.0, 0.01
    light_nm = wavelength_nm + step_nm, wavelength_nm - step_nm
    ends = [index_of(one, 25, 990, percent) for one in light_nm]
    slope = (ends[0] - ends[1]) / (2 * step_nm)
    expected = index_of(wavelength_nm, 25, 990, percent) - wavelength_nm * slope
    group = index_of(wavelength_nm, 25, 990, percent, is_group=True)
    assert group == pytest.approx(expected, abs=2e-11)


@dataclass(frozen=True)
class Record(ValueEquality):
    values: np.ndarray
    inner: object
    keys: dict


def a_record(last=3.0):
    knots = np.array([0.0, 1.0, last])
    return Record(np.array([1.0, 2.0]), natural_spline(knots), {"axis": "X"})


def test_equal_content_is_equal_and_hashes_alike_and_other_content_is_not():
    assert a_record() == a_record()
    assert hash(a_record()) == hash(a_record())
    assert a_record() != a_record(last=4.0)
    assert a_record() != replace(a_record(), keys={"axis": "Y"})
    assert a_record() != replace(a_record(), values=np.array([1.0, 2.5]))
