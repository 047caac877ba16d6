"""A table of round numbers, and the golden files that each format makes of it.

Run this file to write `golden/` anew after a change that was looked at; what the files
have to be is in the pages that `test_written_files.py` names.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from truepath.compensation.format import AxisTable, CompensationTables
from truepath.compensation.installed import load_format
from truepath.files.bundle.machine_file import machine_from_json

GOLDEN = Path(__file__).resolve().parent / "golden"
ORDERS = {
    "linuxcnc": ("linuxcnc", {}),
    "siemens": ("siemens", {}),
    "siemens-system-2": ("siemens", {"measuring_system": "2"}),
    "siemens-system-by-axis": ("siemens", {"measuring_system": "X=2,Y=1"}),
    "heidenhain": ("heidenhain", {}),
    "heidenhain-difference": ("heidenhain", {"backlash_reading": "difference"}),
    "fanuc": ("fanuc", {}),
    "isg-csv": ("isg-csv", {}),
    "isg-csv-followed": ("isg-csv", {"tool_length": "followed"}),
    "etalon-exchange": ("etalon-exchange", {}),
    "etalon-exchange-followed": ("etalon-exchange", {"tool_length": "followed"}),
    "csv": ("csv", {}),
    "json": ("json", {}),
}
CONTENT = {
    "schema": "machine/1",
    "name": "round numbers",
    "kinematic_chain": "w-b-X-Y-Z-t",
    "axes": {
        name: {"type": "linear", "min_mm": 0.0, "max_mm": 200.0} for name in "XYZ"
    },
    "tool_offset_mm": [0.0, 0.0, -100.0],
}


def make_table(
    axis: str,
    own_mm: np.ndarray,
    across_mm: np.ndarray,
    lost_mm: float,
    turn_rad: np.ndarray,
) -> AxisTable:
    """Return a table over 0 to 200 mm: own error, across (n, 3), pitch about each."""
    machine = machine_from_json(dict(CONTENT), file="machine.json")
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
    return AxisTable(machine.linear(axis), at, 0, forward, backward, translation, turn)


def make_content(tables: tuple[AxisTable, ...]) -> CompensationTables:
    """Return the content of files."""
    machine = machine_from_json(dict(CONTENT), file="machine.json")
    return CompensationTables("round", machine, tables, ("by hand",))


def round_numbers() -> CompensationTables:
    """Return 5 µm a step in X with 6 µm lost, 20 µm across, 50 µrad of pitch."""
    steps, none = np.arange(3.0), np.zeros((3, 3))
    across, turn = none.copy(), none.copy()
    across[:, 1] = [0.0, 0.020, 0.0]
    turn[:, 1] = [0.0, 50e-6, 0.0]
    return make_content(
        (
            make_table("X", 0.005 * steps, across, 0.006, turn),
            make_table("Y", -0.005 * steps, none, 0.0, none),
            make_table("Z", np.zeros(3), none, 0.0, none),
        )
    )


def write_files(order: str) -> dict[str, str]:
    """Return the files of an order, by name."""
    name, choices = ORDERS[order]
    return load_format(name, choices).write(round_numbers())


def main() -> None:
    """Write `golden/` anew."""
    for order in ORDERS:
        folder = GOLDEN / order
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in write_files(order).items():
            (folder / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
