"""Round numbers of a trunnion, and the golden files that each format makes of them.

Run this file to write `golden/…-rotary` anew after a change that was looked at; what
the files have to be is in the pages that `test_written_rotary_files.py` names.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from truepath.compensation.format import AxisTable, CompensationTables
from truepath.compensation.installed import load_format
from truepath.compensation.rotary_tables import AxisPlace, RotaryTable
from truepath.files.bundle.machine_file import machine_from_json

GOLDEN = Path(__file__).resolve().parent / "golden"
ORDERS = {
    "linuxcnc": ("linuxcnc", {}),
    "siemens": ("siemens", {}),
    "siemens-lec": ("siemens-lec", {}),
    "isg-csv": ("isg-csv", {}),
    "isg-csv-followed": ("isg-csv", {"tool_length": "followed"}),
    "json": ("json", {}),
}
_STRAIGHT = {"type": "linear", "min_mm": 0.0, "max_mm": 200.0}
CONTENT = {
    "schema": "machine/1",
    "name": "round trunnion",
    "kinematic_chain": "w-C-A-b-X-Y-Z-t",
    "axes": {
        **dict.fromkeys("XYZ", _STRAIGHT),
        "A": {
            "type": "rotary",
            "min_deg": -90.0,
            "max_deg": 90.0,
            "origin_mm": [100.0, 100.0, -50.0],
        },
        "C": {
            "type": "rotary",
            "min_deg": 0.0,
            "max_deg": 360.0,
            "origin_mm": [100.0, 100.0, -70.0],
        },
    },
    "tool_offset_mm": [0.0, 0.0, -100.0],
}
MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
PLACES = {
    "A": {"YOA": -0.015, "ZOA": 0.03, "BOA": 20e-6, "COA": 0.0},
    "C": {"XOC": 0.01, "YOC": -0.02, "AOC": 0.0, "BOC": -30e-6},
}


def make_turn_table(
    axis: str, error_deg: np.ndarray, half_deg: np.ndarray, across_mm: np.ndarray
) -> RotaryTable:
    """Return a table over the travel of an axis that carries the workpiece."""
    rotary = MACHINE.rotary(axis)
    at = np.linspace(rotary.low, rotary.high, len(error_deg))
    motions = np.zeros((len(at), 6))
    motions[:, 0] = across_mm
    motions[:, 3 + "ABC".index(axis)] = -np.radians(error_deg)
    return RotaryTable(rotary, at, error_deg, motions, half_deg)


def make_content(*turns: RotaryTable) -> CompensationTables:
    """Return the content of files: straight axes without errors, rotary ones off."""
    at, none = np.array([0.0, 200.0]), np.zeros((2, 3))
    tables = tuple(
        AxisTable(axis, at, 0, none, none, none, none) for axis in MACHINE.linear_axes
    )
    places = tuple(AxisPlace(axis, PLACES[axis.name]) for axis in MACHINE.rotary_axes)
    return CompensationTables(
        "round", MACHINE, tables, ("by hand",), rotary=turns, places=places
    )


def round_turns() -> CompensationTables:
    """Return a C axis that turns 0.001 deg a quarter too far, and loses as much."""
    none, half = np.zeros(3), np.full(5, 0.0005)
    step = np.array([0.0, 0.001, 0.002, 0.001, 0.0])
    return make_content(
        make_turn_table("A", np.array([-0.002, 0.0, 0.002]), none, none),
        make_turn_table("C", step, half, np.array([0.0, 0.01, 0.0, -0.01, 0.0])),
    )


def write_files(order: str) -> dict[str, str]:
    """Return the files of an order, by name."""
    name, choices = ORDERS[order]
    return load_format(name, choices).write(round_turns())


def main() -> None:
    """Write `golden/…-rotary` anew."""
    for order in ORDERS:
        folder = GOLDEN / f"{order}-rotary"
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in write_files(order).items():
            (folder / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
