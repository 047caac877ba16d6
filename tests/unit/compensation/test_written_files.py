"""What is written is what is read, by the control's rules, and is added to."""

import hashlib
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import written_tables as tables
from known_machines import spread, tabulate
from truepath.compensation.active_files import make_active_files, read_active_files
from truepath.compensation.format_registry import list_formats, load_format
from truepath.compensation.residual_error import sample_travel
from truepath.compensation.tables.error_map import map_errors
from truepath.errors import BadInput
from truepath.files.earlier.result_file import HalfDifference
from truepath.kinematics.conditions import Conditions
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine_file import parse_machine
from written_tables import MACHINE, write_files

SIMULATED = parse_machine(tables.CONTENT)
SIMULATED_TRUNNION = parse_machine(tables.ROTARY_CONTENT)
TURNING = ("linuxcnc", "siemens", "siemens-lec")
GOLDEN_FOLDERS = {order: (tables.write_files, order) for order in tables.ORDERS} | {
    f"{order}-rotary": (tables.write_rotary_files, order)
    for order in tables.ROTARY_ORDERS
}
_values = st.lists(st.floats(-0.03, 0.03), min_size=3, max_size=6)
_turns = st.lists(st.floats(-0.01, 0.01), min_size=4, max_size=9)


def simulate(order, files, position, direction, machine=SIMULATED):
    reading = "difference" if order == "heidenhain-difference" else "negative-value"
    systems = {"siemens-system-2": 2, "siemens-system-by-axis": "X=2"}
    rules = Rules(reading, tool_length_mm=100.0, measuring_system=systems.get(order, 1))
    correction = LoadedTables(files, rules).correct(machine)
    return correction.added(position, np.full_like(position, direction))


simulate_trunnion = partial(simulate, "usual", machine=SIMULATED_TRUNNION)


@pytest.mark.parametrize("folder", GOLDEN_FOLDERS)
def test_files_are_the_golden_ones(folder):
    write, order = GOLDEN_FOLDERS[folder]
    files = (tables.GOLDEN / folder).iterdir()
    assert write(order) == {p.name: p.read_text(encoding="ascii") for p in files}


@pytest.mark.parametrize("order", tables.ORDERS)
@given(
    own=_values, across=_values, lost=st.floats(0.0, 0.01), turn=st.floats(-1e-4, 1e-4)
)
@settings(max_examples=25, deadline=None)
def test_our_reader_and_the_simulated_control_agree(order, own, across, lost, turn):
    if order == "fanuc":  # steps that every control takes
        own = (np.array(own) * 0.1).tolist()
    n = min(len(own), len(across))
    aside = np.tile(np.array(across[:n])[:, None], (1, 3))
    turned = np.outer(np.linspace(0.0, 1.0, n) ** 2, [0.0, turn, 0.0])
    none = np.zeros((n, 3))
    x = tables.make_table("X", np.array(own[:n]), aside, lost, turned)
    y = tables.make_table("Y", np.array(own[:n][::-1]), none, 0.0, none)
    z = tables.make_table("Z", np.zeros(n), none, 0.0, none)
    content = tables.make_content((x, y, z))
    name, choices = tables.ORDERS[order]
    kind = load_format(name, choices)
    files = kind.write(content)
    position = np.random.default_rng(0).uniform(0.0, 200.0, (40, 3))
    position[:, 0] = np.linspace(-20.0, 220.0, 40)  # beyond the ends as well
    for direction in (1.0, -1.0):
        ours = kind.read(files, tables.MACHINE)(position, direction)
        other = simulate(order, files, position, direction)
        np.testing.assert_allclose(ours, other, atol=2e-6)


@pytest.mark.parametrize("order", tables.ORDERS)
def test_rows_take_the_error_of_the_axis_away_to_the_resolution(order):
    content = tables.round_numbers()
    table, position = content.tables[0], np.full((3, 3), 100.0)
    position[:, 0] = table.position_mm
    files = tables.write_files(order)
    for direction, error in ((1.0, table.forward_mm), (-1.0, table.backward_mm)):
        added = simulate(order, files, position, direction)
        has_sides = order.split("-")[0] not in ("isg", "etalon")
        wanted = error if has_sides else table.forward_mm
        bound = {"fanuc": 1.1e-3}.get(order, 1.1e-5)
        np.testing.assert_allclose(added[:, 0], -wanted[:, 0], atol=bound)


def vary(own, half, across):
    turn, none = np.array([*own, own[0]]), np.zeros(len(own))
    c = tables.make_turn_table("C", turn, np.full(len(turn), half), across * turn)
    a = tables.make_turn_table("A", 0.5 * turn[:-1], none, none)
    return tables.make_rotary_content(a, c)


@pytest.mark.parametrize("order", TURNING)
@given(own=_turns, half=st.floats(0.0, 0.005))
@settings(max_examples=20, deadline=None)
def test_a_control_adds_to_rotary_axes_what_our_reader_says(order, own, half):
    name, choices = tables.ROTARY_ORDERS[order]
    kind, content = load_format(name, choices), vary(own, half, 0.0)
    files, position = kind.write(content), spread(tables.TRUNNION, 40)
    added = kind.read_rotary(files, tables.TRUNNION)
    for direction in (1.0, -1.0):
        other = simulate_trunnion(files, position, direction)
        for axis, one in added.items():
            column = tables.TRUNNION.axis_names.index(axis)
            ours = one.read(position[:, column], direction)
            np.testing.assert_allclose(ours, other[:, column], atol=1e-9)


@pytest.mark.parametrize("order", TURNING)
def test_rows_take_the_turn_away_to_the_resolution(order):
    files = tables.write_rotary_files(order)
    for table in tables.round_turns().rotary:
        column = tables.TRUNNION.axis_names.index(table.axis.name)
        position = np.zeros((len(table.position_deg), len(tables.TRUNNION.axes)))
        position[:, column] = table.position_deg
        for side in (1.0, -1.0):
            added = simulate_trunnion(files, position, side)[:, column]
            lost = side * table.half_deg if order == "linuxcnc" else 0.0
            wanted = -(table.error_deg + lost)
            np.testing.assert_allclose(added, wanted, atol=1.01e-6)


@pytest.mark.parametrize("order", ["isg-csv", "isg-csv-followed"])
@given(own=_turns, across=st.floats(-1.0, 1.0))
@settings(max_examples=10, deadline=None)
def test_a_control_composes_rotary_axes_as_our_reader_does(order, own, across):
    name, choices = tables.ROTARY_ORDERS[order]
    kind, content = load_format(name, choices), vary(own, 0.0, across)
    files, position = kind.write(content), spread(tables.TRUNNION, 40)
    ours = kind.read(files, tables.TRUNNION)(position, 1.0)
    other = simulate_trunnion(files, position, 1.0)
    # Our reader leaves out half the square of a turn, 0.011° at half a metre.
    np.testing.assert_allclose(ours, other[:, :3], atol=2e-5)
    assert not other[:, 3:].any()


@pytest.mark.parametrize("order", ["linuxcnc", "isg-csv", "json"])
def test_places_of_the_axes_are_read_back_to_the_resolution(order):
    name, choices = tables.ROTARY_ORDERS[order]
    files = tables.write_rotary_files(order)
    read = load_format(name, choices).read_locations(files, tables.TRUNNION)
    stated = tables.PLACES["A"] | tables.PLACES["C"]
    for symbol, value in read.items():
        resolution = 1e-6 if symbol[0] in "XYZ" else 1e-9
        assert value == pytest.approx(stated[symbol], abs=resolution)
    assert {"XOC", "YOC", "YOA", "ZOA"} <= set(read)


DIFFERENCE = {"backlash_reading": "difference"}
ROUNDING_UM = {"fanuc": 3.0, "heidenhain": 0.2}  # of three files; 0.1 of the others


def store(folder, files, names=None):
    written = []
    for name, text in files.items():
        place = folder / (names or {}).get(name, name)
        place.write_text(text)
        written.append(place)
    return written


def moments(position_mm, direction):
    n, none = len(position_mm), np.zeros_like(position_mm)
    at = np.zeros(n), np.full(n, -1), np.zeros(n)
    return Conditions(MACHINE, position_mm, none, *at, none, none + direction)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_files_are_read_by_the_choices_of_the_account_beside_them(tmp_path, direction):
    texts = write_files("heidenhain-difference")
    digests = {n: hashlib.sha256(t.encode()).hexdigest() for n, t in texts.items()}
    account = {"format": "heidenhain", "files_sha256": digests, "choices": DIFFERENCE}
    (tmp_path / "round.json").write_text(json.dumps(account))
    (tmp_path / "other.json").write_text("{")
    position_mm = np.array([[100.0, 30.0, 40.0], [300.0, 60.0, 90.0]])
    active = read_active_files(store(tmp_path, texts), "heidenhain", MACHINE)
    added = active.additional_correction_at(moments(position_mm, direction))
    read = load_format("heidenhain", DIFFERENCE).read(texts, MACHINE)
    usual = load_format("heidenhain").read(texts, MACHINE)
    assert added == pytest.approx(read(position_mm, direction), abs=1e-12)
    apart = np.abs(added - usual(position_mm, direction)).max()
    assert (apart > 1e-4) == (direction < 0.0)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_siemens_files_under_the_names_of_the_control_are_the_same(tmp_path, direction):
    at = moments(np.array([[90.0, 30.0, 40.0]]), direction)
    own = {"round-lec.ini": "AX_EEC.INI", "round-cec.ini": "NC_CEC.INI"}
    added = []
    for names in ({}, own):
        written = store(tmp_path, write_files("siemens"), names)
        active = read_active_files(written, "siemens", MACHINE)
        added.append(active.additional_correction_at(at))
    assert np.abs(added[0]).max() > 1e-3
    assert added[1] == pytest.approx(added[0])


@pytest.mark.parametrize(
    ("order", "change", "words"),
    [
        ("siemens", lambda f: f.pop("round-cec.ini"), "holds _CEC tables"),
        ("siemens", lambda f: f.update({"a.ini": "M17"}), "a.ini: holds no tables"),
        ("heidenhain", lambda f: f.pop("config.cma"), "config.cma is missing"),
        ("heidenhain", lambda f: f.pop("round-X.com"), "round-X.com is missing"),
        ("linuxcnc", lambda f: f.update({"x.comp": f.pop("round-X.tbl")}), "x.comp"),
        ("fanuc", lambda f: f.pop(next(iter(f))), "has a name that ends in"),
        ("csv", lambda f: f.update({"b.csv": ""}), "cannot be read as files of csv"),
    ],
)
def test_missing_or_useless_files_are_refused(tmp_path, order, change, words):
    files = write_files(order)
    change(files)
    with pytest.raises(BadInput, match=words):
        read_active_files(store(tmp_path, files), order, MACHINE)


def make_errors(loaded, size, lost_um):
    half = {"EXX": HalfDifference(np.array([-200.0, 300.0]), np.array(lost_um))}
    theta = size * loaded.theta
    return map_errors(replace(loaded, theta=theta, halves=half))


@pytest.mark.parametrize("name", list_formats())
def test_combined_files_add_what_active_ones_and_the_difference_add(name, loaded):
    found = make_errors(loaded, 0.6, [3.0, 5.0])
    left = make_errors(loaded, -0.2, [-1.0, 2.0])
    made = tabulate(found, name, 10.0)
    data = {file: text.encode() for file, text in made.write(found).items()}
    active = make_active_files(data, name, found.machine, {})
    combined = replace(made, active=active)
    place, _ = sample_travel(found)
    off_um = []
    for side in (1.0, -1.0):
        both = (one.read_back(left)(place, side) for one in (combined, made))
        off_um.append(1e3 * np.subtract(*both))
    off_um -= np.mean(off_um, axis=(0, 1))
    added_um = 1e3 * active.correction(place, 1.0)
    assert np.abs(added_um).max() > 10.0
    assert np.abs(off_um).max() < ROUNDING_UM.get(name, 0.1)
