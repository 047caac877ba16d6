"""Splines over several positions, against their definition by one position each."""

import numpy as np
import pytest

from app.numerics.design_criteria import Belief, best_place
from app.numerics.splines import cyclic_spline, natural_spline
from app.numerics.tensor_splines import TensorSpline

ALONG = natural_spline(np.array([0.0, 1.0, 1.7, 3.0]))
AROUND = cyclic_spline(np.array([0.0, 2.0, 4.0]), 6.0)
PLANE = TensorSpline((ALONG, AROUND))


def test_a_plane_passes_through_its_control_values(rng):
    values = rng.normal(size=PLANE.size)
    grid = np.stack(np.meshgrid(ALONG.knots, AROUND.knots, indexing="ij"), -1)
    assert PLANE.basis(grid.reshape(-1, 2)) @ values == pytest.approx(values)


def test_a_product_of_two_splines_is_a_plane(rng):
    a, b = rng.normal(size=ALONG.size), rng.normal(size=AROUND.size)
    at = rng.uniform([0.0, 0.0], [3.0, 6.0], (50, 2))
    product = (ALONG.basis(at[:, 0]) @ a) * (AROUND.basis(at[:, 1]) @ b)
    assert PLANE.basis(at) @ np.outer(a, b).ravel() == pytest.approx(product)


def test_the_gram_matrix_is_the_integral_over_the_plane(rng):
    values = rng.normal(size=PLANE.size)
    x, y = np.linspace(0.0, 3.0, 401), np.linspace(0.0, 6.0, 401)
    at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    square = ((PLANE.basis(at) @ values) ** 2).reshape(401, 401)
    integral = np.trapezoid(np.trapezoid(square, y), x)
    assert values @ PLANE.gram() @ values == pytest.approx(integral, rel=1e-4)


def test_a_plane_bends_as_its_beams_do(rng):
    a, b = rng.normal(size=ALONG.size), rng.normal(size=AROUND.size)
    values = np.outer(a, b).ravel()
    energy = (a @ ALONG.bending() @ a) * (b @ AROUND.gram() @ b)
    energy += (a @ ALONG.gram() @ a) * (b @ AROUND.bending() @ b)
    assert values @ PLANE.bending() @ values == pytest.approx(energy)


def test_along_one_position_the_exact_search_holds(rng):
    known = Belief(np.diag(rng.uniform(0.5, 2.0, PLANE.size)), PLANE.gram())
    known = known.after(PLANE.basis(np.array([[1.2, 3.0]]))[0], 0.01)

    def rows(at):
        return PLANE.basis(np.stack([at, np.full(len(at), 2.5)], axis=1))

    best = best_place(known, rows, ALONG.knots, 0.01)
    dense = known.drops(rows(np.linspace(0.0, 3.0, 30_001)), 0.01)
    assert best.drop == pytest.approx(dense.max(), rel=1e-7)
