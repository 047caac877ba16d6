"""`grade`: a machine and a path in, what the set-up is worth out; nothing moves."""

import pytest

from truepath.cli.command import run


@pytest.fixture
def files(recorded):
    return [str(recorded / "machine.json"), str(recorded / "path.csv")]


def test_a_path_is_graded_in_one_object(files, summary):
    assert run(["grade", *files, "--tracker=-900,0,200", "--json"]) == 0
    said = summary()
    assert said["schema"] == "grade/1"
    assert said["verdict"] in ("good", "usable", "poor")
    assert said["tracker"]["position_mm"] == [-900.0, 0.0, 200.0]
    assert said["tracker"]["assumed"] is False
    assert all(s[0] == "E" for s in said["unobservable"])


def test_a_person_gets_a_sentence_and_what_cannot_be_seen(files, capsys):
    assert run(["grade", *files]) == 0
    said = capsys.readouterr().out
    assert said.startswith("grade of the set-up: 0.")
    assert "worst of four usual places" in said
    assert "cannot be seen: EBZ (turn of Z about Y) cannot be told from" in said


def test_along_path_information_is_worth_a_better_grade(files, summary):
    run(["grade", *files, "--json"])
    both = summary()["number"]
    run(["grade", *files, "--perpendicular-only", "--json"])
    assert summary()["number"] > both


def test_rows_without_a_feed_are_standstill_points(files, tmp_path, summary):
    points = tmp_path / "points.csv"
    points.write_text("x_mm,y_mm,z_mm,dwell_s\n10,10,10,1\n400,300,200,1\n")
    assert run(["grade", files[0], str(points), "--json"]) == 0
    assert summary()["verdict"] == "poor"


@pytest.mark.parametrize("place", ["1500,0", "here", "1,2,nan", "1,2,3,4"])
def test_half_a_place_is_refused(files, place, capsys):
    assert run(["grade", *files, f"--tracker={place}"]) == 2
    said = capsys.readouterr().err
    assert f"--tracker {place}: not a place; write X,Y,Z in mm" in said


def test_a_row_out_of_travel_is_named(files, tmp_path, capsys):
    path = tmp_path / "far.csv"
    path.write_text("x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n0,0,0,900,0\n9999,0,0,900,0\n")
    assert run(["grade", files[0], str(path)]) == 2
    said = capsys.readouterr().err
    assert "far.csv, row 3, column x_mm: is out of travel" in said


def test_the_analysis_states_the_grade_of_its_set_up(recorded, tmp_path, capsys):
    assert run(["analyse", str(recorded), "-o", str(tmp_path / "out")]) == 0
    assert "grade of the set-up: 0." in capsys.readouterr().out
