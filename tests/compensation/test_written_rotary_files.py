"""Files of rotary axes: what is written is what is read, and what the pages ask for.

The golden files were held against the public pages by hand: LinuxCNC `usrmotintf.cc`
(nominal, forward, reverse) and `trtfuncs.c` (pins of `xyzac-trt-kins`); SINUMERIK
Function Manual Extended Functions 03/2013, K3, pages 238 to 242 (`$AA_ENC_COMP` of an
axis in deg, `_IS_MODULO`, first and last value the same); ISG kernel manual, "List of
parameters supported" and "Units of measure" (P0X, PXC, X0C, EXC … over degrees, rad).
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.compensation.written_rotary_tables import (
    CONTENT,
    GOLDEN,
    MACHINE,
    ORDERS,
    PLACES,
    make_content,
    make_turn_table,
    round_turns,
    write_files,
)

from truepath.compensation.installed import load_format
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.machine_file import parse_machine

SIMULATED = parse_machine(CONTENT)
TURNING = ("linuxcnc", "siemens", "siemens-lec")
COMPOSING = ("isg-csv", "isg-csv-followed")
RESOLUTION_DEG, RESOLUTION_MM = 1.01e-6, 1e-5
_values = st.lists(st.floats(-0.01, 0.01), min_size=4, max_size=9)


def simulate(files, position, direction):
    """What the simulated controller adds, (n, axes)."""
    correction = LoadedTables(files, Rules(tool_length_mm=100.0)).correct(SIMULATED)
    assert correction is not None
    return correction.added(position, np.full_like(position, direction))


def spread(count):
    low, high = (
        np.array([getattr(a, k) for a in MACHINE.axes]) for k in ("low", "high")
    )
    return low + np.random.default_rng(0).uniform(size=(count, len(low))) * (high - low)


def vary(own, half, across):
    """Content of files: C as it is told, its last row the first, and A half of it."""
    turn = np.array([*own, own[0]])
    offset = np.array([across * value for value in turn])
    a = make_turn_table(
        "A", 0.5 * np.array(own), np.zeros(len(own)), np.zeros(len(own))
    )
    return make_content(a, make_turn_table("C", turn, np.full(len(turn), half), offset))


@pytest.mark.parametrize("order", ORDERS)
def test_files_are_the_golden_ones(order):
    folder = GOLDEN / f"{order}-rotary"
    golden = {p.name: p.read_text(encoding="ascii") for p in folder.iterdir()}
    assert write_files(order) == golden


def test_golden_values_are_those_that_the_pages_ask_for():
    read = {order: write_files(order) for order in ORDERS}
    rows = read["linuxcnc"]["round-C.tbl"].splitlines()
    assert "90.000000 90.001500 90.000500" in rows
    assert "450.000000 450.001500 450.000500" in rows  # a wrapped joint counts on
    assert rows[-1] == "720.000000 720.000500 719.999500"
    pins = read["linuxcnc"]["round-kinematics.hal"].splitlines()
    assert "setp xyzac-trt-kins.x-rot-point 100.010000" in pins
    assert "setp xyzac-trt-kins.z-offset 20.030000" in pins  # -50 + 0.03 - (-70)
    lec = read["siemens-lec"]["round.ini"].splitlines()
    assert "$AA_ENC_COMP[0,1,C1]=0.001000" in lec
    assert "$AA_ENC_COMP_STEP[0,C1]=90" in lec
    assert "$AA_ENC_COMP_MAX[0,C1]=360.000000" in lec
    assert "$AA_ENC_COMP_IS_MODULO[0,C1]=1" in lec
    assert "$AA_ENC_COMP_IS_MODULO[0,A1]=0" in lec
    isg = read["isg-csv"]["round.csv"].splitlines()
    assert isg[isg.index("X0C  Y0C  A0C  B0C") + 1] == (
        "0.010000  -0.020000  0.000000000  -0.000030000"
    )
    begin = isg.index("C  EXC  EYC  EZC  EAC  EBC  ECC")
    assert isg[begin + 2].split()[:2] == ["90.000000", "0.010000"]
    assert isg[begin + 2].split()[-1] == "-0.000017453"  # the table turns too far
    stated = json.loads(read["json"]["round.tables.json"])["rotary_axes"]["C"]
    assert stated["location"] == {"XOC": 10.0, "YOC": -20.0, "AOC": 0.0, "BOC": -30.0}


@pytest.mark.parametrize("order", TURNING)
@given(own=_values, half=st.floats(0.0, 0.005))
@settings(max_examples=20, deadline=None)
def test_a_control_adds_to_rotary_axes_what_our_reader_says(order, own, half):
    name, choices = ORDERS[order]
    kind, content = load_format(name, choices), vary(own, half, 0.0)
    files, position = kind.write(content), spread(40)
    added = kind.read_rotary(files, MACHINE)
    for direction in (1.0, -1.0):
        other = simulate(files, position, direction)
        for axis, one in added.items():
            column = MACHINE.axis_names.index(axis)
            ours = one.read(position[:, column], direction)
            np.testing.assert_allclose(ours, other[:, column], atol=1e-9)


@pytest.mark.parametrize("order", TURNING)
def test_rows_take_the_turn_away_to_the_resolution(order):
    files = write_files(order)
    for table in round_turns().rotary:
        column = MACHINE.axis_names.index(table.axis.name)
        position = np.zeros((len(table.position_deg), len(MACHINE.axes)))
        position[:, column] = table.position_deg
        for side in (1.0, -1.0):
            added = simulate(files, position, side)[:, column]
            lost = side * table.half_deg if order == "linuxcnc" else 0.0
            wanted = -(table.error_deg + lost)
            np.testing.assert_allclose(added, wanted, atol=RESOLUTION_DEG)


@pytest.mark.parametrize("order", COMPOSING)
@given(own=_values, across=st.floats(-1.0, 1.0))
@settings(max_examples=10, deadline=None)
def test_a_control_composes_rotary_axes_as_our_reader_does(order, own, across):
    name, choices = ORDERS[order]
    kind, content = load_format(name, choices), vary(own, 0.0, across)
    files, position = kind.write(content), spread(40)
    ours = kind.read(files, MACHINE)(position, 1.0)
    other = simulate(files, position, 1.0)
    np.testing.assert_allclose(ours, other[:, :3], atol=RESOLUTION_MM)
    assert not other[:, 3:].any()


@pytest.mark.parametrize("order", ["linuxcnc", "isg-csv", "json"])
def test_places_of_the_axes_are_read_back_to_the_resolution(order):
    name, choices = ORDERS[order]
    read = load_format(name, choices).read_locations(write_files(order), MACHINE)
    stated = PLACES["A"] | PLACES["C"]
    assert set(read) <= set(stated)
    for symbol, value in read.items():
        assert value == pytest.approx(
            stated[symbol], abs=1e-6 if symbol[0] in "XYZ" else 1e-9
        )
    assert {"XOC", "YOC", "YOA", "ZOA"} <= set(read)
