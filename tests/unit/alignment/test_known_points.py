"""Known points tell whether a station agrees with the one before."""

from dataclasses import fields, replace

import numpy as np
import pytest

from recorded import record_run
from truepath.alignment import known_points
from truepath.errors import AlignmentError
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_simulators.machine.tracker_head import TrackerPose, reposition
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

ENDS = [10.0, 10.0, 10.0], [490.0, 390.0, 10.0], [490.0, 10.0, 290.0]
POINTS = np.array([*ENDS, [10.0, 390.0, 290.0], [250.0, 200.0, 150.0]])
NONE = dict.fromkeys((one.name for one in fields(TrackerSpecification)), 0.0)
SMALL = {"index_urad": 1.0, "eccentricity_urad": 1.0, "range_offset_um": 1.0}
FINE = TrackerSpecification(**NONE | SMALL)
FIRST, SECOND = (1300.0, 100.0, 50.0), (200.0, -900.0, 0.0)


def measured(place_mm, seed, *, nudge_mm=0.0, poses=reposition, **defects):
    content = load_machine("demo")
    n = len(POINTS)
    program = Program(POINTS, np.full(n, 100.0), np.full(n, 1.8))
    given = {"pose": poses(place_mm, seed), "defects": synthetic.Defects(**defects)}
    setting = synthetic.Setting(machine_seed=5, sensors=False, **given)
    run, made = record_run(content, program, seed, "standstill", setting)
    late = made.time_s > made.time_s[0] + 0.7 * np.ptp(made.time_s)
    tracker_mm = run.tracker.position_mm + np.outer(late, [0.0, 0.0, nudge_mm])
    run = replace(run, tracker=replace(run.tracker, position_mm=tracker_mm))
    return known_points.measure_points(run, FINE)


@pytest.fixture(scope="module")
def before():
    return measured(FIRST, 1)


ASKED_MM = float(np.linalg.norm(np.subtract(FIRST, SECOND)))


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_tracker_that_was_moved_agrees_with_its_last_station(before, seed):
    now = measured(SECOND, seed)
    check = known_points.compare_stations(before, now, ASKED_MM)
    assert (check.problem, check.place_mm) == ("", pytest.approx(SECOND, abs=1.0))
    assert check.moved_mm > 500.0
    assert check.residual_mm < 0.6 * check.allowed_mm < 0.05
    larger = replace(before, sigma_mm=2.0 * before.sigma_mm)
    wider = known_points.compare_stations(larger, now, ASKED_MM)
    assert wider.allowed_mm > check.allowed_mm


def test_a_tracker_that_was_not_moved_is_told(before):
    def stays(place, _):
        return TrackerPose(np.array(place), reposition(FIRST, 1).rotation)

    now = measured(FIRST, 9, poses=stays)
    check = known_points.compare_stations(before, now, ASKED_MM)
    assert check.problem == "not-moved"
    assert "stands 0 mm from its last place" in check.text


def test_a_reflector_that_moves_meanwhile_or_is_out_of_sight_is_told(before):
    now = measured(SECOND, 3, nudge_mm=0.1)
    check = known_points.compare_stations(before, now, ASKED_MM)
    assert check.problem == "residual"
    assert check.residual_mm > check.allowed_mm
    with pytest.raises(AlignmentError):
        measured(SECOND, 3, beam_breaks=((8.0, 4.0),))


@pytest.mark.parametrize(("planned", "problem"), [(FIRST, ""), (SECOND, "not-moved")])
def test_the_first_station_is_held_against_its_planned_place(before, planned, problem):
    found = known_points.hold_against_plan(before, np.array(planned), ASKED_MM)
    assert (found.problem, "of station 1" in found.text) == (problem, bool(problem))
