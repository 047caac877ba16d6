"""The worth of a measurement, and its exact optimum against a dense search."""

import numpy as np
import pytest

from app.numerics.design_criteria import Belief, best_place
from app.numerics.splines import cyclic_spline, natural_spline

KNOTS = np.array([0.0, 1.0, 1.7, 3.0, 4.2, 5.0, 6.0])
SPLINE = natural_spline(KNOTS)


def belief(rng, seen=0, variance=0.01):
    """Independent control points, then some measurements at random places."""
    known = Belief(np.diag(rng.uniform(0.5, 2.0, SPLINE.size)), SPLINE.gram())
    for row in SPLINE.basis(rng.uniform(0.0, 6.0, seen)):
        known = known.after(row, variance)
    return known


def test_integrated_variance_is_the_integral_of_the_variance_of_the_spline(rng):
    known = belief(rng, 3)
    at = np.linspace(0.0, 6.0, 20_001)
    rows = SPLINE.basis(at)
    variance = np.einsum("np,pq,nq->n", rows, known.covariance, rows)
    assert known.integrated_variance == pytest.approx(np.trapezoid(variance, at))


def test_a_measurement_lowers_the_integrated_variance_by_what_was_promised(rng):
    known = belief(rng, 2)
    row = SPLINE.basis(np.array([2.3]))
    promised = known.drops(row, 0.01)[0]
    after = known.after(row[0], 0.01)
    fell = known.integrated_variance - after.integrated_variance
    assert fell == pytest.approx(promised, rel=1e-12)


def test_the_order_of_measurements_does_not_matter(rng):
    known = belief(rng)
    a, b = SPLINE.basis(np.array([0.7, 4.9]))
    there = known.after(a, 0.01).after(b, 0.02).covariance
    back = known.after(b, 0.02).after(a, 0.01).covariance
    assert there == pytest.approx(back, abs=1e-12)


@pytest.mark.parametrize("seen", [0, 1, 4, 9])
@pytest.mark.parametrize("variance", [1e-4, 1e-2, 1.0])
def test_the_exact_optimum_is_no_worse_than_a_dense_search(rng, seen, variance):
    known = belief(rng, seen, variance)
    best = best_place(known, SPLINE.basis, KNOTS, variance)
    at = np.linspace(0.0, 6.0, 60_001)
    drops = known.drops(SPLINE.basis(at), variance)
    assert best.drop >= drops.max() * (1.0 - 1e-12)
    assert best.drop == pytest.approx(drops.max(), rel=1e-6)
    there = known.drops(SPLINE.basis(np.array([best.at])), variance)[0]
    assert best.drop == pytest.approx(there, rel=1e-12)


def test_what_other_axes_add_leaves_the_optimum_exact(rng):
    """A stacked axis adds a row that does not change along this one."""
    size = 2 * SPLINE.size
    root = rng.normal(size=(size, size))
    gram = np.kron(np.eye(2), SPLINE.gram())
    known = Belief(root @ root.T, gram)
    other = SPLINE.basis(np.array([3.3]))

    def rows(at):
        return np.hstack([SPLINE.basis(at), np.repeat(other, len(at), axis=0)])

    best = best_place(known, rows, KNOTS, 0.01)
    dense = known.drops(rows(np.linspace(0.0, 6.0, 60_001)), 0.01)
    assert best.drop == pytest.approx(dense.max(), rel=1e-6)


def test_a_cyclic_axis_has_an_exact_optimum_too(rng):
    spline = cyclic_spline(np.array([0.0, 1.0, 2.5, 4.0]), 6.0)
    known = Belief(np.diag([1.0, 2.0, 0.5, 1.5]), spline.gram())
    known = known.after(spline.basis(np.array([0.4]))[0], 0.01)
    best = best_place(known, spline.basis, np.append(spline.knots, 6.0), 0.01)
    dense = known.drops(spline.basis(np.linspace(0.0, 6.0, 60_001)), 0.01)
    assert best.drop == pytest.approx(dense.max(), rel=1e-6)


def test_where_nothing_is_left_to_learn_any_place_will_do():
    known = Belief(np.zeros((SPLINE.size, SPLINE.size)), SPLINE.gram())
    best = best_place(known, SPLINE.basis, KNOTS, 0.01)
    assert best.drop == 0.0
    assert KNOTS[0] <= best.at <= KNOTS[-1]
