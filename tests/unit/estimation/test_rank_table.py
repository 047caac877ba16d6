"""The ranks that geometry allows: one, two, three tool offsets; corner-to-corner paths.

Ranks of the product's own columns, six knots an error motion (108 parameters), the six
rigid motions of the whole volume counted. The numbers are those of linear tables, found
by others' means: they follow from geometry and not from the shape functions.
"""

import itertools

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics import conditions, splines, volumetric_map
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.symbols import list_error_motions
from truepath.kinematics.model import MachineModel

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
