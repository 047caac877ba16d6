"""Where the target changes a knock may not show: data left out there are doubtful.

Where the first target is measured again at the end, it shows.
"""

import copy
from dataclasses import replace

import numpy as np
import pytest

from truepath.results.analysis import analyse
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.turning_paths import turning_points
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

_POINTS = 96
KNOCK_MM = np.array([0.012, -0.008, 0.014])
SEAT_MM = np.array([0.06, -0.08, 0.05])  # of W1 off its place


@pytest.fixture(scope="module")
def content():
    content = load_machine("trunnion")
    content["tracker"]["stands_on"] = "base"
    return content


@pytest.fixture(scope="module")
def program(content):
    """Points of one target after the other."""
    return turning_points(parse_machine(content), 5, _POINTS, dwell_s=0.4)


@pytest.fixture(scope="module")
def made(content, program):
    """A trunnion at standstills, one target after the other."""
    return synthetic.record(content, program, 5, "standstill")


@pytest.fixture(scope="module")
def made_again(content, program):
    """The same with the first target at the end as well, at its first points."""
    own = program.target.index("T2") // 2
    position = np.vstack([program.position[:-4], program.position[:4]])
    target = program.target[own:] + program.target[:own]
    order = replace(program, position=position, target=target)
    seated = copy.deepcopy(content)
    seated["targets"]["W1"]["offset_mm"] = (
        np.array(content["targets"]["W1"]["offset_mm"]) + SEAT_MM
    ).tolist()
    return replace(synthetic.record(seated, order, 5, "standstill"), content=content)


@pytest.fixture(scope="module")
def change(made):
    """The first point of the first target on the table."""
    return made.program.target.index("W1")


@pytest.fixture
def analyse_without(made, run_of):
    """Return what comes of a Run whose target was hidden at one point."""

    def analyse_rest(point):
        run = run_of(made)
        status = np.where(made.row == point, 1, run.tracker.status)
        return analyse(replace(run, tracker=replace(run.tracker, status=status)))

    return analyse_rest


def test_a_point_lost_where_the_target_changes_may_be_a_knock(analyse_without, change):
    verdict = analyse_without(change).verdict
    (reason,) = [r for r in verdict.reasons if r.kind == "knock-unseen"]
    assert verdict.state == "doubtful"
    assert str(change) in reason.values["rows"]


def test_a_point_lost_amid_a_target_is_no_knock(analyse_without, change):
    verdict = analyse_without(change + 8).verdict
    assert "knock-unseen" not in {r.kind for r in verdict.reasons}
    assert "points-without-data" in {r.kind for r in verdict.reasons}


@pytest.fixture(scope="module")
def knock_s(made_again):
    """When the knock is: before the first point of the first target on the table."""
    return made_again.time_s[made_again.row >= made_again.program.target.index("W1")][0]


@pytest.fixture(scope="module")
def knocked(made_again, run_of, knock_s):
    """What comes of the Run with the set-up knocked."""
    run = run_of(made_again)
    late = (run.tracker.device_time_s >= knock_s)[:, None]
    moved = run.tracker.position_mm + late * KNOCK_MM
    return analyse(replace(run, tracker=replace(run.tracker, position_mm=moved)))


def test_a_knock_at_a_change_shows_where_the_first_target_comes_again(knocked):
    (knock,) = knocked.knocks
    assert 1e3 * knock.moved_mm == pytest.approx(20.1, abs=3.0)


def test_targets_sit_where_they_are_found_on_both_sides_of_a_knock(knocked):
    seats = [
        seat
        for part in knocked.runs
        for seat in part.estimate.seats
        if seat.target.name == "W1"
    ]
    assert seats
    for seat in seats:
        assert (np.abs(seat.shift_mm - SEAT_MM) < 3.0 * seat.sigma_mm).all()


def test_a_run_without_it_says_that_a_knock_would_not_show(made, run_of, change):
    kinds = {r.kind: r.values for r in analyse(run_of(made)).verdict.reasons}
    assert str(change) in kinds["not-measured-again"]["rows"]
