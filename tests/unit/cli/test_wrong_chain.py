"""A machine file or path that is not that of the data is named for what it is."""

import json
from functools import cache

import pytest
from tests.unit.alignment.test_targets import random_path

from api_builders import edited
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath_simulators import machine_file
from truepath_simulators.motion import paths

UPRIGHT = '"direction": [0.0, 0.0, 1.0] in C'
HEAD = "w-C-b-X-Y-Z-B-t"
TABLES = '"kinematic_chain": "w-C-A-b-X-Y-Z-t"'
OTHER = {"base": "workpiece", "workpiece": "base"}
BACK = {"A": [-1.0, 0.0, 0.0], "B": [0.0, -1.0, 0.0], "C": [0.0, 0.0, -1.0]}


@cache
def recorded_on(name):
    return random_path(name, rate_hz=100)[0]


def edit_rows(bundle, rows):
    """Leave these rows of the path, in the order that they are taken in."""
    file = bundle / "path.csv"
    head, *lines = file.read_text().splitlines()
    file.write_text("\n".join([head, *lines[rows], ""]))


def reverse(*names):
    def edit(content):
        for name in names:
            content["axes"][name]["direction"] = BACK[name]

    return edit


def chain(declared):
    return lambda content: content.update(kinematic_chain=declared)


@pytest.mark.parametrize(
    ("name", "edit", "fits", "write"),
    [
        ("trunnion", reverse("C"), "w-C-A-b-X-Y-Z-t with axis C counted", UPRIGHT),
        (
            "trunnion",
            reverse("A", "C"),
            "axis A counted the other way and axis C",
            f'"direction": [1.0, 0.0, 0.0] in A and {UPRIGHT}',
        ),
        ("trunnion", chain("w-A-C-b-X-Y-Z-t"), "w-C-A-b-X-Y-Z-t far", TABLES),
        ("trunnion", chain("w-b-X-Y-Z-C-A-t"), "w-C-A-b-X-Y-Z-t", TABLES),
        ("head-table", chain("w-B-C-b-X-Y-Z-t"), HEAD, f'"kinematic_chain": "{HEAD}"'),
    ],
)
def test_another_chain_or_sense_is_named(command, tmp_path, name, edit, fits, write):
    bundle = tmp_path / "bundle"
    write_bundle(recorded_on(name), bundle)
    with edited(bundle / "machine.json") as content:
        edit(content)
    said = command.refuse("analyse", bundle, "-o", tmp_path / "out", status=1)
    assert "the recording fits chain" in said
    assert fits in said
    assert f"write {write} there" in said


@pytest.mark.parametrize(
    ("truly", "place"), [("base", "floor"), ("workpiece", "table")]
)
@pytest.mark.parametrize("name", ["demo", "trunnion"])
def test_a_tracker_elsewhere_is_found(command, tmp_path, name, truly, place):
    content = load_small(name)
    content["tracker"] |= {"stands_on": truly, "rate_hz": 100.0}
    machine = machine_file.parse_machine(content)
    if machine.rotary_axes:
        program = paths.turning_path(machine, 5, 24, 9000.0)
    else:
        program = paths.chord_path(machine, 5, 24, 9000.0)
    bundle = tmp_path / "bundle"
    write_bundle(record_run(content, program)[0], bundle)
    with edited(bundle / "machine.json") as content:
        content["tracker"]["stands_on"] = OTHER[truly]
    said = command.refuse("analyse", bundle, "-o", tmp_path / "out", status=1)
    assert f"the recording fits a tracker on the {place} far better" in said
    assert f'write "stands_on": "{truly}" in tracker there' in said


def test_a_recording_of_another_path_is_not_blamed_on_the_chain(command, tmp_path):
    bundle = tmp_path / "bundle"
    write_bundle(recorded_on("trunnion"), bundle)
    edit_rows(bundle, slice(None, None, -1))
    said = command.refuse("analyse", bundle, "-o", tmp_path / "out", status=1)
    assert "the stream does not follow path.csv" in said
    assert "the recording fits" not in said


@pytest.mark.long
@pytest.mark.timeout(300)
def test_another_order_of_linear_axes_is_no_wrong_home_distance(command, tmp_path):
    content = machine_file.load_machine("demo") | {"kinematic_chain": "w-b-X-Y-Z-t"}
    program = paths.chord_path(machine_file.parse_machine(content), 1, 40, 10_000.0)
    made, _ = record_run(content, program, 1)
    write_bundle(made, tmp_path / "bundle")
    with edited(tmp_path / "bundle" / "machine.json") as other:
        other["kinematic_chain"] = "w-b-Z-Y-X-t"
    out = tmp_path / "out"
    said = command.run("analyse", tmp_path / "bundle", "-o", out).err
    verdict = json.loads((out / "result.json").read_text())["verdict"]
    kinds = {one["kind"]: one for one in verdict["details"]}
    assert kinds["chain-other"]["values"]["other"] == made.machine.chain
    assert kinds["chain-other"]["values"]["times_ratio"] > 2.0
    assert "range-off" not in kinds
    assert "The data fit w-b-X-Y-Z-t" in said


@pytest.mark.parametrize(
    ("rows", "sides"),
    [(slice(16), ["after"]), (slice(8, None), ["before"]), (slice(None), [])],
)
def test_rows_that_a_path_lacks_are_said(bundle, rows, sides):
    edit_rows(bundle, rows)
    left_out = align(read_bundle(bundle)).left_out
    said = [one for one in left_out if one.cause in ("before", "after")]
    assert [one.cause for one in said] == sides
    assert all(one.samples == pytest.approx(8, abs=1) for one in said)


def test_a_path_of_two_rows_is_cut_short(command, bundle, tmp_path):
    edit_rows(bundle, slice(0, 2))
    said = command.refuse("analyse", bundle, "-o", tmp_path / "out", status=1)
    assert "path.csv has 2 rows" in said
    assert "cut short" in said
    assert "axis that turns" not in said
