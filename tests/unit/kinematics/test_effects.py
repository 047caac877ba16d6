"""What effects do to the measured point."""

from dataclasses import replace

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.effects.pose_timing_seats import TimingLaw, TrackerPose
from truepath.kinematics.effects.position_wave import ScrewCyclic
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.model import MachineModel

OFFSET = (20.0, -30.0, -150.0)


MACHINE = build_mill(OFFSET)


@pytest.mark.parametrize(
    ("low", "high", "zero"), [(0, 500, 0), (-200, 300, 0), (50, 550, 50)]
)
def test_tables_keep_the_gauge(low, high, zero, rng):
    axis = LinearAxis("X", float(low), float(high))
    for symbol in ("EXX", "EAX", "EBX", "ECX", "EYX", "EZX"):
        effect = make_error_motion(symbol, axis, 8)
        theta = rng.normal(size=len(effect.parameters))
        is_straightness = symbol in ("EYX", "EZX")
        fixed = [axis.low, axis.high] if is_straightness else [float(zero)]
        assert effect.rows(np.array(fixed)) @ theta == pytest.approx(0.0, abs=1e-9)


def test_phase_and_speed_move_along_their_own_line_only_and_not_at_a_standstill(rng):
    law = TimingLaw((0, 1))
    position = rng.uniform(0, 500, (3, 3))
    velocity = [[100.0, 0, 0], [100.0, 0, 0], [0, 0, -50.0]]
    at = replace(
        make_standstill(MACHINE, position),
        line=np.array([0, 0, 1]),
        line_time_s=np.array([-1.0, 1.0, 0.5]),
        velocity_mm_s=np.array(velocity),
    )
    moved = law.displacement_mm(at, np.array([0.1, 0.01, 0.0, 0.2]))
    assert np.allclose(moved, [[0.09, 0, 0], [0.11, 0, 0], [0, 0, -0.1]])
    assert not law.jacobian(make_standstill(MACHINE, position)).any()


def test_pose_is_a_shift_and_a_turn_about_its_centre(rng):
    at = make_standstill(MACHINE, rng.uniform(0, 500, (4, 3)))
    turn, shift = np.array([1e-5, 2e-5, -1e-5]), np.array([0.1, 0.0, -0.2])
    effect = TrackerPose((100.0, 50.0, 0.0))
    moved = effect.displacement_mm(at, np.concatenate([shift, turn]))
    assert np.allclose(moved, shift + np.cross(turn, at.point_mm - [100.0, 50.0, 0.0]))


def test_effects_that_differ_in_the_ninth_digit_have_parameters_of_their_own():
    axis = MACHINE.linear_axes[0]
    effects = ScrewCyclic(axis, 10.0), ScrewCyclic(axis, 10.00000001)
    model = MachineModel(MACHINE, effects)
    assert model.size == 8
    assert [s.start for s in model.slices.values()] == [0, 4]
    assert effects[0] == ScrewCyclic(axis, 10.0) != effects[1]
    assert hash(effects[0]) == hash(ScrewCyclic(axis, 10.0))


def test_two_effects_of_one_name_are_refused():
    pose = TrackerPose((0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="tracker-pose"):
        MachineModel(MACHINE, (pose, pose))
