"""What a tracker within its specification does to points, against its own reading."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truepath.kinematics.conditions import RecordedState, make_standstill
from truepath.kinematics.effects import instrument, tracker_error
from truepath.kinematics.effects.tracker_air import BeamBending
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical


@pytest.fixture
def seen(mill, rng):
    points = rng.normal(0.0, [2500.0, 2500.0, 600.0], (40, 3))
    position = np.tile([[250.0, 200.0, -150.0]], (40, 1))
    still, span = np.zeros((40, 3)), (np.ones(40), np.ones((40, 3)))
    recorded = RecordedState(still, *span, points, np.eye(3))
    return replace(make_standstill(mill, position), recorded=recorded)


@pytest.mark.parametrize(
    ("effect", "read_too_high_rad"),
    [
        (tracker_error.ElevationIndex(), lambda polar: np.ones(len(polar))),
        (BeamBending(), lambda polar: 0.5 * polar[:, 0] * np.cos(polar[:, 2])),
    ],
)
def test_a_point_moves_as_its_elevation_is_misread(seen, effect, read_too_high_rad):
    points = seen.recorded.tracker_mm
    polar = to_spherical(points)
    size = 1e-9
    polar[:, 2] += size * read_too_high_rad(polar)
    moved = (to_cartesian(polar) - points) / size
    told = effect.jacobian(seen)[:, :, 0]
    assert np.abs(told - moved).max() < 1e-3 * np.abs(moved).max()


SMALL = 1e-4


def rotate(axis, angle):
    """(n, 3, 3) rotation about a coordinate axis of the tracker."""
    return Rotation.from_rotvec(np.multiply.outer(angle, np.eye(3)[axis])).as_matrix()


def aim(polar, *, transit=0.0, tilt=0.0, skew=0.0, beside=(0.0, 0.0)):
    """Where the reflector of a tracker is whose axes do not meet or are not square."""
    distance, azimuth, elevation = polar.T
    aside = np.stack([distance, skew * distance, np.zeros_like(distance)], axis=1)
    head = rotate(1, -elevation) @ (aside + np.array([0.0, *beside]))[:, :, None]
    head = rotate(0, np.full_like(tilt + azimuth, tilt)) @ head
    head += np.array([transit, 0.0, 0.0])[:, None]
    return (rotate(2, azimuth) @ head)[:, :, 0]


def apply_reading_errors(**off):
    """Return the point of a tracker whose reading is off, by functions of the polar."""
    order = ("distance", "azimuth", "elevation")

    def read(polar):
        moved = polar.copy()
        for name, error in off.items():
            moved[:, order.index(name)] += SMALL * error(polar)
        return to_cartesian(moved)

    return read


def circle(cycles):
    """Errors of both circles with so many cycles a turn."""
    return [
        apply_reading_errors(**{name: lambda p, w=wave, k=k: w(cycles * p[:, k])})
        for k, name in ((1, "azimuth"), (2, "elevation"))
        for wave in (np.cos, np.sin)
    ]


BODIES = {
    "index_urad": (1e6, [apply_reading_errors(elevation=lambda p: np.ones(len(p)))]),
    "eccentricity_urad": (1e6, circle(1)),
    "encoder_urad": (1e6, circle(2)),
    "tilt_urad": (1e6, [lambda p: aim(p, tilt=-SMALL), lambda p: aim(p, skew=SMALL)]),
    "beam_offset_um": (1e3, [partial(aim, beside=at) for at in SMALL * np.eye(2)]),
    "transit_offset_um": (1e3, [lambda p: aim(p, transit=SMALL)]),
    "range_offset_um": (
        1e3,
        [apply_reading_errors(distance=lambda p: np.ones(len(p)))],
    ),
    "scale_ppm": (1e6, [apply_reading_errors(distance=lambda p: p[:, 0])]),
    "bending_urad_per_m": (
        1e3,  # the light bends all the way, so it also comes later
        [
            apply_reading_errors(
                elevation=lambda p: 1e-6 * p[:, 0] * np.cos(p[:, 2]),
                distance=lambda p: -1e-6 * p[:, 0] ** 2 * np.sin(p[:, 2]),
            )
        ],
    ),
}


@pytest.mark.parametrize("face", [1, 2])
@pytest.mark.parametrize("name", BODIES)
def test_each_error_of_a_specification_moves_points_as_bodies_do(seen, name, face):
    unit, causes = BODIES[name]
    none = dict.fromkeys((f.name for f in fields(TrackerSpecification)), 0.0)
    stated = TrackerSpecification(**{**none, name: unit})
    tracker = replace(seen.machine.tracker, specification=stated, face=face)
    seen = replace(seen, machine=replace(seen.machine, tracker=tracker))
    (effect,) = instrument.list_instrument_errors([seen])
    columns = np.moveaxis(effect.jacobian(seen), 2, 0)
    polar = to_spherical(seen.recorded.tracker_mm)
    if face == 2:  # the head half a turn further, looking over its back
        polar = polar * [1.0, 1.0, -1.0] + [0.0, np.pi, np.pi]
    assert len(columns) == len(causes)
    for column, read in zip(columns, causes, strict=True):
        moved = (read(polar) - seen.recorded.tracker_mm) / SMALL
        assert np.abs(column - moved).max() < 1e-2 * np.abs(moved).max()


def test_the_fine_part_of_a_circle_varies_as_much_as_it_is_stated_to():
    seen = np.linspace(-0.6, 0.9, 200)
    rows = instrument.FineCircle.over(seen).rows(seen)
    assert rows.shape[1] <= 16
    assert (rows**2).sum(axis=1) == pytest.approx(1.0, abs=0.01)
    apart = (rows[:-40] * rows[40:]).sum(axis=1)
    process = np.mean([np.cos(k * (seen[40] - seen[0])) for k in range(3, 17)])
    assert apart == pytest.approx(process, abs=0.02)
