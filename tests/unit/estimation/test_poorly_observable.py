"""Shapes that are told, but hardly: found by what they leave, named by their form."""

import numpy as np
import pytest

from mills import build_mill
from truepath.estimation.problem.observability import (
    describe_form,
    find_poorly_observable,
    usual_precision_matrix,
)
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.volumetric_map import compute_volumetric_gram

OFFSET = (20.0, 30.0, -100.0)
MILL = build_mill(OFFSET, travel_mm=(600.0, 500.0, 400.0))
X = MILL.linear_axes[0]


@pytest.fixture(scope="module")
def known():
    """A model and its Gram matrix."""
    model, _ = build_identifiable_model(MILL, np.array([OFFSET]), intervals=5)
    return model, compute_volumetric_gram(model)


def told_but(model, shape, left):
    """Return information that leaves a share of the usual deviation of one shape."""
    root = np.linalg.cholesky(usual_precision_matrix(model))
    direction = root.T @ shape
    direction /= np.linalg.norm(direction)
    size = model.size
    rest = np.eye(size) - np.outer(direction, direction)
    inner = 1e6 * rest + (left**-2 - 1.0) * np.outer(direction, direction)
    return root @ inner @ root.T


def shape_of(model, symbol):
    """Return that which bends least."""
    return np.eye(model.size)[model.slices[symbol].start]


def test_what_the_data_leave_of_a_usual_machine_is_named_with_its_size(known):
    model, gram = known
    shape = shape_of(model, "EYY")
    (found,) = find_poorly_observable(told_but(model, shape, 0.8), model, gram)
    assert found.symbols == ("EYY",)
    assert found.remaining == pytest.approx(0.8, rel=1e-3)
    assert str(found).startswith("EYY: ")
    assert "80 % of what a usual machine may have stays open" in str(found)
    assert find_poorly_observable(told_but(model, shape, 0.3), model, gram) == ()
    untold = told_but(model, shape, 1.0)  # others name what is exactly unknown
    assert len(find_poorly_observable(untold, model, gram)) == 1
    assert find_poorly_observable(untold, model, gram, blind=False) == ()


def test_motions_that_share_a_shape_are_named_together(known):
    model, gram = known
    shape = shape_of(model, "EXX") + 0.8 * shape_of(model, "EZZ")
    (found,) = find_poorly_observable(told_but(model, shape, 0.9), model, gram)
    assert found.symbols == ("EXX", "EZZ")


@pytest.mark.parametrize(
    ("shape", "name"),
    [
        (lambda s: s, "a slope"),
        (lambda s: (s - 0.5) ** 2, "a bow"),
        (lambda s: np.sin(2 * np.pi * s), "an S"),
        (lambda s: np.sin(6 * np.pi * s), "a wave"),
    ],
)
def test_a_shape_is_called_by_what_it_looks_like(shape, name):
    motion = make_error_motion("EXX", X, 24)
    at = np.linspace(X.low, X.high, 200)
    value = shape(at / X.high)
    theta = np.linalg.lstsq(motion.rows(at), value - value[0], rcond=None)[0]
    assert describe_form(motion, theta) == f"{name} of the error along X"
