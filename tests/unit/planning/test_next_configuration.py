"""The next configuration of several axes against a dense search over all of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from mills import build_mill
from truepath.kinematics import conditions, splines
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.model import MachineModel
from truepath.numerics.design_criteria import IntegratedVariance
from truepath.planning.next_configuration import (
    SearchSpace,
    next_configuration,
    search_space,
)

SPLINES = [splines.natural_spline(np.linspace(0.0, 1.0, n)) for n in (5, 6, 7)]
AXES = SearchSpace(tuple(s.knots for s in SPLINES), (3, 3, 3))
VARIANCE = 1e-4


def stacked(position):
    """Three stacked splines seen as one height (brunn-hanebeck-2005, Figure 6)."""
    return np.hstack([s.basis(position[:, k]) for k, s in enumerate(SPLINES)])


def stacked_belief():
    gram = block_diag(*(spline.gram() for spline in SPLINES))
    return IntegratedVariance(np.eye(len(gram)), gram)


def dense(known, rows, axes, ticks):
    grid = np.meshgrid(*[np.linspace(b[0], b[-1], ticks) for b in axes.borders])
    position = np.stack([g.ravel() for g in grid], axis=1)
    return known.compute_drops(rows(position), VARIANCE).max()


def test_each_next_configuration_of_three_stacked_axes_beats_a_dense_search():
    known = stacked_belief()
    for turn in range(8):
        best = next_configuration(known, stacked, AXES, VARIANCE, seed=turn)
        assert best.drop >= dense(known, stacked, AXES, 41)
        there = known.compute_drops(stacked(best.position[None]), VARIANCE)[0]
        assert best.drop == pytest.approx(there)
        known = known.update(stacked(best.position[None])[0], VARIANCE)


def test_the_answer_is_no_worse_than_the_dense_search_and_the_same_again():
    known = stacked_belief()
    best = next_configuration(known, stacked, AXES, VARIANCE)
    assert best.drop >= best.searched > 0.9 * best.drop
    again = next_configuration(known, stacked, AXES, VARIANCE)
    assert best.position.tolist() == again.position.tolist()


def mill(*rotary):
    made = build_mill((0.0, 0.0, -100.0), travel_mm=(400.0, 400.0, 400.0))
    names = tuple(axis.name for axis in rotary)
    return replace(made, workpiece_side=names, axes=(*made.axes, *rotary))


def believed(model):
    sizes = np.array([1e-5 if p.unit == "rad" else 1e-2 for p in model.parameters])
    return IntegratedVariance(np.diag(sizes**2), np.diag(sizes**-2.0))


def motions(machine, symbols):
    axes = {axis.name: axis for axis in machine.axes}
    made = (make_error_motion(symbol, axes[symbol[2]], 4) for symbol in symbols)
    return MachineModel(machine, tuple(made))


def point_rows(model, direction=None):
    def rows(position):
        columns = model.jacobian(conditions.make_standstill(model.machine, position))
        return columns if direction is None else np.einsum("nip,i", columns, direction)

    return rows


@pytest.mark.parametrize("direction", [np.array([1.0, 0.0, 0.0]), None])
def test_turns_on_their_levers_are_searched_exactly_as_well(direction):
    model = motions(mill(), ("EXX", "ECX", "EXY", "EBY", "EXZ"))
    known, axes = believed(model), search_space(model)
    rows = point_rows(model, direction)
    best = next_configuration(known, rows, axes, VARIANCE)
    assert best.drop >= dense(known, rows, axes, 21)


def test_rotary_axes_are_searched_between_their_knots_too():
    table = RotaryAxis("C", 0.0, 360.0, (200.0, 200.0, 0.0), (0.0, 0.0, 1.0))
    model = motions(mill(table), ("EXX", "ECX", "EXC", "EAC", "ECC"))
    known, axes = believed(model), search_space(model)
    rows = point_rows(model)
    best = next_configuration(known, rows, axes, VARIANCE)
    there = known.compute_drops(rows(best.position[None]), VARIANCE)[0]
    assert best.drop == pytest.approx(there, rel=1e-6)
    assert best.drop >= dense(known, rows, axes, 13)
