"""What geometry and data tell: ranks, names, and the tool or target that would."""

import itertools
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
from truepath.kinematics import conditions, splines, volumetric_map
from truepath.kinematics.effects.error_motion import ErrorMotion, make_error_motion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import RotaryAxis
from truepath.kinematics.machine.symbols import list_error_motions
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.planning.default_path import default_path
from truepath.planning.grade import grade
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


KNOTS = 6
ONE = [(0.0, 0.0, -100.0)]
TWO = [*ONE, (0.0, 0.0, -250.0)]
THREE = [*ONE, (80.0, 0.0, -200.0), (0.0, 80.0, -300.0)]
TRAVELS = [(600.0, 600.0, 600.0), (600.0, 500.0, 400.0)]

CORNERS = [np.array(c, float) for c in itertools.product([0, 1], repeat=3)]
CORNER_LINES = list(itertools.combinations(CORNERS, 2))
MID_LINES = [(0.5 - 0.5 * along, 0.5 + 0.5 * along) for along in np.eye(3)]
OBLIQUE = [(np.zeros(3), np.array([0.6, 1.0, 0.0]))]
CHAINS = [("", "XYZ"), ("X", "YZ"), ("Y", "XZ"), ("XY", "Z"), ("Z", "XY"), ("XYZ", "")]


def every_motion(travel):
    of = build_mill(ONE[0], travel_mm=travel)
    motions = []
    for axis in of.linear_axes:
        spline = splines.natural_spline(np.linspace(axis.low, axis.high, KNOTS))
        for symbol in list_error_motions(axis.name):
            motions.append(ErrorMotion(symbol, axis, spline, np.eye(KNOTS)))
    return MachineModel(of, tuple(motions))


def rank(rows):
    flat = rows.reshape(-1, rows.shape[-1])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
    value = np.linalg.svd(flat, compute_uv=False)
    return int((value > 1e-9 * value[0]).sum())


def on_lines(model, lines, travel, points=60):
    share = (np.arange(points) + 0.5) / points
    full, across = [], []
    for begin, end in lines:
        at = (begin + share[:, None] * (end - begin)) * np.array(travel)
        direction = (end - begin) * np.array(travel)
        direction /= np.linalg.norm(direction)
        columns = model.jacobian(conditions.make_standstill(model.machine, at))
        along = np.einsum("d,ndp->np", direction, columns)
        full.append(columns)
        across.append(columns - direction[:, None] * along[:, None, :])
    return np.concatenate(full), np.concatenate(across)


@pytest.mark.parametrize("travel", TRAVELS)
@pytest.mark.parametrize(("offsets", "expected"), [(ONE, 73), (TWO, 85), (THREE, 96)])
@pytest.mark.fault_row(39)
def test_rank_of_one_two_or_three_offsets(rng, travel, offsets, expected, measured):
    model = every_motion(travel)
    position = rng.uniform(0.0, 1.0, (400, 3)) * np.array(travel)
    told = ((model.machine, position, np.tile(o, (400, 1))) for o in offsets)
    rows = [model.jacobian(conditions.make_standstill(*one)) for one in told]
    found = rank(np.concatenate(rows))
    assert found == expected
    measured(f"target offsets: {len(offsets)}, rank {found} of 108")


@pytest.mark.parametrize("travel", TRAVELS)
@pytest.mark.parametrize(
    ("lines", "expected"),
    [(CORNER_LINES, 71), (CORNER_LINES + MID_LINES, 71), (CORNER_LINES + OBLIQUE, 73)],
)
def test_rank_of_corner_paths_with_or_without_another_line(travel, lines, expected):
    model = every_motion(travel)
    full, across = on_lines(model, lines, travel)
    assert rank(full) == 73
    assert rank(across) == expected


@pytest.mark.parametrize("travel", TRAVELS)
def test_the_blind_shape_is_one_that_all_axes_share_and_lies_along_the_lines(travel):
    model = every_motion(travel)
    full, across = on_lines(model, CORNER_LINES, travel)
    share = np.arange(KNOTS) / (KNOTS - 1)
    shape = np.zeros(model.size)
    for k, axis in enumerate("XYZ"):
        part = model.slices[f"E{axis}{axis}"]
        shape[part] = travel[k] * np.sin(2 * np.pi * share)
    assert np.abs(across @ shape).max() < 1e-12 * np.abs(full @ shape).max()
    # What lies along, less a straight line a pass: phase and speed of each are free.
    along = (full - across).reshape(len(CORNER_LINES), 60, 3, -1)
    law = np.stack([np.ones(60), np.linspace(-1.0, 1.0, 60)], axis=1)
    free = np.eye(60) - law @ np.linalg.pinv(law)
    curved = np.einsum("ab,lbdp->ladp", free, along).reshape(full.shape)
    assert rank(np.concatenate([across, curved])) == 73


@pytest.mark.parametrize("sides", CHAINS)
@pytest.mark.parametrize(
    ("offsets", "known", "rank"), [(ONE, 14, 67), (TWO, 16, 77), (THREE, 18, 87)]
)
def test_tool_offsets_say_how_many_motions_are_told_apart(sides, offsets, known, rank):
    # Ranks 73, 85, 96, less six of the whole volume and the turns of how targets sit.
    last = "XYZ".index("".join(sides)[-1])
    lengths = np.roll(np.array(offsets), last - 2, axis=1)  # along the last axis
    mill = build_mill(ONE[0], sides=sides, travel_mm=TRAVELS[0])
    model, merged = build_identifiable_model(mill, lengths, intervals=5)
    motions = model.identifiable_motions
    shares = ("another tool length", "does not move the target")
    assert all(any(said in str(one) for said in shares) for one in merged)
    assert len(motions) == known
    assert len(motions) + len(merged) == 18
    assert model.size == rank + 3 * (len(offsets) - 1)


def test_how_other_targets_sit_is_no_error_of_the_first_one():
    # T1 is the last in any order of coordinates.
    offsets = [(60.0, 50.0, -20.0), (0.0, 0.0, -200.0), (0.0, 60.0, -90.0)]
    mill = build_mill(*offsets, travel_mm=TRAVELS[0])
    model, _ = build_identifiable_model(mill, np.array(offsets), intervals=4)
    seats = [name for name in model.slices if name.startswith("seat")]
    assert seats == ["seat-T2", "seat-T3"]
    for name, at in zip(("T1", "T2", "T3"), offsets, strict=True):
        still = conditions.make_standstill(mill, np.full((1, 3), 50.0), np.array([at]))
        moved = {s: model.jacobian(still)[:, :, model.slices[s]].any() for s in seats}
        assert moved == {s: s == f"seat-{name}" for s in seats}
        error = volumetric_map.build_volumetric_map(model, name).jacobian(still)
        assert not any(error[:, :, model.slices[s]].any() for s in seats)
