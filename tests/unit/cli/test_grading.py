"""`grade`: a machine and a path in, what the set-up is worth out; nothing moves.

The analysis states it too: tests/system/cli/test_science.py.
"""

import pytest


@pytest.fixture
def files(recorded):
    return recorded / "machine.json", recorded / "path.csv"


def test_a_path_is_graded_in_one_object_better_with_along_path(command, files):
    order = ["grade", *files, "--tracker=-900,0,200"]
    said = command.json(*order)
    assert said["schema"] == "grade/1"
    assert said["verdict"] in ("good", "usable", "poor")
    assert said["tracker"]["position_mm"] == [-900.0, 0.0, 200.0]
    assert said["tracker"]["assumed"] is False
    assert all(s[0] == "E" for s in said["unobservable"])
    assert command.json(*order, "--perpendicular-only")["number"] > said["number"]


def test_a_person_gets_a_sentence_and_what_cannot_be_seen(command, files):
    said = command.run("grade", *files).out
    assert said.startswith("grade of the set-up: 0.")
    assert "worst of four usual places" in said
    assert "cannot be seen: EBZ (turn of Z about Y) is not distinguishable from" in said


def test_rows_without_a_feed_are_standstill_points(command, files, tmp_path):
    points = tmp_path / "points.csv"
    points.write_text("x_mm,y_mm,z_mm,dwell_s\n10,10,10,1\n400,300,200,1\n")
    assert command.json("grade", files[0], points)["verdict"] == "poor"


@pytest.mark.parametrize("place", ["1500,0", "here", "1,2,nan", "1,2,3,4"])
def test_half_a_place_is_refused(command, files, place):
    said = command.refuse("grade", *files, f"--tracker={place}")
    assert f"--tracker {place}: not a place; write X,Y,Z in mm" in said
