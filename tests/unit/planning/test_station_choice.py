"""The tracker stands where the same time leaves least; more stations pay or do not."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.errors import PlanningError
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath.motion.workspace.line_of_sight import Box, Reflector
from truepath.motion.workspace.workspace import StationAreas, Workspace
from truepath.planning.plan_making import make_plan
from truepath.planning.plan_order import PlanOrder

FLOOR = Box((-1500.0, -2500.0, -200.0), (2000.0, -500.0, 200.0))
PERFECT = TrackerSpecification(*[0.0] * 13)
LARGE = ("index_urad", "eccentricity_urad", "encoder_urad", "beam_offset_um")
LARGE += ("transit_offset_um", "range_offset_um")
FAULTY = replace(PERFECT, **dict.fromkeys(LARGE, 40.0), fine_urad=20.0)


def nests(*places):
    return tuple(Box(place, place) for place in places)


NESTS = nests((-600.0, -700.0, 0.0), (850.0, -700.0, 0.0))


@pytest.fixture(scope="module")
def plan_of(small_mill):
    def make(
        specification=PERFECT, *, areas=NESTS, move_s=600.0, mode="otf", **workspace
    ):
        stations = StationAreas(areas, (), move_s, specification)
        workspace = Workspace(nearest_mm=200.0, stations=stations, **workspace)
        feeds = (6000.0,) if mode == "otf" else ()
        order = PlanOrder(mode, minutes=0.4, feeds_mm_min=feeds, workspace=workspace)
        return make_plan(small_mill, order)

    return make


@pytest.fixture(scope="module")
def perfect(plan_of):
    return plan_of(areas=(FLOOR,))


def test_the_place_is_allowed_near_and_no_place_is_better(perfect):
    advice = perfect.stations
    assert advice.chosen
    assert perfect.order.workspace.stations.allow(perfect.station_mm[None])[0]
    assert perfect.order.workspace.tracker_mm == tuple(perfect.station_mm)
    first = advice.options[0].left
    assert first.sigma_mm == advice.best.sigma_mm <= advice.worst.sigma_mm
    assert advice.judged > 60
    # The angle's noise is what grows with the distance; far places lose by it.
    assert np.linalg.norm(perfect.station_mm - [125.0, 100.0, -75.0]) < 1500.0


def test_without_systematic_errors_moving_to_further_stations_does_not_pay(
    perfect,
):
    left = perfect.stations.options[0].left
    assert left.random_mm == pytest.approx(perfect.forecast.random_mm)
    assert left.systematic_mm == 0.0
    assert left.seen == 1.0
    assert [len(option.place_mm) for option in perfect.stations.options] == [1, 2, 3]
    assert len(perfect.stations.recommended.place_mm) == 1


def test_systematic_errors_make_further_stations_pay(plan_of):
    advice = plan_of(FAULTY, areas=(FLOOR,)).stations
    assert advice.options[0].left.systematic_mm > advice.options[0].left.random_mm
    assert len(advice.recommended.place_mm) > 1
    assert advice.recommended.reason == "systematic"


@pytest.mark.long
def test_a_travel_that_no_place_sees_whole_demands_a_second_station(mill):
    """A wall across the travel; the tracker may stand on either side of it."""
    wall = Box((240.0, -2600.0, -700.0), (260.0, 2000.0, 700.0), "wall")
    areas = StationAreas((FLOOR,), (), 60.0, PERFECT)
    workspace = Workspace(nearest_mm=200.0, stations=areas, blocks_sight=(wall,))
    advice = make_plan(mill, PlanOrder(minutes=1.0, workspace=workspace)).stations
    assert advice.options[0].left.seen < 0.9
    assert advice.recommended.reason == "sight"
    assert advice.recommended.left.seen > advice.options[0].left.seen


def test_a_reflector_decides_from_which_side_it_is_seen(plan_of):
    sides = nests((125.0, -800.0, 0.0), (125.0, 1000.0, 0.0))
    for direction, side in (((0, -1, 0), -1), ((0, 1, 0), 1)):
        planned = plan_of(areas=sides, reflector=Reflector(direction, 50.0))
        assert np.sign(planned.station_mm[1] - 100.0) == side


def test_a_stated_place_stays_and_is_held_against_the_best(plan_of):
    far = (-1500.0, -2500.0, 200.0)
    planned = plan_of(tracker_mm=far, areas=(*NESTS, *nests(far)))
    assert planned.station_mm.tolist() == list(far)
    assert not planned.stations.chosen
    assert planned.stations.best.sigma_mm < planned.stations.options[0].left.sigma_mm


@pytest.mark.parametrize("mode", ["otf", "standstill"])
def test_nests_are_places_to_choose_from_for_lines_and_points(plan_of, mode):
    planned = plan_of(mode=mode)
    assert planned.stations.chosen
    assert planned.stations.judged == 2
    assert tuple(planned.station_mm) in {nest.low_mm for nest in NESTS}
    assert planned.stations.options[0].left.random_mm > 0.0
    assert np.array_equal(plan_of(mode=mode).station_mm, planned.station_mm)


def test_areas_out_of_range_are_refused(plan_of):
    with pytest.raises(PlanningError, match="in range and in sight; correct"):
        plan_of(areas=(FLOOR,), farthest_mm=300.0)
