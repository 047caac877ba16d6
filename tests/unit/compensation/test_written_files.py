"""What is written is what is read, by the control's rules and by other hands.

The golden files were held against the public pages by hand: LinuxCNC `usrmotintf.cc`
(nominal, forward, reverse) and `trtfuncs.c` (pins of `xyzac-trt-kins`); SINUMERIK
Function Manual Extended Functions 03/2013, pages 238 to 242 (`$AA_ENC_COMP`, of an axis
in deg, `_IS_MODULO`, first and last value the same), 248, 249 and 252 (`$AN_CEC`,
product, number = index + 1); MANUALplus 620, pages 716 and 718 (`AXISPOS`, `BACKLASH`,
`.cma`); FANUC B-63980EN, page 100, and A-77810E (points, increments, 3605 to 3627); ISG
kernel manual (blocks, `//`, `#`), "List of parameters supported" and "Units of measure"
(P0X, PXC, X0C, EXC … over degrees, rad); Beckhoff TF5280, "Etalon Exchange Format"
([NAME], VALUE, Gridpoints) and "Units of measure" (mm, rad).
"""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import written_tables as tables
from known_machines import spread
from truepath.compensation.format_registry import load_format
from truepath_simulators.compensation.correction import Rules
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.machine_file import parse_machine

SIMULATED = parse_machine(tables.CONTENT)
SIMULATED_TRUNNION = parse_machine(tables.ROTARY_CONTENT)
TURNING = ("linuxcnc", "siemens", "siemens-lec")
COMPOSING = ("isg-csv", "isg-csv-followed")
RESOLUTION_MM = {"fanuc": 1.1e-3}
RESOLUTION_DEG = 1.01e-6
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
        bound = RESOLUTION_MM.get(order, 1.1e-5)
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
            np.testing.assert_allclose(added, wanted, atol=RESOLUTION_DEG)


@pytest.mark.parametrize("order", COMPOSING)
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
