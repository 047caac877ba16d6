"""The next configuration of several axes against a dense search over all of them."""

import numpy as np
import pytest

from app.kinematics.effects.error_motion import error_motion
from app.kinematics.machine import LinearAxis, Machine, Target, TrackerNoise
from app.kinematics.model import MachineModel
from app.numerics.design_criteria import Belief
from app.numerics.splines import natural_spline
from app.planning.next_configuration import (
    knot_borders,
    next_configuration,
    point_rows,
)

SPLINES = [natural_spline(np.linspace(0.0, 1.0, n)) for n in (5, 6, 7)]
BORDERS = [s.knots for s in SPLINES]
VARIANCE = 1e-4


def stacked(position):
    """Three stacked splines seen as one height (brunn-hanebeck-2005, Figure 6)."""
    return np.hstack([s.basis(position[:, k]) for k, s in enumerate(SPLINES)])


def stacked_belief():
    size = sum(s.size for s in SPLINES)
    gram = np.zeros((size, size))
    begin = 0
    for spline in SPLINES:
        part = slice(begin, begin + spline.size)
        gram[part, part] = spline.gram()
        begin = part.stop
    return Belief(np.eye(size), gram)


def dense(known, rows, borders, ticks):
    grid = np.meshgrid(*[np.linspace(b[0], b[-1], ticks) for b in borders])
    position = np.stack([g.ravel() for g in grid], axis=1)
    return known.drops(rows(position), VARIANCE).max()


def test_each_next_configuration_of_three_stacked_axes_beats_a_dense_search():
    known = stacked_belief()
    for turn in range(8):
        best = next_configuration(known, stacked, BORDERS, VARIANCE, seed=turn)
        assert best.drop >= dense(known, stacked, BORDERS, 41)
        assert best.drop == pytest.approx(
            known.drops(stacked(best.position[None]), VARIANCE)[0]
        )
        known = known.after(stacked(best.position[None])[0], VARIANCE)


def test_the_same_seed_gives_the_same_configuration():
    known = stacked_belief()
    a, b = (next_configuration(known, stacked, BORDERS, VARIANCE) for _ in range(2))
    assert a.position.tolist() == b.position.tolist()


def test_turns_on_their_levers_are_searched_exactly_as_well():
    axes = tuple(LinearAxis(name, 0.0, 400.0) for name in "XYZ")
    machine = Machine(
        "m",
        (),
        ("X", "Y", "Z"),
        axes,
        (Target("T", "tool", (0.0, 0.0, -100.0)),),
        TrackerNoise(),
    )
    motions = tuple(
        error_motion(symbol, axes["XYZ".index(symbol[2])], 4)
        for symbol in ("EXX", "ECX", "EXY", "EBY", "EXZ")
    )
    model = MachineModel(machine, motions)
    sizes = [1e-5 if p.unit == "rad" else 1e-2 for p in model.parameters]
    known = Belief(np.diag(np.square(sizes)), np.diag(np.square(1.0 / np.array(sizes))))
    rows, borders = point_rows(model, np.array([1.0, 0.0, 0.0])), knot_borders(model)
    best = next_configuration(known, rows, borders, VARIANCE)
    assert best.drop >= dense(known, rows, borders, 21)
