"""Cubic splines and sinusoids."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import CubicSpline as Reference

from mills import build_mill
from truepath.kinematics.conditions import RecordedState, make_standstill
from truepath.kinematics.effects.position_wave import PositionWave, ScrewCyclic
from truepath.kinematics.effects.setup_motion import TimeWave, Vibration
from truepath.kinematics.effects.sinusoid import compute_amplitude_and_phase
from truepath.kinematics.machine.machine import LinearAxis
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


SPAN_S = 0.08
RATE_MM_S = np.array([60.0, 0.0, 0.0])


def test_amplitude_and_phase_make_the_same_wave():
    theta = np.array([-0.003, 0.004])
    amplitude, phase = compute_amplitude_and_phase(theta, np.eye(2) * 1e-8)
    at = np.linspace(0.0, 2.0 * np.pi, 9)
    wave = amplitude.value * np.sin(at + phase.value)
    assert wave == pytest.approx(theta[0] * np.sin(at) + theta[1] * np.cos(at))


@pytest.mark.parametrize(
    ("root", "within"),
    [
        (np.array([[1e-4, 0.0], [6e-5, 5e-5]]), 0.02),
        # Known to 0.2 rad: the size leans with the phase, to second order.
        (np.array([[8e-4, 0.0], [-6e-4, 1e-4]]), 0.1),
    ],
    ids=["well known", "badly known phase"],
)
def test_the_uncertainties_are_the_spread_of_what_may_be_found(rng, root, within):
    theta = np.array([0.003, 0.004])
    drawn = theta + rng.standard_normal((20_000, 2)) @ root.T
    amplitude, phase = compute_amplitude_and_phase(theta, root @ root.T)
    spread = np.hypot(*drawn.T).std(), np.arctan2(drawn[:, 1], drawn[:, 0]).std()
    # A spread of 20 000 draws is known to half a per cent.
    assert amplitude.uncertainty == pytest.approx(spread[0], rel=within)
    assert phase.uncertainty == pytest.approx(spread[1], rel=within)


def moving(span_s, count):
    """A machine in motion along X: conditions of one cell, or of moments within it."""
    machine = build_mill((0.0, 0.0, -150.0), sides=("X", "YZ"))
    lag_s = ((np.arange(count) + 0.5) / count - 0.5) * SPAN_S
    position = np.array([[210.0, 40.0, 30.0]]) + lag_s[:, None] * RATE_MM_S
    rate_mm_s, seen_mm = (
        np.tile(v, (count, 1)) for v in (RATE_MM_S, [900.0, 0.0, 0.0])
    )
    since = np.full(count, span_s), np.full((count, 3), np.inf)
    recorded = RecordedState(rate_mm_s, *since, seen_mm, np.eye(3))
    at = make_standstill(machine, position)
    return replace(at, time_s=3.7 + lag_s, recorded=recorded)


@pytest.mark.parametrize(
    "effect",
    [
        Vibration("Y", 7.0, 3.0),
        TimeWave("Z", 0.4, 3.0),
        PositionWave(LinearAxis("X", 0.0, 500.0), "Z", 9.0),
        ScrewCyclic(LinearAxis("X", 0.0, 500.0), 10.0),
    ],
    ids=lambda effect: type(effect).__name__,
)
def test_a_wave_over_a_cell_is_the_mean_of_the_wave_at_its_moments(effect):
    cell = effect.jacobian(moving(SPAN_S, 1))[0]
    moments = effect.jacobian(moving(0.0, 4001))
    assert cell == pytest.approx(moments.mean(axis=0), abs=1e-5)
    assert np.abs(cell).max() < 0.99 * np.abs(moments).max()
