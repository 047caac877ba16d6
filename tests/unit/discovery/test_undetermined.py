"""Names that a Run cannot tell are listed with what takes them, until lines tell."""

import numpy as np
import pytest

from recorded import choose_program, load_erring, record_run
from truepath.answers.discovery_json import discovery_json
from truepath.discovery.discover import discover
from truepath.service.api.models.results.discovery import CannotTellOut
from truepath_simulators.motion.program import Program

TRAVEL_MM = 400.0
RNG = np.random.default_rng(0)
ONWARD = np.column_stack([np.linspace(20, 380, 40), *RNG.uniform(20, 380, (2, 40))])


def step_axes(lines):
    """One axis moves on each line."""
    position = [np.full(3, 20.0)]
    for k in range(lines):
        here, axis = position[-1].copy(), k % 3
        high = here[axis] > TRAVEL_MM / 2
        here[axis] = RNG.uniform(20, 180) if high else RNG.uniform(220, 380)
        position.append(here)
    return np.array(position)


PATHS = {
    "onward": ONWARD,
    "there-and-back": np.vstack([ONWARD, ONWARD[-2::-1]]),
    "one-axis": step_axes(45),
}


@pytest.fixture(scope="module")
def listed(record):
    made = {}

    def list_untold(name):
        if name not in made:
            position, count = np.round(PATHS[name], 3), len(PATHS[name])
            program = Program(position, np.full(count, 100.0), np.full(count, 0.4))
            run, _ = record(11, program=program, travel_mm=TRAVEL_MM)
            made[name] = discovery_json(discover([run]))["cannot_tell"]
        return {(one["name"], one.get("axis", "")): one for one in made[name]}

    return list_untold


def test_play_of_an_axis_that_never_turns_is_a_place_of_the_tracker(listed):
    play = listed("onward")["backlash", "X"]
    assert play["taken_by"][0] == "pose"
    assert play["would_tell"] == "both-directions"
    assert play["sentence"].startswith("Backlash of X is not distinguishable from the")
    assert ("backlash", "Y") not in listed("onward")
    assert ("backlash", "X") not in listed("there-and-back")


def test_a_creep_is_not_told_from_an_axis_that_goes_on_with_time(listed):
    creep = listed("onward")["table-drift", ""]
    assert creep["taken_by"] == ["X"]
    assert creep["would_tell"] == "repeated-lines"
    assert ("table-drift", "") not in listed("there-and-back")


def test_a_lag_is_timing_where_one_axis_moves_at_a_time(listed):
    lag = listed("one-axis")["servo-mismatch", "X"]
    assert lag["taken_by"] == ["timing"]
    assert lag["would_tell"] == "oblique-lines"
    assert ("servo-mismatch", "X") not in listed("onward")


def test_an_offset_of_the_range_is_within_what_a_tracker_may_have(listed):
    made = load_erring(None)
    run, _ = record_run(made, choose_program(made, 12, rows=40), 12)
    untold = discovery_json(discover([run]))["cannot_tell"]
    (offset,) = (one for one in untold if one["name"] == "tracker-range-offset")
    assert "tracker-errors" in offset["taken_by"]
    perfect = listed("there-and-back")
    assert ("tracker-range-offset", "") not in perfect
    assert "Set the home distance again" in offset["sentence"]


def test_a_tilt_and_a_shift_of_one_carriage_are_alike_with_one_tool(listed):
    alike = listed("one-axis")["lateral-backlash", "Z"]
    others = alike["indistinguishable_from"]
    motions = {one["motion"] for one in (alike, *others)}
    assert motions in ({"EXZ", "EBZ"}, {"EYZ", "EAZ"})
    assert (alike["taken_by"], alike["would_tell"]) == ([], "other-target")


def test_the_list_is_short_and_as_described(listed):
    untold = listed("onward").values()
    assert 0 < len(untold) <= 12
    for one in untold:
        CannotTellOut.model_validate(one)
