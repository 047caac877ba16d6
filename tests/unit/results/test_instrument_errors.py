"""What a tracker within its specification does is in what is stated."""

from dataclasses import asdict

import numpy as np
import pytest

from estimating import judge_map
from recorded import load_small, record_run
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.synthetic import Setting

ROWS, FEED = 24, 6000.0


def content():
    """A small machine whose tracker errs as is typical, and says so."""
    made = load_small("demo", 0.5)
    made["tracker"]["specification"] = asdict(TrackerSpecification())
    return made


def measure(seed, mode="otf", places=1):
    """Return the findings of a machine, and its truth."""
    made = content()
    machine = parse_machine(made)
    if mode == "otf":
        program = paths.chord_path(machine, seed, ROWS, FEED)
    else:
        program = paths.standstill_points(machine, seed, 50, dwell_s=0.5)
    recorded = [
        record_run(made, program, seed + k, mode, Setting(machine_seed=seed))
        for k in range(places)
    ]
    return analyse(*(run for run, _ in recorded)), recorded[0][1].truth


@pytest.mark.parametrize(
    ("mode", "places"),
    [("otf", 1), pytest.param("otf", 2, marks=pytest.mark.long), ("standstill", 1)],
)
def test_what_is_stated_holds_what_the_tracker_does(mode, places):
    inside = []
    for seed in (11, 12, 13):
        found, truth = measure(seed, mode, places)
        inside.append(judge_map(found.estimate, truth.deviation_mm).inside)
    assert np.mean(inside) > 0.86
    assert min(inside) > 0.6


def test_the_budget_tells_what_is_the_trackers_and_a_second_place_takes_it_away():
    one, two = (
        result_json(measure(14, places=places)[0])["uncertainty_budget"]
        for places in (1, 2)
    )
    share = [
        each["sources_um"]["instrument"]["volume"] / each["total_um"]["volume"]
        for each in (one, two)
    ]
    assert share[0] > 0.5
    assert two["total_um"]["volume"] < 0.8 * one["total_um"]["volume"]


def test_errors_of_the_tracker_are_no_errors_of_the_machine():
    found, _ = measure(15)
    said = str(result_json(found))
    assert "tracker-errors" not in said
    assert "set-up-errors" not in said
