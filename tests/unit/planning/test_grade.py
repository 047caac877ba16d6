"""The grade of a set-up from its geometry, held against what estimates then achieve."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import paths_by_hand
from estimating import estimate, judge_map
from truepath.alignment.align import align
from truepath.errors import PlanningError
from truepath.kinematics.machine.machine import Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.configurations import Configurations
from truepath.planning.default_path import default_path
from truepath.planning.grade import SetUp, grade, grade_together, verdict

plan = cache(default_path)
STATION_MM = np.array([-900.0, 200.0, 100.0])


@pytest.fixture(scope="module")
def demo(record):
    return record(1)[0].machine


path_of = partial(paths_by_hand.path_of, dwell_s=0.4)


@pytest.mark.parametrize(("mode", "rows"), [("otf", 16), ("standstill", 60)])
def test_what_is_expected_before_motion_is_achieved(record, mode, rows):
    run, _ = record(51, mode, rows=rows)
    found = estimate(align(run))
    stand = found.runs[0].pose.invert().translation_mm
    expected = grade(run.machine, run.commanded, station_mm=stand).sigma_mm
    achieved = np.sqrt(np.sum(compute_volumetric_gram(found.model) * found.covariance))
    assert 0.6 < achieved / expected < 1.6


def test_more_lines_and_a_nearer_tracker_are_graded_better_a_better_one_the_same(demo):
    few, many = (plan(demo, lines=n) for n in (8, 24))
    near = grade(demo, many, station_mm=STATION_MM)
    assert grade(demo, few, station_mm=STATION_MM).number > 1.5 * near.number
    assert near.sigma_mm < grade(demo, many, station_mm=4.0 * STATION_MM).sigma_mm
    fine = TrackerNoise(0.5, 0.15, 1.5, 2.0)
    path = plan(demo)
    number = grade(demo, path, station_mm=STATION_MM).number
    finer = grade(replace(demo, tracker=fine), path, station_mm=STATION_MM).number
    assert finer == pytest.approx(number, rel=0.15)


def test_an_unknown_stand_counts_as_the_worst_of_usual_ones(demo):
    path = plan(demo, lines=10)
    found = grade(demo, path)
    assert found.assumed
    assert found.best < found.number
    known = grade(demo, path, station_mm=found.station_mm)
    assert known.number == pytest.approx(found.number)
    assert not known.assumed


def test_the_default_plan_is_good_and_verdicts_change_at_a_quarter_and_at_one(demo):
    found = grade(demo, plan(demo))
    assert found.verdict == "good"
    assert found.shapes == ()
    assert all(motion.remedy is None for motion in found.weakest)
    assert found.improved is None
    numbers = (0.25, 0.251, 1.0, 1.01)
    assert [verdict(n) for n in numbers] == ["good", "usable", "usable", "poor"]


def test_the_blind_spot_of_corner_paths_is_named_before_anything_moves(record):
    run, _ = record(27, corners=True)
    found = grade(run.machine, run.commanded, perpendicular_only=True)
    assert {m.symbol for m in found.weakest} == {"EXX", "EYY", "EZZ"}
    assert set(found.shapes[0].symbols) == {"EXX", "EYY", "EZZ"}
    assert found.shapes[0].form == "an S of the error along X"
    assert grade(run.machine, run.commanded).shapes == ()


def test_a_short_reach_in_z_is_cured_by_lines_that_go_up_z(demo):
    low = plan(demo)
    flat = replace(low, position=low.position * np.array([1.0, 1.0, 0.3]))
    found = grade(demo, flat, station_mm=STATION_MM)
    assert found.verdict == "poor"
    assert found.weakest[0].symbol[2] == "Z"
    remedy = found.weakest[0].remedy
    assert abs(remedy.end[2] - remedy.begin[2]) > 0.8 * demo.linear_axes[2].high
    assert found.improved < 0.5 * found.number


def test_the_line_asked_for_lowers_the_number_it_promises(demo):
    path = plan(demo, lines=6)
    found = grade(demo, path, station_mm=STATION_MM)
    remedy = found.weakest[0].remedy
    longer = np.vstack([path.position, remedy.begin, remedy.end])
    again = grade(demo, path_of(*longer), station_mm=STATION_MM)
    assert found.improved < found.number
    assert again.number == pytest.approx(found.improved, rel=0.1)


def test_a_path_in_two_runs_is_worth_hardly_less_and_a_longer_tool_tells_more(demo):
    path = plan(demo, lines=24)
    half = len(path) // 2
    halves = path.position[: half + 1], path.position[half:]
    parts = [path_of(*rows) for rows in halves]
    together = grade_together(demo, [SetUp(demo, part, STATION_MM) for part in parts])
    alone = grade(demo, parts[0], station_mm=STATION_MM)
    whole = grade(demo, path, station_mm=STATION_MM)
    assert whole.number <= together.number < 1.3 * whole.number
    assert together.number < alone.number
    second = (20.0, 30.0, -350.0)
    longer = replace(demo, targets=(Target("", "tool", second),))
    both = replace(demo, targets=(*demo.targets, Target("long", "tool", second)))
    path = plan(demo)
    set_ups = [SetUp(machine, path, STATION_MM) for machine in (demo, longer)]
    said = {s[:3] for s in grade_together(both, set_ups).unobservable}
    assert said == {s[:3] for s in grade(demo, path).unobservable} - {"EAZ", "EBZ"}


@pytest.mark.parametrize(
    "rows", [[[0, 0, 0], [400, 300, 200]], [[0, 0, 0], [400, 0, 0]]]
)
def test_a_set_up_that_tells_little_is_poor_and_one_of_nothing_refused(demo, rows):
    assert grade(demo, path_of(*rows)).number > 5.0
    stood = Configurations(demo.axis_names, np.array(rows[:1], float), np.ones(1))
    assert grade(demo, stood).verdict == "poor"
    stood = Configurations(demo.axis_names, np.zeros((1, 3)), np.zeros(1))
    with pytest.raises(PlanningError, match="nothing would be measured"):
        grade(demo, stood)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_what_is_left_of_the_error_follows_the_grade(record):
    """The table of docs/grade.md, on machines of one size."""
    share = {"good": [], "usable": [], "poor": []}
    for seed, rows in enumerate([6, 7, 9, 11, 16, 20, 34], 400):
        run, truth = record(seed, rows=rows)
        found = estimate(align(run))
        stand = found.runs[0].pose.invert().translation_mm
        graded = grade(run.machine, run.commanded, station_mm=stand)
        left = judge_map(found, truth.deviation_mm)
        share[graded.verdict].append(left.share)
    assert max(share["good"]) < 0.12
    assert np.median(share["good"]) < np.median(share["usable"])
    assert np.median(share["usable"]) < np.median(share["poor"])
