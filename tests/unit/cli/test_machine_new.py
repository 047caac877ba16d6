"""`machine new`: the file that options or answers describe, as it is read again."""

import io
import runpy
import sys
from pathlib import Path

import pytest

from truepath.files.bundle.machine_file import read_machine

DOCS = Path(__file__).parents[3] / "docs"
PLAIN = ["--chain", "w-b-X-Y-Z-t", "--target", "1,2,3"]
MILL = ["--travel", "X=0,500", "--travel", "Y=0,400", "--travel", "Z=-300,0"]


@pytest.fixture
def file(tmp_path):
    return tmp_path / "mill.json"


@pytest.fixture
def answer(monkeypatch):
    def type_lines(*lines):
        text = "".join(f"{line}\n" for line in lines)
        monkeypatch.setattr(sys, "stdin", io.StringIO(text))

    return type_lines


def test_options_make_a_machine_without_a_question(command, file, answer):
    answer()
    stated = [*MILL, "--chain", "w-Y-b-X-Z-t", "--target", "20,30,-150"]
    stated += ["--stands-on", "base", "--max-feed", "12000", "--acceleration", "800"]
    said = command.run("machine", "new", "-o", file, "--name", "big mill", *stated)
    assert f"next: truepath plan {file}" in said.err
    made = read_machine(file)
    assert (made.name, made.chain) == ("big mill", "w-Y-b-X-Z-t")
    assert [(axis.low, axis.high) for axis in made.axes] == [
        (0.0, 500.0), (0.0, 400.0), (-300.0, 0.0)
    ]  # fmt: skip
    assert made.target().offset_mm == (20.0, 30.0, -150.0)
    assert (made.tracker.stands_on, made.motion.max_feed_mm_min) == ("base", 12000.0)
    assert made.motion.assumed == ("jerk_mm_s3",)


def test_answers_make_a_machine_with_a_table_and_are_asked_again(command, file, answer):
    travel = "0,500", "0 to 400", "0,400", "-300,0", "", "", "0,360"
    table = "250,200,-310", "0,0,-1", "w-X-C-b-Y-Z-t"
    targets = "0,0,-150", "T2=tool,70,0,-80", "W1=workpiece,90,0,20", ""
    answer(*travel, *table, *targets, "", "12000", "")
    assert "write 2 numbers and commas" in command.run("machine", "new", "-o", file).err
    made = read_machine(file)
    turn = made.rotary("C")
    assert (turn.low, turn.high) == (0.0, 360.0)
    assert turn.origin_mm == (250.0, 200.0, -310.0)
    assert turn.direction == (0.0, 0.0, -1.0)
    assert made.linear("Y").high == 400.0
    assert [(t.name, t.on) for t in made.targets] == [
        ("T1", "tool"), ("T2", "tool"), ("W1", "workpiece")
    ]  # fmt: skip
    assert (made.tracker.stands_on, made.name) == ("workpiece", "mill")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "nobody answers; state all by options"),
        (MILL, "add --chain, as w-X-b-Y-Z-t"),
        ([*MILL, *PLAIN[:2]], "add --target, as 20,30,-150"),
        (["--travel", "X=0"], "--chain"),
        (["--travel", "X=0", "--chain", "w", "--target", "1,2,3"], "write 2 numbers"),
        ([*MILL, *PLAIN, "--origin", "C=1,2,3"], "--travel states no rotary axis 'C'"),
        (
            [*MILL[:4], "--chain", "w-b-X-Y-t", "--target", "1,2,3"],
            'axes.Z is missing; add it, as "Z": {"type": "linear", "min_mm"',
        ),
    ],
)
def test_what_is_missing_is_named_with_a_remedy(command, file, answer, words, said):
    answer()
    assert said in command.refuse("machine", "new", "-o", file, *words)
    assert not file.exists()


def test_a_file_that_is_there_is_kept(command, file):
    file.write_text("{}")
    assert "is there already" in command.refuse("machine", "new", "-o", file, *MILL)
    assert file.read_text() == "{}"


def test_the_page_has_every_key_of_the_file():
    script = runpy.run_path(str(DOCS / "write_tables.py"))
    assert not script["main"](["machine keys"], check=True), "docs/write_tables.py"
