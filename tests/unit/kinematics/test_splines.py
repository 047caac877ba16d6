"""Laws of cubic splines as linear maps of their control values."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import CubicSpline as Reference

from truepath.kinematics.splines import cyclic_spline, natural_spline

STEPS = arrays(float, st.integers(3, 9), elements=st.floats(0.5, 4.0))


def knots_of(steps):
    return np.concatenate([[0.0], np.cumsum(steps)])


def values_for(knots):
    return np.random.default_rng(len(knots)).normal(size=len(knots))


@given(STEPS)
@settings(max_examples=40)
def test_a_natural_spline_is_the_one_of_the_textbook(steps):
    knots = knots_of(steps)
    a, t = values_for(knots), np.linspace(knots[0], knots[-1], 101)
    reference = Reference(knots, a, bc_type="natural")
    spline = natural_spline(knots)
    assert np.allclose(spline.basis(t) @ a, reference(t), atol=1e-9)
    assert np.allclose(spline.slope(t) @ a, reference(t, 1), atol=1e-8)


@given(STEPS)
@settings(max_examples=40)
def test_a_cyclic_spline_closes_with_value_slope_and_curvature(steps):
    knots = knots_of(steps)
    period = knots[-1] + 1.5
    a, t = values_for(knots), np.linspace(knots[0], knots[0] + period, 101)
    ends = np.append(knots, knots[0] + period), np.append(a, a[0])
    closed = Reference(*ends, bc_type="periodic")
    spline = cyclic_spline(knots, period)
    assert np.allclose(spline.basis(t) @ a, closed(t), atol=1e-9)
    assert np.allclose(spline.basis(t + 3 * period), spline.basis(t), atol=1e-9)


@given(STEPS)
@settings(max_examples=40)
def test_bending_and_gram_are_the_integrals_they_claim(steps):
    knots = knots_of(steps)
    a = values_for(knots)
    spline, reference = natural_spline(knots), Reference(knots, a, bc_type="natural")
    node, weight = np.polynomial.legendre.leggauss(6)
    square = curvature = 0.0
    for low, high in pairwise(knots):
        t = low + (node + 1) / 2 * (high - low)
        square += (high - low) / 2 * weight @ reference(t) ** 2
        curvature += (high - low) / 2 * weight @ reference(t, 2) ** 2
    assert a @ spline.gram() @ a == pytest.approx(square, rel=1e-9)
    assert a @ spline.bending() @ a == pytest.approx(curvature, rel=1e-9)


def test_a_natural_spline_goes_on_straight_beyond_its_ends():
    spline = natural_spline(np.array([0.0, 1.0, 2.5, 4.0]))
    a = np.array([0.0, 1.0, -1.0, 2.0])
    outside = spline.basis(np.array([4.0, 5.0, 6.0, -1.0, 0.0])) @ a
    assert outside[2] - outside[1] == pytest.approx(outside[1] - outside[0])
    slope = float((spline.slope(np.array([0.0])) @ a)[0])
    assert outside[4] - outside[3] == pytest.approx(slope)


def test_a_stiffness_by_interval_weighs_the_bending_of_each(rng):
    spline = natural_spline(np.array([0.0, 10.0, 25.0, 30.0, 50.0]))
    a, weight = rng.standard_normal(5), np.array([1.0, 0.2, 3.0, 0.0])
    exact = 0.0
    for left, right, w in zip(spline.knots[:-1], spline.knots[1:], weight, strict=True):
        # S'' is straight in an interval: Simpson's rule is exact for its square.
        ends = np.interp([left, right], spline.knots, spline.curvature_map @ a)
        middle = ends.mean()
        exact += w * (right - left) / 6 * (ends[0] ** 2 + 4 * middle**2 + ends[1] ** 2)
    assert a @ spline.bending(weight) @ a == pytest.approx(exact)
    assert spline.bending(np.ones(4)) == pytest.approx(spline.bending())
