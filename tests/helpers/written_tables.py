"""Tables of round numbers, and the golden files that each format makes of them.

Run this file to write `golden/` anew after a change that was looked at; what the files
have to be is in the pages that `test_written_files.py` names.
"""

from pathlib import Path

import numpy as np

from truepath.compensation.format import (
    AxisTable,
    CompensationTables,
    RotaryAxisLocation,
    RotaryTable,
)
from truepath.compensation.format_registry import load_format
from truepath.files.bundle.machine_file import machine_from_json

# By hand: 0, 0.01 and 0.02 mm of error at -100, 0 and 100 mm of X.
LEADSCREW = """%_N_AX_EEC_INI
$AA_ENC_COMP[0,0,X1]=0.0 ; by hand
$AA_ENC_COMP[0,1,X1]=0.01
$AA_ENC_COMP[0,2,X1]=0.02
$AA_ENC_COMP_STEP[0,X1]=100.0
$AA_ENC_COMP_MIN[0,X1]=-100.0
$AA_ENC_COMP_MAX[0,X1]=100.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
"""
GOLDEN = Path(__file__).resolve().parent / "golden"
WITHOUT_CHOICE = "linuxcnc siemens heidenhain fanuc isg-csv etalon-exchange csv json"
ORDERS = {name: (name, {}) for name in WITHOUT_CHOICE.split()} | {
    "siemens-system-2": ("siemens", {"measuring_system": "2"}),
    "siemens-system-by-axis": ("siemens", {"measuring_system": "X=2,Y=1"}),
    "heidenhain-difference": ("heidenhain", {"backlash_reading": "difference"}),
    "isg-csv-followed": ("isg-csv", {"tool_length": "followed"}),
    "etalon-exchange-followed": ("etalon-exchange", {"tool_length": "followed"}),
}
ROTARY_ORDERS = {
    order: ORDERS[order]
    for order in ("linuxcnc", "siemens", "isg-csv", "isg-csv-followed", "json")
} | {"siemens-lec": ("siemens-lec", {})}
STRAIGHT = {"type": "linear", "min_mm": 0.0, "max_mm": 200.0}
CONTENT = {"schema": "machine/1", "name": "round numbers"}
CONTENT |= {"kinematic_chain": "w-b-X-Y-Z-t", "tool_offset_mm": [0.0, 0.0, -100.0]}
CONTENT |= {"axes": dict.fromkeys("XYZ", STRAIGHT)}
MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
TURN = {"type": "rotary", "min_deg": 0.0, "max_deg": 360.0}
TILT = {"type": "rotary", "min_deg": -90.0, "max_deg": 90.0}
ROTARY_CONTENT = {
    **CONTENT,
    "name": "round trunnion",
    "kinematic_chain": "w-C-A-b-X-Y-Z-t",
    "axes": {
        **dict.fromkeys("XYZ", STRAIGHT),
        "A": {**TILT, "origin_mm": [100.0, 100.0, -50.0]},
        "C": {**TURN, "origin_mm": [100.0, 100.0, -70.0]},
    },
}
TRUNNION = machine_from_json(dict(ROTARY_CONTENT), file="machine.json")
PLACES = {
    "A": {"YOA": -0.015, "ZOA": 0.03, "BOA": 20e-6, "COA": 0.0},
    "C": {"XOC": 0.01, "YOC": -0.02, "AOC": 0.0, "BOC": -30e-6},
}


def make_table(axis, own_mm, across_mm, lost_mm, turn_rad):
    """Return a table over 0 to 200 mm: own error, across (n, 3), pitch about each."""
    n, own = len(own_mm), "XYZ".index(axis)
    forward = np.array(across_mm, float)
    forward[:, own] = own_mm
    forward -= forward[0]
    backward = forward.copy()
    backward[:, own] -= lost_mm
    middle = np.where(np.arange(3) > own, 100.0, 0.0)  # of the later axes
    turn = np.array(turn_rad, float) - turn_rad[0]
    translation = forward - np.cross(turn, middle)
    at = np.linspace(0.0, 200.0, n)
    return AxisTable(MACHINE.linear(axis), at, 0, forward, backward, translation, turn)


def make_content(tables):
    return CompensationTables("round", MACHINE, tables, ("by hand",))


def round_numbers():
    """Return 5 µm a step in X with 6 µm lost, 20 µm across, 50 µrad of pitch."""
    steps, none = np.arange(3.0), np.zeros((3, 3))
    across, turn = none.copy(), none.copy()
    across[:, 1] = [0.0, 0.020, 0.0]
    turn[:, 1] = [0.0, 50e-6, 0.0]
    x = make_table("X", 0.005 * steps, across, 0.006, turn)
    y = make_table("Y", -0.005 * steps, none, 0.0, none)
    return make_content((x, y, make_table("Z", np.zeros(3), none, 0.0, none)))


def make_turn_table(axis, error_deg, half_deg, across_mm):
    rotary = TRUNNION.rotary(axis)
    at = np.linspace(rotary.low, rotary.high, len(error_deg))
    motions = np.zeros((len(at), 6))
    motions[:, 0] = across_mm
    motions[:, 3 + "ABC".index(axis)] = -np.radians(error_deg)
    return RotaryTable(rotary, at, error_deg, motions, half_deg)


def make_rotary_content(*turns):
    """Return the content of files: straight axes without errors, rotary ones off."""
    at, none = np.array([0.0, 200.0]), np.zeros((2, 3))
    tables = tuple(AxisTable(one, at, 0, *[none] * 4) for one in TRUNNION.linear_axes)
    axes = TRUNNION.rotary_axes
    places = tuple(RotaryAxisLocation(one, PLACES[one.name]) for one in axes)
    turned = {"rotary": turns, "places": places}
    return CompensationTables("round", TRUNNION, tables, ("by hand",), **turned)


def round_turns():
    """Return a C axis that turns 0.001 deg a quarter too far, and loses as much."""
    none, half = np.zeros(3), np.full(5, 0.0005)
    step = np.array([0.0, 0.001, 0.002, 0.001, 0.0])
    return make_rotary_content(
        make_turn_table("A", np.array([-0.002, 0.0, 0.002]), none, none),
        make_turn_table("C", step, half, np.array([0.0, 0.01, 0.0, -0.01, 0.0])),
    )


def write_files(order):
    name, choices = ORDERS[order]
    return load_format(name, choices).write(round_numbers())


def write_rotary_files(order):
    name, choices = ROTARY_ORDERS[order]
    return load_format(name, choices).write(round_turns())


def main():
    made = {order: write_files(order) for order in ORDERS}
    made |= {f"{order}-rotary": write_rotary_files(order) for order in ROTARY_ORDERS}
    for folder, files in made.items():
        (GOLDEN / folder).mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (GOLDEN / folder / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
