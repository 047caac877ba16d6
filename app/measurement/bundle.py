"""The measurement bundle of the file formats, a folder or a .zip, to and from a Run.

A bundle that cannot be used is one BundleError naming file, row and column; rows are
counted as `tables` says. A tracker stream has no counter in a bundle: it is rebuilt from
the clock, a pause of k sample intervals counting as k - 1 lost samples.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray

from app.errors import BundleError
from app.kinematics.machine import LinearAxis, Machine
from app.measurement.bundle_files import BundleFiles, open_bundle
from app.measurement.machine_file import decode_machine
from app.measurement.run import DirectMeasurement, Run
from app.measurement.tables import Table, read_csv, read_parquet
from app.planning.configurations import Configurations
from app.planning.travel import first_breach
from drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples

_AXIS_COLUMN = re.compile(r"^([a-z])_(mm|deg)$")
_SYMBOL = re.compile(r"^[A-Z][0-9A-Z][A-Z]$")
_UNITS = ("um", "urad")
_DEGC = "_degC"


def read_bundle(path: str | FilePath) -> Run:
    """Read a bundle from a folder or a .zip. Raises BundleError."""
    with open_bundle(path) as files:
        machine = decode_machine(_required(files, "machine.json"))
        tracker_file = _one_of(files, "tracker.parquet", "tracker.csv")
        commanded_file = _one_of(files, "path.csv", "points.csv")
        commanded = _commanded(files, commanded_file, machine)
        data = files.read(tracker_file)
        return Run(
            name=_name(FilePath(path)),
            machine=machine,
            commanded=commanded,
            tracker=_tracker(data, tracker_file),
            temperature=_environment(files),
            reference=_reference(files),
            provenance={
                "source": FilePath(path).name,
                f"{tracker_file} sha256": hashlib.sha256(data).hexdigest(),
            },
        )


def _name(path: FilePath) -> str:
    place = path.resolve()
    return place.name if place.is_dir() else place.stem


def _required(files: BundleFiles, name: str) -> bytes:
    if name not in files:
        raise BundleError(
            "is missing from the bundle", file=name, remedy="add the file"
        )
    return files.read(name)


def _one_of(files: BundleFiles, first: str, second: str) -> str:
    if first in files and second in files:
        raise BundleError(
            f"stands beside {second}",
            file=first,
            remedy="a bundle holds one of the two",
        )
    if first not in files and second not in files:
        raise BundleError(
            f"is missing from the bundle, and so is {second}",
            file=first,
            remedy="add one of the two",
        )
    return first if first in files else second


def _commanded(
    files: BundleFiles, name: str, machine: Machine
) -> Path | Configurations:
    table = read_csv(files.read(name), name)
    position = _positions(table, machine)
    dwell_s = _dwell(table)
    target = _target_column(table, machine)
    commanded: Path | Configurations
    if name == "path.csv":
        feed = _feed(table)
        commanded = Path(machine.axis_names, position, feed, dwell_s, target)
        _refuse_standing_lines(table, commanded)
    else:
        commanded = Configurations(machine.axis_names, position, dwell_s, target)
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise table.error(
            f"is out of travel: {breach}",
            breach.index,
            f"{breach.axis.lower()}_{breach.unit}",
            "correct the row, or the travel in machine.json",
        )
    return commanded


def _positions(table: Table, machine: Machine) -> NDArray[np.float64]:
    """Return the axis positions of every row in the column order of the machine."""
    wanted = [
        f"{axis.name.lower()}_{'mm' if isinstance(axis, LinearAxis) else 'deg'}"
        for axis in machine.axes
    ]
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


def _dwell(table: Table) -> NDArray[np.float64]:
    dwell_s = table.numbers("dwell_s")
    if (dwell_s < 0).any():
        index = int(np.argmax(dwell_s < 0))
        raise table.error(f"is {dwell_s[index]:g}, below 0", index, "dwell_s")
    return dwell_s


def _feed(table: Table) -> NDArray[np.float64]:
    feed = table.numbers("feed_mm_min")
    if (feed <= 0).any():
        index = int(np.argmax(feed <= 0))
        raise table.error(
            f"is {feed[index]:g}", index, "feed_mm_min", "a feed must be above 0"
        )
    return feed


def _target_column(table: Table, machine: Machine) -> tuple[str, ...]:
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


def _tracker(data: bytes, name: str) -> TrackerSamples:
    table = read_csv(data, name) if name.endswith(".csv") else read_parquet(data, name)
    table.require("t_s", "x_mm", "y_mm", "z_mm")
    if len(table) == 0:
        raise BundleError(
            "holds no samples", file=name, remedy="record the stream again"
        )
    time_s = _clock(table)
    status = _status(table)
    if (status != 0).all():
        raise BundleError(
            "holds no valid sample: no status is 0",
            file=name,
            column="status",
            remedy="check that the beam was locked",
        )
    position = np.empty((len(table), 3))
    for column, key in enumerate(("x_mm", "y_mm", "z_mm")):
        position[:, column] = table.numbers(key, nan=True)
        bad = np.isnan(position[:, column]) & (status == 0)
        if bad.any():
            raise table.error(
                "is empty or NaN",
                int(np.argmax(bad)),
                key,
                "a sample without a position needs a status other than 0",
            )
    return TrackerSamples(_counter(time_s), time_s, position, status)


def _clock(table: Table) -> NDArray[np.float64]:
    time_s = table.numbers("t_s")
    back = np.diff(time_s) <= 0
    if back.any():
        index = int(np.argmax(back)) + 1
        raise table.error(
            f"does not increase: {time_s[index]:.6f} after {time_s[index - 1]:.6f}",
            index,
            "t_s",
            "samples stand in the order of time, once each",
        )
    return time_s


def _status(table: Table) -> NDArray[np.int64]:
    if "status" not in table.names:
        return np.zeros(len(table), np.int64)
    value = table.numbers("status")
    odd = (value != np.rint(value)) | (np.abs(value) > 2**53)
    if odd.any():
        index = int(np.argmax(odd))
        raise table.error(f"is {value[index]:g}, no whole number", index, "status")
    return value.astype(np.int64)


def _counter(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rebuild the counter of the device from its clock."""
    step_s = np.diff(time_s)
    if not step_s.size:
        return np.zeros(1, np.int64)
    steps = np.maximum(np.rint(step_s / np.median(step_s)), 1.0)
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _environment(files: BundleFiles) -> TemperatureSamples | None:
    name = "environment.csv"
    if name not in files:
        return None
    table = read_csv(files.read(name), name)
    table.require("t_s")
    sensors = [key for key in table.names if key.endswith(_DEGC) and key != _DEGC]
    if not sensors:
        raise BundleError(
            "has no temperatures", file=name, remedy="columns are called <NAME>_degC"
        )
    celsius = np.stack([table.numbers(key) for key in sensors], axis=1)
    names = tuple(key.removesuffix(_DEGC) for key in sensors)
    return TemperatureSamples(names, _clock(table), celsius)


def _reference(files: BundleFiles) -> tuple[DirectMeasurement, ...]:
    name = "reference.csv"
    if name not in files:
        return ()
    table = read_csv(files.read(name), name)
    table.require("error", "position_mm", "direction", "value", "unit")
    position, value = table.numbers("position_mm"), table.numbers("value")
    keys = list(
        zip(
            table.texts("error"),
            table.texts("direction"),
            table.texts("unit"),
            strict=True,
        )
    )
    rows: dict[tuple[str, str, str], list[int]] = {}
    for index, key in enumerate(keys):
        _check_reference(table, index, *key)
        rows.setdefault(key, []).append(index)
    return tuple(
        DirectMeasurement(*key, position[at], value[at]) for key, at in rows.items()
    )


def _check_reference(
    table: Table, index: int, error: str, direction: str, unit: str
) -> None:
    if not _SYMBOL.match(error):
        raise table.error(
            f"is {error!r}", index, "error", "write a symbol of ISO 230-1, such as EXX"
        )
    if direction not in ("+", "-"):
        raise table.error(f"is {direction!r}", index, "direction", "write + or -")
    if unit not in _UNITS:
        raise table.error(f"is {unit!r}", index, "unit", "write um or urad")
