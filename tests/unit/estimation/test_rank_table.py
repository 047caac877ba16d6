"""The ranks that geometry allows: one, two, three tool offsets; corner-to-corner paths.

Ranks of the product's own columns, six knots an error motion (108 parameters), the six
rigid motions of the whole volume counted. The numbers are those of linear tables, found
by others' means: they follow from geometry and not from the shape functions.
"""

import itertools

import numpy as np
import pytest

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.symbols import list_error_motions
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.model import MachineModel
from truepath.kinematics.splines import natural_spline

KNOTS = 6
ONE = [(0.0, 0.0, -100.0)]
TWO = [*ONE, (0.0, 0.0, -250.0)]
THREE = [*ONE, (80.0, 0.0, -200.0), (0.0, 80.0, -300.0)]
TRAVELS = [(600.0, 600.0, 600.0), (600.0, 500.0, 400.0)]

CORNERS = [np.array(c, float) for c in itertools.product([0, 1], repeat=3)]
CORNER_LINES = list(itertools.combinations(CORNERS, 2))
MID_LINES = [
    (np.where(np.eye(3)[k], 0.0, 0.5), np.where(np.eye(3)[k], 1.0, 0.5))
    for k in range(3)
]
OBLIQUE = [(np.zeros(3), np.array([0.6, 1.0, 0.0]))]


def machine(travel):
    axes = tuple(LinearAxis(a, 0.0, t) for a, t in zip("XYZ", travel, strict=True))
    target = Target("T", "tool", ONE[0])
    return Machine("m", (), ("X", "Y", "Z"), axes, (target,), TrackerNoise())


def every_motion(of):
    """All 18 error motions without any gauge."""
    motions = []
    for axis in of.linear_axes:
        spline = natural_spline(np.linspace(axis.low, axis.high, KNOTS))
        motions += [
            ErrorMotion(symbol, axis, spline, np.eye(KNOTS))
            for symbol in list_error_motions(axis.name)
        ]
    return MachineModel(of, tuple(motions))


def rank(rows):
    flat = rows.reshape(-1, rows.shape[-1])
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-12)
    value = np.linalg.svd(flat, compute_uv=False)
    return int((value > 1e-9 * value[0]).sum())


def on_lines(model, lines, travel, points=60):
    """Columns at points of the lines, and the same without what lies along them."""
    share = (np.arange(points) + 0.5) / points
    full, across = [], []
    for begin, end in lines:
        at = (begin + share[:, None] * (end - begin)) * np.array(travel)
        direction = (end - begin) * np.array(travel)
        direction /= np.linalg.norm(direction)
        columns = model.jacobian(make_standstill(model.machine, at))
        along = np.einsum("d,ndp->np", direction, columns)
        full.append(columns)
        across.append(columns - direction[:, None] * along[:, None, :])
    return np.concatenate(full), np.concatenate(across)


@pytest.mark.parametrize("travel", TRAVELS)
@pytest.mark.parametrize(("offsets", "expected"), [(ONE, 73), (TWO, 85), (THREE, 96)])
@pytest.mark.fault_row(39)
def test_rank_of_one_two_and_three_tool_offsets(
    rng, travel, offsets, expected, measured
):
    model = every_motion(machine(travel))
    position = rng.uniform(0.0, 1.0, (400, 3)) * np.array(travel)
    rows = [
        model.jacobian(make_standstill(model.machine, position, np.tile(o, (400, 1))))
        for o in offsets
    ]
    found = rank(np.concatenate(rows))
    assert found == expected
    measured(f"target offsets: {len(offsets)}, rank {found} of 108")


@pytest.mark.parametrize("travel", TRAVELS)
@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (CORNER_LINES, 71),
        (CORNER_LINES + MID_LINES, 71),
        (CORNER_LINES + OBLIQUE, 73),
    ],
)
def test_rank_of_corner_paths_with_and_without_a_line_that_is_none(
    travel, lines, expected
):
    model = every_motion(machine(travel))
    full, across = on_lines(model, lines, travel)
    assert rank(full) == 73
    assert rank(across) == expected


@pytest.mark.parametrize("travel", TRAVELS)
def test_the_blind_shape_is_one_positioning_error_that_all_axes_share(travel):
    model = every_motion(machine(travel))
    full, across = on_lines(model, CORNER_LINES, travel)
    share = np.arange(KNOTS) / (KNOTS - 1)
    shape = np.zeros(model.size)
    for k, axis in enumerate("XYZ"):
        part = model.slices[f"E{axis}{axis}"]
        shape[part] = travel[k] * np.sin(2 * np.pi * share)
    assert np.abs(across @ shape).max() < 1e-12 * np.abs(full @ shape).max()


@pytest.mark.parametrize("travel", TRAVELS)
def test_phase_and_speed_of_each_line_left_free_cost_no_rank(travel):
    """What lies along, less a straight line a pass, restores what corners hide."""
    model = every_motion(machine(travel))
    full, across = on_lines(model, CORNER_LINES, travel)
    along = (full - across).reshape(len(CORNER_LINES), 60, 3, -1)
    law = np.stack([np.ones(60), np.linspace(-1.0, 1.0, 60)], axis=1)
    free = np.eye(60) - law @ np.linalg.pinv(law)
    curved = np.einsum("ab,lbdp->ladp", free, along).reshape(full.shape)
    assert rank(np.concatenate([across, curved])) == 73


@pytest.mark.parametrize(
    ("offsets", "turns", "expected"), [(ONE, 0, 73), (TWO, 2, 85), (THREE, 3, 96)]
)
def test_the_model_that_is_solved_has_this_rank_less_the_rigid_motions(
    offsets, turns, expected
):
    """Those of the volume, and of the targets where their places are known exactly."""
    model, _ = build_identifiable_model(
        machine(TRAVELS[1]), np.array(offsets), intervals=KNOTS - 1
    )
    seats = 3 * (len(offsets) - 1)
    assert model.size - seats + turns + 6 == expected
