"""Plans of several stations: each knows what the others tell."""

import numpy as np
import pytest

from truepath.answers.plan.plan_document import plan_document
from truepath.errors import PlanningError
from truepath.motion.workspace.line_of_sight import Box
from truepath.motion.workspace.workspace import StationAreas, Workspace
from truepath.planning.forecast import forecast
from truepath.planning.known_points import choose_known_points
from truepath.planning.plan_making import make_plan
from truepath.planning.plan_order import PlanOrder
from truepath.planning.predicted_cells import predict_cells

PLACES = ((250.0, -800.0, 0.0), (1200.0, 100.0, 50.0), (-700.0, 200.0, 0.0))
NESTS = tuple(Box(place, place) for place in PLACES)
WORKSPACE = Workspace(nearest_mm=200.0, stations=StationAreas(NESTS))
FEEDS = (6000.0,)


@pytest.fixture(scope="module")
def planned(small_mill):
    order = PlanOrder(minutes=0.6, feeds_mm_min=FEEDS, workspace=WORKSPACE, stations=2)
    return make_plan(small_mill, order)


def test_stations_share_the_time_stand_apart_and_each_is_in_the_document(planned):
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


def test_the_forecast_is_that_of_all_stations_whatever_their_order(planned, small_mill):
    first, second = planned.at_stations
    there = forecast(small_mill, second.commanded, second.station_mm)
    both = forecast(small_mill, first.commanded, first.station_mm, before=there)
    expected = pytest.approx(planned.uncertainty_um, rel=1e-4)
    assert 1e3 * both.volumetric_sigma_mm == expected


def test_the_second_station_drives_what_the_first_leaves_open(planned, small_mill):
    """Lines chosen without that knowledge tell less beside those of the first."""
    first, second = planned.at_stations
    here = Workspace((), tuple(second.station_mm.tolist()), 200.0)
    order = PlanOrder(minutes=0.3, feeds_mm_min=FEEDS, workspace=here)
    alone = make_plan(small_mill, order)
    lines = alone.commanded, alone.station_mm
    beside = forecast(small_mill, *lines, before=first.forecast)
    assert planned.uncertainty_um < 1e3 * beside.volumetric_sigma_mm


def test_known_points_are_seen_from_every_station(mill, square):
    wall = Box((200.0, -100.0, -700.0), (210.0, 450.0, 700.0), "wall")
    workspace = Workspace(blocks_sight=(wall,))
    places = [np.array([-900.0, 0.0, 0.0]), np.array([0.0, -900.0, 0.0])]
    points = choose_known_points(mill, workspace, places, [square, square])
    assert 4 <= len(points) <= 5
    assert points.position[:, 0].max() < 400.0
    still = points.position
    for place in places:
        assert workspace.place_tracker(place).allows(mill, still, still).all()
    across = [np.array([-900.0, 0.0, 0.0]), np.array([1500.0, 0.0, 0.0])]
    with pytest.raises(PlanningError, match="not enough places"):
        choose_known_points(mill, workspace, across, [square, square])


def test_no_move_between_known_points_and_lines_enters_a_keep_out_box(mill, square):
    vice = Box((150.0, 150.0, -300.0), (350.0, 250.0, -100.0), "vice")
    workspace = Workspace(keep_out=(vice,))
    places = [np.array(place) for place in PLACES[:2]]
    points = choose_known_points(mill, workspace, places, [square, square])
    way = np.vstack([points.position, square.position[0]])
    assert workspace.allows(mill, way[:-1], way[1:]).all()
    back = np.vstack([square.position[-1], points.position[0]])
    assert workspace.allows(mill, back[:-1], back[1:]).all()


SMALL = Workspace(nearest_mm=200.0, stations=StationAreas(NESTS[:1]))


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
        make_plan(small_mill, PlanOrder(feeds_mm_min=FEEDS, **order))


def test_ramps_count_as_ramps(mill, square):
    cells = predict_cells(mill, square, np.array([250.0, -900.0, 100.0]))
    assert cells.left_out == ()
    assert cells.is_ramp.any()
    assert not cells.is_ramp.all()
