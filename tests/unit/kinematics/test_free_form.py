"""Free forms move points as what they describe would."""

import numpy as np
import pytest

from truepath.kinematics.effects.conformance import example_conditions
from truepath.kinematics.effects.free_form import (
    PlaneTurnFamily,
    SideShapeFamily,
    TiltWanderFamily,
)
from truepath.kinematics.effects.look_error import LookErrorFamily
from truepath.kinematics.effects.tracker_air import ScaleDriftFamily, read_air_degc


@pytest.fixture(scope="module")
def seen():
    return example_conditions()


def propose(family, at, **keys):
    return next(c.effect for c in family.propose(at) if keys.items() <= c.keys.items())


def test_a_tilt_moves_points_across_its_axis_and_by_their_distance(seen):
    tilt = propose(TiltWanderFamily(), seen, direction="Z")
    moved = tilt.jacobian(seen)[:, :, 0]
    arm = seen.point_mm - seen.point_mm.mean(axis=0)
    assert np.abs(moved[:, 2]).max() == 0.0
    assert np.abs(np.sum(moved * arm, axis=1)).max() < 1e-9
    size = np.linalg.norm(moved, axis=1) / np.linalg.norm(arm[:, :2], axis=1)
    assert size.max() == pytest.approx(size[0], rel=1e-6)


def test_a_turn_of_one_axis_by_another_is_nothing_without_the_other(seen):
    turn = propose(PlaneTurnFamily(), seen, motion="ECX", by="Y")
    products = turn.shapes(seen)
    share = seen.axis_mm("Y") / 500.0
    np.testing.assert_allclose(products[:, 0], 2.0 * share - 1.0)


def test_lost_motion_that_varies_changes_side_with_the_direction(seen):
    shape = propose(SideShapeFamily(), seen, axis="X", direction="Y")
    ahead = seen.approach[:, 0] * shape.jacobian(seen)[:, 1, 0]
    np.testing.assert_allclose(ahead, 2.0 * seen.axis_mm("X") / 500.0 - 1.0)


def test_an_error_of_the_range_is_along_the_beam(seen):
    moved = propose(LookErrorFamily(), seen, quantity="range").jacobian(seen)
    beam = seen.recorded.tracker_mm
    across = np.cross(moved[:, :, 0], beam)
    assert np.abs(across).max() < 1e-9 * np.linalg.norm(beam, axis=1).max()


def test_a_drifting_scale_moves_far_points_more(seen):
    assert read_air_degc(seen) is None
    drift = propose(ScaleDriftFamily(), seen).jacobian(seen)[:, :, 0]
    late = seen.time_s - 0.5 * (seen.time_s.min() + seen.time_s.max())
    np.testing.assert_allclose(drift, seen.recorded.tracker_mm * late[:, None])
