"""Where the tracker stands, how often, and what else takes its own errors away."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.plan_report import plan_document, render_plan_report
from truepath.errors import PlanningError
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.motion.workspace import Box, Reflector, StationAreas, Workspace
from truepath.planning import line_suggestions
from truepath.planning.forecast import Assumptions, forecast
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.simulated_cells import predict_cells
from truepath.planning.stations import station_selection
from truepath_drivers.interfaces.records import Path

FLOOR = Box((-1500.0, -2500.0, -200.0), (2000.0, -500.0, 200.0))
PERFECT = TrackerSpecification(*[0.0] * 13)
LARGE = ("index_urad", "eccentricity_urad", "encoder_urad", "beam_offset_um")
LARGE += ("transit_offset_um", "range_offset_um")
FAULTY = replace(PERFECT, **dict.fromkeys(LARGE, 40.0), fine_urad=20.0)
HERE_MM, ELSEWHERE_MM = np.array([[125.0, -900.0, 0.0], [1100.0, 100.0, 0.0]])
PLACES = ((250.0, -800.0, 0.0), (1200.0, 100.0, 50.0), (-700.0, 200.0, 0.0))
THREE_NESTS = tuple(Box(place, place) for place in PLACES)
WORKSPACE = Workspace(nearest_mm=200.0, stations=StationAreas(THREE_NESTS))
FEEDS, NOT_SQUARE = (6000.0,), {"index_urad": 1000.0, "tilt_urad": 400.0}
SMALL = Workspace(nearest_mm=200.0, stations=StationAreas(THREE_NESTS[:1]))


def nests(*places):
    return tuple(Box(place, place) for place in places)


NESTS = nests((-600.0, -700.0, 0.0), (850.0, -700.0, 0.0))


@pytest.fixture(scope="module")
def plan_of(small_mill):
    def make(tracker=PERFECT, *, areas=NESTS, move_s=600.0, mode="otf", **more):
        stations = StationAreas(areas, (), move_s, tracker)
        space = Workspace(nearest_mm=200.0, stations=stations, **more)
        feeds = (6000.0,) if mode == "otf" else ()
        order = PlanRequirements(mode, minutes=0.4, feeds_mm_min=feeds, workspace=space)
        return make_plan(small_mill, order)

    return make


def test_the_place_is_allowed_near_and_no_place_or_number_of_them_is_better(plan_of):
    perfect = plan_of(areas=(FLOOR,))
    advice = perfect.stations
    assert advice.chosen
    assert perfect.order.workspace.stations.allow(perfect.station_mm[None])[0]
    assert perfect.order.workspace.tracker_mm == tuple(perfect.station_mm)
    first = advice.options[0].left
    assert first.sigma_mm == advice.best.sigma_mm <= advice.worst.sigma_mm
    assert advice.judged > 60
    # The angle's noise is what grows with the distance; far places lose by it.
    assert np.linalg.norm(perfect.station_mm - [125.0, 100.0, -75.0]) < 1500.0
    # What time averages from one station is that of the plan; more do not pay.
    assert first.random_mm == pytest.approx(perfect.forecast.random_mm)
    assert first.systematic_mm == 0.0
    assert first.seen == 1.0
    assert [len(option.place_mm) for option in advice.options] == [1, 2, 3]
    assert len(advice.recommended.place_mm) == 1


def test_systematic_errors_make_further_stations_pay(plan_of):
    advice = plan_of(FAULTY, areas=(FLOOR,)).stations
    assert advice.options[0].left.systematic_mm > advice.options[0].left.random_mm
    assert len(advice.recommended.place_mm) > 1
    assert advice.recommended.reason == "systematic"


@pytest.mark.long
def test_a_travel_that_no_place_sees_whole_demands_a_second_station(mill):
    wall = Box((240.0, -2600.0, -700.0), (260.0, 2000.0, 700.0), "wall")
    areas = StationAreas((FLOOR,), (), 60.0, PERFECT)
    space = Workspace(nearest_mm=200.0, stations=areas, blocks_sight=(wall,))
    advice = make_plan(mill, PlanRequirements(minutes=1.0, workspace=space)).stations
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


def specify(machine, specification, face=1):
    tracker = replace(machine.tracker, specification=specification, face=face)
    return replace(machine, tracker=tracker)


@pytest.fixture(scope="module")
def lines(small_mill):
    low, high = np.array([(axis.low, axis.high) for axis in small_mill.axes]).T
    position = np.random.default_rng(4).uniform(low, high, (16, 3))
    return Path(small_mill.axis_names, position, np.full(16, 6000.0), np.full(16, 0.4))


@pytest.fixture(scope="module")
def judge(small_mill, lines):
    def make(specification, face=1):
        machine = specify(small_mill, specification, face)
        found = forecast(machine, lines, HERE_MM)
        places = {"here_mm": HERE_MM, "elsewhere_mm": [ELSEWHERE_MM]}
        times = {"takes_s": 60.0, "move_s": 600.0}
        told = machine, lines, found, Assumptions()
        remedies = line_suggestions.list_set_up_remedies(*told, **places, **times)
        return found, {one.change: one for one in remedies}

    return make


def test_of_a_perfect_tracker_nothing_has_to_be_taken_away(judge):
    perfect, remedies = judge(PERFECT)
    typical, _ = judge(TrackerSpecification())
    assert not remedies
    # The air is still known to half a ppm.
    by_air_mm2 = perfect.volumetric_sigma_mm**2 - perfect.random_mm**2
    assert 0.0 < by_air_mm2 < (1e-6 * 500.0) ** 2
    assert typical.random_mm == pytest.approx(perfect.random_mm)
    assert typical.volumetric_sigma_mm > 1.1 * typical.random_mm
    _, remedies = judge(TrackerSpecification(), None)  # it has one face
    assert set(remedies) == {"second-place", "turned-base"}


def test_a_second_place_leaves_what_a_forecast_of_both_does(small_mill, lines, judge):
    first, remedies = judge(TrackerSpecification())
    one = remedies["second-place"]
    machine = specify(small_mill, TrackerSpecification())
    both = forecast(machine, lines, ELSEWHERE_MM, before=first).volumetric_sigma_mm
    again = forecast(machine, lines, HERE_MM, before=first).volumetric_sigma_mm
    assert one.sigma_mm == pytest.approx(both, rel=0.01)
    assert one.sigma_mm < 0.95 * again
    assert one.added_s == 660.0


def test_each_remedy_takes_away_what_it_changes(judge):
    """A turned base uses other parts of the azimuth circle; the zero of elevation,
    and axes that are not square, change their sign in the other face alone."""

    def find_left(**fault):
        found, remedies = judge(replace(PERFECT, **fault))
        whole_mm = found.volumetric_sigma_mm
        return {change: one.sigma_mm / whole_mm for change, one in remedies.items()}

    circle, axes = find_left(eccentricity_urad=40.0), find_left(**NOT_SQUARE)
    assert circle["turned-base"] < 0.8 * axes["turned-base"]
    assert axes["other-face"] < 0.8 * axes["turned-base"]


def test_a_plan_says_what_is_the_trackers_and_what_removes_most_a_minute(small_mill):
    wall = Box((-400.0, -2000.0, -2000.0), (-300.0, 2000.0, 2000.0), "wall")
    workspace = Workspace((), tuple(HERE_MM.tolist()), 200.0, blocks_sight=(wall,))
    order = PlanRequirements(minutes=0.2, feeds_mm_min=(6000.0,), workspace=workspace)
    document = plan_document(make_plan(small_mill, order))
    errors = document["predicted"]["tracker_errors"]
    parts = errors["random_um"] ** 2 + errors["systematic_um"] ** 2
    expected = pytest.approx(document["predicted"]["volumetric_uncertainty_um"])
    assert parts**0.5 == expected
    remedies = {one["change"]: one for one in errors["remedies"]}
    rate = [one["removed_um_per_minute"] for one in remedies.values()]
    assert rate == sorted(rate, reverse=True)
    assert min(rate) > 0.0
    # Rows are not seen from behind the wall.
    assert remedies["second-place"]["position_mm"][0] > -300.0
    assert errors["statement"][1] in render_plan_report(document)


@pytest.mark.long
def test_no_hour_is_planned_where_the_tracker_stands_in_the_way(small_mill):
    plan = make_plan(small_mill, PlanRequirements(target_um=0.2, feeds_mm_min=FEEDS))
    assert plan.reached is False
    assert plan.outcome.random_mm < 0.4 * plan.outcome.volumetric_sigma_mm
    assert plan.duration_s < 1000.0


@pytest.fixture(scope="module")
def planned(small_mill):
    order = {"minutes": 0.6, "workspace": WORKSPACE, "stations": 2}
    return make_plan(small_mill, PlanRequirements(feeds_mm_min=FEEDS, **order))


def test_stations_share_the_time_and_each_is_in_the_document(planned, small_mill):
    first, second = planned.at_stations
    assert first.duration_s + second.duration_s <= 36.0
    assert np.linalg.norm(first.station_mm - second.station_mm) > 300.0
    assert planned.uncertainty_um == second.uncertainty_um < first.uncertainty_um
    document = plan_document(planned)
    rows = [station["rows"] for station in document["at_stations"]]
    assert sum(rows) == document["rows"]
    assert document["curve"][-1]["row"] == document["rows"]
    assert document["curve"][-1]["time_s"] == pytest.approx(document["duration_s"])
    left = document["stations"]["options"][1]["random_um"]
    assert left == pytest.approx(1e3 * planned.outcome.random_mm)
    there = forecast(small_mill, second.commanded, second.station_mm)
    both = forecast(small_mill, first.commanded, first.station_mm, before=there)
    expected = pytest.approx(planned.uncertainty_um, rel=1e-4)
    assert 1e3 * both.volumetric_sigma_mm == expected


def test_the_second_station_drives_what_the_first_leaves_open(planned, small_mill):
    first, second = planned.at_stations
    here = Workspace((), tuple(second.station_mm.tolist()), 200.0)
    order = PlanRequirements(minutes=0.3, feeds_mm_min=FEEDS, workspace=here)
    alone = make_plan(small_mill, order)
    lines = alone.commanded, alone.station_mm
    beside = forecast(small_mill, *lines, before=first.forecast)
    assert planned.uncertainty_um < 1e3 * beside.volumetric_sigma_mm


def test_known_points_are_seen_from_every_station(mill, square):
    wall = Box((200.0, -100.0, -700.0), (210.0, 450.0, 700.0), "wall")
    workspace = Workspace(blocks_sight=(wall,))
    places = [np.array([-900.0, 0.0, 0.0]), np.array([0.0, -900.0, 0.0])]
    points = station_selection.choose_known_points(
        mill, workspace, places, [square, square]
    )
    assert 4 <= len(points) <= 5
    assert points.position[:, 0].max() < 400.0
    still = points.position
    for place in places:
        assert workspace.place_tracker(place).allows(mill, still, still).all()
    across = [np.array([-900.0, 0.0, 0.0]), np.array([1500.0, 0.0, 0.0])]
    with pytest.raises(PlanningError, match="not enough places"):
        station_selection.choose_known_points(mill, workspace, across, [square, square])


def test_no_move_between_known_points_and_lines_enters_a_keep_out_box(mill, square):
    vice = Box((150.0, 150.0, -300.0), (350.0, 250.0, -100.0), "vice")
    workspace = Workspace(keep_out=(vice,))
    places = [np.array(place) for place in PLACES[:2]]
    points = station_selection.choose_known_points(
        mill, workspace, places, [square, square]
    )
    way = np.vstack([points.position, square.position[0]])
    assert workspace.allows(mill, way[:-1], way[1:]).all()
    back = np.vstack([square.position[-1], points.position[0]])
    assert workspace.allows(mill, back[:-1], back[1:]).all()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"workspace": Workspace()}, "no areas"),
        ({"target_um": 1.0}, "leave target"),
        ({"stations": 4}, "at most 3"),
        ({"workspace": SMALL}, "300 mm apart"),
    ],
)
def test_what_stations_cannot_be_planned_for_is_refused(small_mill, more, said):
    order = {"minutes": 0.5, "workspace": WORKSPACE, "stations": 2, **more}
    with pytest.raises(PlanningError, match=said):
        make_plan(small_mill, PlanRequirements(feeds_mm_min=FEEDS, **order))


def test_ramps_count_as_ramps(mill, square):
    cells = predict_cells(mill, square, np.array([250.0, -900.0, 100.0]))
    assert cells.left_out == ()
    assert cells.is_ramp.any()
    assert not cells.is_ramp.all()
