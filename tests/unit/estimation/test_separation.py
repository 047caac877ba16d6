"""What data do not tell or hardly: its names, and the tool that would tell it."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mills import build_mill
from truepath.estimation.problem import normal_equations
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.observability import (
    describe_confounded,
    describe_form,
    detect_poorly_observable,
    typical_precision_matrix,
)
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.planning.grade import grade
from truepath.planning.lines.default_path import default_path
from truepath.planning.simulated_cells import EXPECTED_NOISE, predict_cells

STATION_MM = np.array([-900.0, 200.0, 100.0])
SAID = re.compile(r"at least (\d+) mm .* separates them \(to ([\d.]+) µrad, k = 2")


FIRST = (30.0, 20.0, -100.0)
OFFSET = (20.0, 30.0, -100.0)
MILL = build_mill(OFFSET, travel_mm=(600.0, 500.0, 400.0))
X = MILL.linear_axes[0]


def mill(*offsets):
    return build_mill(*offsets, travel_mm=(250.0, 200.0, 150.0))


def graded(machine, path=None, **options):
    path = path or default_path(machine, **options)
    return grade(machine, path, station_mm=STATION_MM)


@cache
def statements(machine, **options):
    return {s[:3]: s for s in graded(machine, **options).unobservable}


def table_sigma(machine, path, symbol):
    seen = predict_cells(machine, path, STATION_MM)
    model, _ = build_identifiable_model(machine, seen.at.offset_mm, intervals=10)
    base = linearise(seen, model, seen.pose, EXPECTED_NOISE)
    data = normal_equations.compute_information(seen, base)
    prior = np.diag(np.full(model.size + 6, 1e-2))
    prior[: model.size, : model.size] = typical_precision_matrix(model)
    part = model.slices[symbol]
    covariance = compute_posterior(data, prior).covariance[part, part]
    motion = next(e for e in model.effects if e.name == symbol)
    rows = motion.rows(np.linspace(motion.axis.low, motion.axis.high, 25))
    return np.sqrt(np.einsum("np,pq,nq->n", rows, covariance, rows).mean())


def driven_with_both(path):
    columns = ("position", "feed_mm_min", "dwell_s")
    twice = {name: np.concatenate([getattr(path, name)] * 2) for name in columns}
    return replace(path, **twice, target=("T1",) * len(path) + ("T2",) * len(path))


@pytest.mark.parametrize("symbol", ["EBZ", "ECZ"])
def test_the_second_tool_tells_the_turn_as_well_as_promised(symbol):
    length, expanded = SAID.search(statements(mill(FIRST))[symbol]).groups()
    way = np.array([0.6, 0.8, 0.0] if symbol == "ECZ" else [0.0, 0.0, -1.0])
    second = tuple((np.array(FIRST) + float(length) * way).tolist())
    machine = mill(FIRST, second)
    path = driven_with_both(default_path(machine))
    promised = 0.5e-6 * float(expanded)
    assert table_sigma(machine, path, symbol) == pytest.approx(promised, rel=0.35)


def test_statements_name_partners_and_length_or_that_a_target_has_to_move_aside():
    said = statements(mill(FIRST))
    assert set(said) == {"ECY", "EAZ", "EBZ", "ECZ"}
    assert "EBZ (turn of Z about Y) is not distinguishable from EXZ" in said["EBZ"]
    assert "a second tool at least" in said["EBZ"]
    assert "to the side, in X or Y," in said["ECZ"]
    said = statements(mill((0.0, 0.0, -100.0)))
    assert "does not move the target" in said["ECZ"]
    assert "to the side, in X or Y, shows it" in said["ECZ"]
    # And that alone where two lengths of tools are measured.
    machine = mill((0.0, 0.0, -100.0), (0.0, 0.0, -250.0))
    path = driven_with_both(default_path(machine))
    said = graded(machine, path).unobservable
    assert [s[:3] for s in said] == ["ECY", "ECZ"]
    assert all("to the side" in s for s in said)


def test_longer_tools_are_asked_for_where_less_is_measured():
    machine = mill(FIRST)
    said = (statements(machine, lines=n)["EBZ"] for n in (14, 40))
    numbers = ([float(x) for x in SAID.search(one).groups()] for one in said)
    few, many = map(np.prod, numbers)
    assert few > 1.3 * many  # length times uncertainty: √2 u of EXZ


def test_a_table_that_no_target_sits_on_is_asked_for_targets_there():
    table = RotaryAxis("C", 0.0, 360.0, (250.0, 200.0, 0.0), (0.0, 0.0, 1.0))
    own = {"axes": (*mill(FIRST).axes, table), "workpiece_side": ("C",)}
    tracker = TrackerNoise(stands_on="base")
    mill_with_table = replace(mill(FIRST), **own, tracker=tracker)
    said = statements(mill_with_table)
    for symbol in ("EXC", "EAC", "ECC", "XOC", "AOC"):
        assert "targets on the workpiece, three off one line" in said[symbol]
    assert "a second tool at least" in said["EBZ"]


def test_where_hardly_anything_is_told_no_length_of_a_tool_is_asked_for():
    machine = mill((0.0, 0.0, -150.0))
    offsets = np.array([[0.0, 0.0, -150.0]])
    model, merged = build_identifiable_model(machine, offsets, intervals=5)
    poor = np.eye(model.size) * 0.1**2  # mm: of displacements of some 10 µm
    for said in describe_confounded(offsets, merged, model, poor):
        assert "at least" not in said
        assert "determine too little for any tool" in said


def test_a_set_up_for_another_tool_is_worth_less_than_for_its_own():
    own = mill(FIRST)
    path = default_path(own)
    aside = mill((0.0, 0.0, -400.0), FIRST)
    other = replace(path, target=("T2",) * len(path))
    assert graded(aside, other).number > 3.0 * graded(own, path).number


def told_but(model, shape, left):
    root = np.linalg.cholesky(typical_precision_matrix(model))
    direction = root.T @ shape
    direction /= np.linalg.norm(direction)
    size = model.size
    rest = np.eye(size) - np.outer(direction, direction)
    inner = 1e6 * rest + (left**-2 - 1.0) * np.outer(direction, direction)
    return root @ inner @ root.T


def shape_of(model, symbol):
    return np.eye(model.size)[model.slices[symbol].start]


def test_what_the_data_leave_of_a_usual_machine_is_named_with_its_size():
    model, _ = build_identifiable_model(MILL, np.array([OFFSET]), intervals=5)
    gram = compute_volumetric_gram(model)
    shape = shape_of(model, "EYY")
    (found,) = detect_poorly_observable(told_but(model, shape, 0.8), model, gram)
    assert found.symbols == ("EYY",)
    assert found.remaining == pytest.approx(0.8, rel=1e-3)
    assert str(found).startswith("EYY: ")
    assert "80 % of what a usual machine may have stays open" in str(found)
    assert detect_poorly_observable(told_but(model, shape, 0.3), model, gram) == ()
    untold = told_but(model, shape, 1.0)  # others name what is exactly unknown
    assert len(detect_poorly_observable(untold, model, gram)) == 1
    assert detect_poorly_observable(untold, model, gram, blind=False) == ()
    shape = shape_of(model, "EXX") + 0.8 * shape_of(model, "EZZ")
    (found,) = detect_poorly_observable(told_but(model, shape, 0.9), model, gram)
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
