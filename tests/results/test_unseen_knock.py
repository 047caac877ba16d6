"""Where the target changes a knock may not show: data left out there are doubtful."""

from dataclasses import replace

import numpy as np
import pytest

from app.results.analysis import analyse
from simulators import synthetic
from simulators.machine_file import parse_machine
from simulators.scenario import load_machine
from simulators.turning_paths import turning_points

_POINTS = 96


@pytest.fixture(scope="module")
def made():
    """A trunnion at standstills, one target after the other."""
    content = load_machine("trunnion")
    content["tracker"]["stands_on"] = "base"
    program = turning_points(parse_machine(content), 5, _POINTS, dwell_s=0.4)
    return synthetic.record(content, program, 5, "standstill")


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
