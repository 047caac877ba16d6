"""The worth of a measurement, and its exact optimum against a dense search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.kinematics.splines import cyclic_spline, natural_spline
from truepath.numerics.design_criteria import IntegratedVariance, find_best_position

KNOTS = np.array([0.0, 1.0, 1.7, 3.0, 4.2, 5.0, 6.0])
SPLINE = natural_spline(KNOTS)
CASES = {
    "knots": st.lists(st.floats(0.1, 3.0), min_size=2, max_size=12),
    "seed": st.integers(0, 2**32 - 1),
    "seen": st.integers(0, 14),
    "log_variance": st.floats(-6.0, 0.5),
    "values": st.integers(1, 3),
}


def belief(rng, seen, variance=0.01, spline=SPLINE):
    prior = np.diag(rng.uniform(0.1, 2.0, spline.size))
    known = IntegratedVariance(prior, spline.gram())
    for row in spline.basis(rng.uniform(0.0, spline.knots[-1], seen)):
        known = known.update(row, variance)
    return known


def test_integrated_variance_is_the_integral_of_the_variance_of_the_spline(rng):
    known = belief(rng, 3)
    at = np.linspace(0.0, 6.0, 20_001)
    rows = SPLINE.basis(at)
    variance = np.einsum("np,pq,nq->n", rows, known.covariance, rows)
    assert known.integrated_variance == pytest.approx(np.trapezoid(variance, at))


def a_case(knots, seed, seen, log_variance, values):
    spline = natural_spline(np.concatenate([[0.0], np.cumsum(knots)]))
    rng = np.random.default_rng(seed)
    known = belief(rng, seen, 10.0**log_variance, spline)
    turn = rng.normal(size=(values, spline.size, spline.size))
    mix = np.eye(spline.size) if values == 1 else turn / spline.size

    def rows(at):
        found = np.einsum("np,rpq->nrq", spline.basis(at), np.atleast_3d(mix.T).T)
        return found[:, 0] if values == 1 else found

    return known, rows, spline.knots, 10.0**log_variance


def search_densely(known, rows, borders, variance, points=10_000):
    at, step = np.linspace(borders[0], borders[-1], points, retstep=True)
    drop = known.compute_drops(rows(at), variance)
    beside = np.pad(drop, 1, constant_values=-np.inf)
    is_peak = (drop >= beside[:-2]) & (drop >= beside[2:])
    peaks = at[is_peak & (drop >= 0.9 * drop.max())][:, None]
    for _ in range(2):
        near = peaks + step * np.linspace(-1.0, 1.0, 201)
        near = np.clip(near, borders[0], borders[-1])
        drop = known.compute_drops(rows(near.ravel()), variance).reshape(near.shape)
        peaks = np.take_along_axis(near, drop.argmax(axis=1)[:, None], axis=1)
        step /= 100.0
    return drop.max()


def assert_exact(known, rows, knots, variance):
    best = find_best_position(known, rows, knots, variance)
    searched = search_densely(known, rows, knots, variance)
    assert abs(best.drop - searched) <= 1e-9 * known.integrated_variance
    there = known.compute_drops(rows(np.array([best.at])), variance)[0]
    assert best.drop == pytest.approx(there, rel=1e-9)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("cases", [60, pytest.param(500, marks=pytest.mark.long)])
def test_the_exact_optimum_equals_a_dense_search(cases):
    @given(**CASES)
    @settings(deadline=None, max_examples=cases)
    def check(**case):
        assert_exact(*a_case(**case))

    check()


def test_values_measured_at_once_tell_what_they_tell_one_by_one(rng):
    known = belief(rng, 2)
    rows = SPLINE.basis(np.array([0.7, 4.9, 5.1]))
    at_once = known.update(rows, 0.01)
    for order in (rows, rows[::-1]):
        one_by_one = known
        for row in order:
            one_by_one = one_by_one.update(row, 0.01)
        assert at_once.covariance == pytest.approx(one_by_one.covariance, abs=1e-12)
    promised = known.compute_drops(rows[None], 0.01)[0]
    fell = known.integrated_variance - at_once.integrated_variance
    assert fell == pytest.approx(promised, rel=1e-12)


def test_a_cyclic_axis_and_one_beside_others_have_an_exact_optimum_too(rng):
    spline = cyclic_spline(np.array([0.0, 1.0, 2.5, 4.0]), 6.0)
    known = IntegratedVariance(np.diag([1.0, 2.0, 0.5, 1.5]), spline.gram())
    known = known.update(spline.basis(np.array([0.4]))[0], 0.01)
    assert_exact(known, spline.basis, np.append(spline.knots, 6.0), 0.01)
    # A stacked axis adds a row that does not change along this one.
    size = 2 * SPLINE.size
    root = rng.normal(size=(size, size))
    known = IntegratedVariance(root @ root.T, np.kron(np.eye(2), SPLINE.gram()))
    other = SPLINE.basis(np.array([3.3]))

    def rows(at):
        return np.hstack([SPLINE.basis(at), np.repeat(other, len(at), axis=0)])

    assert_exact(known, rows, KNOTS, 0.01)


def test_where_nothing_is_left_to_learn_any_place_will_do():
    known = IntegratedVariance(np.zeros((SPLINE.size, SPLINE.size)), SPLINE.gram())
    best = find_best_position(known, SPLINE.basis, KNOTS, 0.01)
    assert best.drop == 0.0
    assert KNOTS[0] <= best.at <= KNOTS[-1]
