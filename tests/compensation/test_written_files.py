"""What is written is what is read, by the control's rules and by other hands.

The golden files were held against the public pages by hand: LinuxCNC `usrmotintf.cc`
(three numbers a row); SINUMERIK Function Manual Extended Functions 03/2013, pages 242
(`$AA_ENC_COMP`), 248, 249 and 252 (`$AN_CEC`, product, number = index + 1); MANUALplus
620, pages 716 and 718 (`AXISPOS`, `BACKLASH`, `.cma`); FANUC B-63980EN, page 100, and
A-77810E (points, increments, 3605 to 3627); ISG kernel manual (blocks, `//`, `#`);
Beckhoff TF5280, "Etalon Exchange Format" ([NAME], VALUE, Gridpoints) and "Units of
measure" (mm, rad).
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.compensation.written_tables import (
    CONTENT,
    GOLDEN,
    ORDERS,
    make_content,
    make_table,
    round_numbers,
    write_files,
)

from truepath.compensation.installed import load_format
from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.compensation.rules import Rules
from truepath_simulators.machine_file import parse_machine

MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
SIMULATED = parse_machine(CONTENT)
RESOLUTION_MM = {"fanuc": 1.1e-3}


def simulate(order, files, position, direction):
    """What the simulated controller adds, (n, 3)."""
    reading = "difference" if order == "heidenhain-difference" else "negative-value"
    systems = {"siemens-system-2": 2, "siemens-system-by-axis": "X=2"}
    rules = Rules(reading, tool_length_mm=100.0, measuring_system=systems.get(order, 1))
    correction = LoadedTables(files, rules).correct(SIMULATED)
    assert correction is not None
    return correction.added(position, np.full_like(position, direction))


@pytest.mark.parametrize("order", ORDERS)
def test_files_are_the_golden_ones(order):
    golden = {p.name: p.read_text(encoding="ascii") for p in (GOLDEN / order).iterdir()}
    assert write_files(order) == golden


def test_golden_values_are_those_that_the_pages_ask_for():
    read = {order: write_files(order) for order in ORDERS}
    assert read["linuxcnc"]["round-X.tbl"].splitlines()[1] == (
        "100.000000 100.005000 99.999000"
    )
    lec = read["siemens"]["round-lec.ini"].splitlines()
    assert "$AA_ENC_COMP[0,1,X1]=0.005000" in lec
    assert "$AA_ENC_COMP_MAX[0,X1]=200.000000" in lec
    cec = read["siemens"]["round-cec.ini"].splitlines()
    assert "$AN_CEC_DIRECTION[1]=-1" in cec
    assert "$AN_CEC_MULT_BY_TABLE[2]=4" in cec  # the fourth table has index 3
    row = read["heidenhain"]["round-X.com"].splitlines()[3].split()
    assert row == ["1", "+100.0000", "-0.00100", "+0.00500", "+0.02000", "+0.00000"]
    etalon = read["etalon-exchange"]["round.txt"].splitlines()
    begin = etalon.index("[EYX]")
    assert etalon[begin + 1 : begin + 3] == ["Gridpoints = {", "  0.000000 0.000000"]
    assert etalon[begin + 3].split() == ["100.000000", "0.020000"]
    assert etalon[begin + 5] == "}  // end of EYX"
    fanuc = read["fanuc"]["round-parameters.txt"].split()
    assert "N03621A1P1A2P5A3P8" not in fanuc  # negative travel of X stands between
    assert fanuc[1] == "N03605A1P00000001A2P00000000A3P00000000"
    assert next(w for w in fanuc if w.startswith("N03627")) == "N03627A1P6A2P0A3P0"


_values = st.lists(st.floats(-0.03, 0.03), min_size=3, max_size=6)


@pytest.mark.parametrize("order", ORDERS)
@given(
    own=_values, across=_values, lost=st.floats(0.0, 0.01), turn=st.floats(-1e-4, 1e-4)
)
@settings(max_examples=25, deadline=None)
def test_our_reader_and_the_simulated_controller_read_the_same(
    order, own, across, lost, turn
):
    if order == "fanuc":  # steps that every control takes
        own = (np.array(own) * 0.1).tolist()
    n = min(len(own), len(across))
    aside = np.tile(np.array(across[:n])[:, None], (1, 3))
    turned = np.outer(np.linspace(0.0, 1.0, n) ** 2, [0.0, turn, 0.0])
    none = np.zeros((n, 3))
    content = make_content(
        (
            make_table("X", np.array(own[:n]), aside, lost, turned),
            make_table("Y", np.array(own[:n][::-1]), none, 0.0, none),
            make_table("Z", np.zeros(n), none, 0.0, none),
        )
    )
    name, choices = ORDERS[order]
    kind = load_format(name, choices)
    files = kind.write(content)
    position = np.random.default_rng(0).uniform(0.0, 200.0, (40, 3))
    position[:, 0] = np.linspace(-20.0, 220.0, 40)  # beyond the ends as well
    for direction in (1.0, -1.0):
        ours = kind.read(files, MACHINE)(position, direction)
        other = simulate(order, files, position, direction)
        np.testing.assert_allclose(ours, other, atol=2e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_rows_take_the_error_of_the_axis_away_to_the_resolution(order):
    content = round_numbers()
    table, position = content.tables[0], np.full((3, 3), 100.0)
    position[:, 0] = table.position_mm
    files = write_files(order)
    for direction, error in ((1.0, table.forward_mm), (-1.0, table.backward_mm)):
        added = simulate(order, files, position, direction)
        wanted = (
            error if order.split("-")[0] not in ("isg", "etalon") else table.forward_mm
        )
        bound = RESOLUTION_MM.get(order, 1.1e-5)
        np.testing.assert_allclose(added[:, 0], -wanted[:, 0], atol=bound)
