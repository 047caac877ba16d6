"""`path.csv` and `points.csv` of a bundle: what was commanded, row by row."""

from __future__ import annotations

import io
import re

import numpy as np
from numpy.typing import NDArray

from app.errors import BundleError
from app.files.tables import Table, read_csv
from app.kinematics.machine import LinearAxis, Machine
from app.motion.configurations import Configurations
from app.motion.travel import first_breach
from drivers.interfaces.records import Path

_AXIS_COLUMN = re.compile(r"^([a-z])_(mm|deg)$")


def decode_path(data: bytes, machine: Machine, *, file: str = "path.csv") -> Path:
    """Return the path of a `path.csv`."""
    table = read_csv(data, file)
    position = _read_positions(table, machine)
    feed_mm_min = _read_feed(table)
    path = Path(
        machine.axis_names,
        position,
        feed_mm_min,
        _read_dwell(table),
        _read_targets(table, machine),
    )
    _refuse_standing_lines(table, path)
    _refuse_out_of_travel(table, machine, path)
    return path


def decode_points(
    data: bytes, machine: Machine, *, file: str = "points.csv"
) -> Configurations:
    """Return the standstill points of a `points.csv`."""
    table = read_csv(data, file)
    points = Configurations(
        machine.axis_names,
        _read_positions(table, machine),
        _read_dwell(table),
        _read_targets(table, machine),
    )
    _refuse_out_of_travel(table, machine, points)
    return points


def encode_commanded(commanded: Path | Configurations, machine: Machine) -> bytes:
    """Return the `path.csv` of a path or the `points.csv` of points."""
    units = dict(zip(machine.axis_names, name_columns(machine), strict=True))
    columns: dict[str, list[str]] = {
        units[name]: [repr(float(v)) for v in commanded.position[:, index]]
        for index, name in enumerate(commanded.axes)
    }
    if isinstance(commanded, Path):
        columns["feed_mm_min"] = [repr(float(v)) for v in commanded.feed_mm_min]
    columns["dwell_s"] = [repr(float(v)) for v in commanded.dwell_s]
    if commanded.target:
        columns["target"] = list(commanded.target)
    text = io.StringIO()
    text.write(",".join(columns) + "\n")
    for row in zip(*columns.values(), strict=True):
        text.write(",".join(row) + "\n")
    return text.getvalue().encode()


def name_columns(machine: Machine) -> list[str]:
    """Return the names of the columns of axis positions."""
    return [
        f"{axis.name.lower()}_{'mm' if isinstance(axis, LinearAxis) else 'deg'}"
        for axis in machine.axes
    ]


def _read_positions(table: Table, machine: Machine) -> NDArray[np.float64]:
    """Return the axis positions of every row in the column order of the machine."""
    wanted = name_columns(machine)
    for name in table.names:
        if _AXIS_COLUMN.match(name) and name not in wanted:
            raise BundleError(
                "is an unknown axis",
                file=table.file,
                column=name,
                remedy=f"the machine has {', '.join(wanted)}",
            )
    table.require(*wanted)
    if len(table) == 0:
        raise BundleError("has no rows", file=table.file, remedy="command something")
    return np.stack([table.numbers(name) for name in wanted], axis=1)


def _read_dwell(table: Table) -> NDArray[np.float64]:
    dwell_s = table.numbers("dwell_s")
    if (dwell_s < 0).any():
        index = int(np.argmax(dwell_s < 0))
        raise table.error(f"is {dwell_s[index]:g}, below 0", index, "dwell_s")
    return dwell_s


def _read_feed(table: Table) -> NDArray[np.float64]:
    feed = table.numbers("feed_mm_min")
    if (feed <= 0).any():
        index = int(np.argmax(feed <= 0))
        raise table.error(
            f"is {feed[index]:g}", index, "feed_mm_min", "a feed must be above 0"
        )
    return feed


def _read_targets(table: Table, machine: Machine) -> tuple[str, ...]:
    if "target" not in table.names:
        return ()
    known = {target.name for target in machine.targets}
    words = table.texts("target")
    for index, word in enumerate(words):
        if word not in known:
            named = ", ".join(sorted(known - {""})) or "no named target"
            raise table.error(
                f"is {word!r}, unknown", index, "target", f"machine.json has {named}"
            )
    return tuple(words)


def _refuse_standing_lines(table: Table, path: Path) -> None:
    """Refuse a row that repeats the one before, unless it changes the target."""
    if len(path) < 2:
        raise BundleError(
            "has one row, and no line", file=table.file, remedy="a path needs two rows"
        )
    repeated = (np.diff(path.position, axis=0) == 0).all(axis=1)
    for index in np.flatnonzero(repeated) + 1:
        if not path.target or path.target[index] == path.target[index - 1]:
            raise table.error(
                "the line starts where it ends: the row repeats the one before",
                int(index),
                None,
                "remove the row; give a longer dwell_s to stand still",
            )


def _refuse_out_of_travel(
    table: Table, machine: Machine, commanded: Path | Configurations
) -> None:
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise table.error(
            f"is out of travel: {breach}",
            breach.index,
            f"{breach.axis.lower()}_{breach.unit}",
            "correct the row, or the travel in machine.json",
        )
