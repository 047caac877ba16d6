"""A machine model gives each effect a place of its own in θ."""

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics.effects.pose_timing_seats import TrackerPose
from truepath.kinematics.effects.position_wave import ScrewCyclic
from truepath.kinematics.model import MachineModel

MACHINE = build_mill((0.0, 0.0, -80.0))


def test_effects_that_differ_in_the_ninth_digit_have_parameters_of_their_own():
    axis = MACHINE.linear_axes[0]
    effects = ScrewCyclic(axis, 10.0), ScrewCyclic(axis, 10.00000001)
    model = MachineModel(MACHINE, effects)
    assert model.size == 8
    assert [s.start for s in model.slices.values()] == [0, 4]


def test_two_effects_of_one_name_are_refused():
    pose = TrackerPose((0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="tracker-pose"):
        MachineModel(MACHINE, (pose, pose))


def test_effects_of_equal_content_are_equal():
    axis = MACHINE.linear_axes[0]
    assert ScrewCyclic(axis, 10.0) == ScrewCyclic(axis, 10.0)
    assert hash(ScrewCyclic(axis, 10.0)) == hash(ScrewCyclic(axis, 10.0))
    assert ScrewCyclic(axis, 10.0) != ScrewCyclic(axis, np.nextafter(10.0, 11.0))
