"""What a tracker within its specification does to points, against its own reading."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.kinematics.conditions import RecordedState, make_standstill
from truepath.kinematics.effects.tracker_air import BeamBending
from truepath.kinematics.effects.tracker_error import ElevationIndex
from truepath.kinematics.effects.tracker_specification import TrackerSpecification
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical


@pytest.fixture
def seen(mill, rng):
    points = rng.normal(0.0, [2500.0, 2500.0, 600.0], (40, 3))
    position = np.tile([[250.0, 200.0, -150.0]], (40, 1))
    recorded = RecordedState(
        np.zeros((40, 3)), np.ones(40), np.ones((40, 3)), points, np.eye(3)
    )
    return replace(make_standstill(mill, position), recorded=recorded)


@pytest.mark.parametrize(
    ("effect", "read_too_high_rad"),
    [
        (ElevationIndex(), lambda polar: np.ones(len(polar))),
        (BeamBending(), lambda polar: 0.5 * polar[:, 0] * np.cos(polar[:, 2])),
    ],
)
def test_a_point_moves_as_the_elevation_is_read_too_high(
    seen, effect, read_too_high_rad
):
    points = seen.recorded.tracker_mm
    polar = to_spherical(points)
    size = 1e-9
    polar[:, 2] += size * read_too_high_rad(polar)
    moved = (to_cartesian(polar) - points) / size
    told = effect.jacobian(seen)[:, :, 0]
    assert np.abs(told - moved).max() < 1e-3 * np.abs(moved).max()


def test_what_a_station_does_not_share_is_the_phase_of_the_azimuth():
    causes = TrackerSpecification().list_effects()
    alone = [effect.name for effect, _, shared in causes if not shared]
    assert alone == ["tracker-eccentricity-azimuth"]
    assert all(sigma > 0.0 for _, sigma, _ in causes)
