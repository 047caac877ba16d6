"""A machine file or path that is not that of the data is named for what it is."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "alignment"))
from test_arcs import random_path

from truepath.alignment.align import align
from truepath.cli.command import run
from truepath.files.bundle.bundle import read_bundle, write_bundle

BACK = {"A": [-1.0, 0.0, 0.0], "B": [0.0, -1.0, 0.0], "C": [0.0, 0.0, -1.0]}


@pytest.fixture
def analyse(tmp_path, capsys):
    """Analyse a bundle; return the status, what is said, and the verdict."""

    def made(bundle):
        status = run(["analyse", str(bundle), "-o", str(tmp_path / "out")])
        said, file = capsys.readouterr().err, tmp_path / "out" / "result.json"
        verdict = json.loads(file.read_text())["verdict"] if status == 0 else {}
        return status, said, verdict

    return made


def change(bundle: Path, edit) -> None:
    """Change the machine file of a bundle."""
    file = bundle / "machine.json"
    content = json.loads(file.read_text())
    edit(content)
    file.write_text(json.dumps(content))


def reverse(*names):
    def edit(content):
        for name in names:
            content["axes"][name]["direction"] = BACK[name]

    return edit


def chain(declared):
    return lambda content: content.update(kinematic_chain=declared)


@pytest.mark.parametrize(
    ("name", "edit", "fits"),
    [
        ("trunnion", reverse("C"), "w-C-A-b-X-Y-Z-t with axis C counted"),
        ("trunnion", reverse("A", "C"), "axis A counted the other way and axis C"),
        ("trunnion", chain("w-A-C-b-X-Y-Z-t"), "w-C-A-b-X-Y-Z-t far"),
        ("trunnion", chain("w-b-X-Y-Z-C-A-t"), "w-C-A-b-X-Y-Z-t"),
        ("head-table", chain("w-B-C-b-X-Y-Z-t"), "w-C-b-X-Y-Z-B-t"),
    ],
)
def test_another_chain_or_count_of_rotary_axes_is_named(
    tmp_path, analyse, name, edit, fits
):
    made, _ = random_path(name)
    write_bundle(made, tmp_path / "bundle")
    change(tmp_path / "bundle", edit)
    status, said, _ = analyse(tmp_path / "bundle")
    assert status == 1
    assert "the data fit chain" in said
    assert fits in said


def test_a_recording_of_another_path_is_not_blamed_on_the_chain(tmp_path, analyse):
    made, _ = random_path("trunnion")
    write_bundle(made, tmp_path / "bundle")
    file = tmp_path / "bundle" / "path.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head, *rows[::-1], ""]))
    status, said, _ = analyse(tmp_path / "bundle")
    assert status == 1
    assert "the stream does not follow path.csv" in said
    assert "the data fit" not in said


@pytest.mark.long
@pytest.mark.timeout(300)
def test_another_order_of_linear_axes_is_no_wrong_home_distance(
    record, tmp_path, analyse
):
    made, _ = record(1, rows=40)
    write_bundle(made, tmp_path / "bundle")
    change(tmp_path / "bundle", chain("w-b-Z-Y-X-t"))
    status, said, verdict = analyse(tmp_path / "bundle")
    assert status == 0
    kinds = {one["kind"]: one for one in verdict["details"]}
    assert kinds["chain-other"]["values"]["other"] == made.machine.chain
    assert kinds["chain-other"]["values"]["times_ratio"] > 2.0
    assert "range-off" not in kinds
    assert "The data fit w-b-X-Y-Z-t" in said


@pytest.mark.parametrize(
    ("rows", "side"), [(slice(0, 16), "after"), (slice(8, None), "before")]
)
def test_rows_that_a_path_lacks_are_said(bundle, rows, side):
    cut(bundle, rows)
    said = [x for x in align(read_bundle(bundle)).left_out if x.cause == side]
    assert [one.samples for one in said] == [pytest.approx(8, abs=1)]


def test_a_path_of_two_rows_is_cut_short(bundle, analyse):
    cut(bundle, slice(0, 2))
    status, said, _ = analyse(bundle)
    assert status == 1
    assert "path.csv has 2 rows" in said
    assert "cut short" in said
    assert "axis that turns" not in said


def test_a_whole_path_lacks_nothing(record):
    made, _ = record(1, rows=24)
    assert {"before", "after"}.isdisjoint(x.cause for x in align(made).left_out)


def cut(bundle: Path, rows: slice) -> None:
    file = bundle / "path.csv"
    head, *lines = file.read_text().splitlines()
    file.write_text("\n".join([head, *lines[rows], ""]))
