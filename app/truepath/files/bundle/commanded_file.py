"""The commanded rows: `path.csv`, `points.csv`, JSON, or the NC program that ran."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truepath.documents.whole_files import read_whole
from truepath.errors import BundleError, PlanningError
from truepath.files.bundle.machine_file import read_machine
from truepath.files.tables import Table, encode_csv, read_csv
from truepath.kinematics.machine.machine import Machine
from truepath.motion.configurations import Commanded, Configurations, name_columns
from truepath.motion.nc_programs.programmed_motion import ProgrammedMotion
from truepath.motion.nc_programs.programs import list_dialects, read_program
from truepath.motion.workspace import check_travel, first_breach
from truepath.plugins import PluginFailed
from truepath_drivers.interfaces.arcs import describe_bad_arc
from truepath_drivers.interfaces.records import Arc, Path

MAX_ROWS = 100_000
ARC_COLUMNS = ("arc", "arc_u_mm", "arc_v_mm", "arc_turn_deg")
_MM_PER_M = 1e3
_LEAST_SHARE, _MOST_SHARE = 0.1, 2.0  # of the travel that a path spans
_AXIS_COLUMN = re.compile(r"^([a-z])_(mm|deg)$")


def read_set_up(
    machine_file: FilePath, commanded_file: FilePath
) -> tuple[Machine, Commanded]:
    """Read machine, and path, or points where the file has no feed.

    Raises BundleError with file, row and column.
    """
    machine = read_machine(machine_file)
    data = read_whole(commanded_file)
    header = data.split(b"\n", 1)[0].decode("utf-8", "replace")
    is_path = "feed_mm_min" in [name.strip() for name in header.split(",")]
    commanded = decode_commanded(data, machine, str(commanded_file), is_path=is_path)
    return machine, commanded


def read_point_names(file: FilePath) -> tuple[str, ...]:
    """The column `name` of a path or of points; empty without it."""
    table = read_csv(read_whole(file), str(file))
    return tuple(table.texts("name")) if "name" in table.names else ()


def decode_commanded(
    data: bytes, machine: Machine, file: str, *, is_path: bool
) -> Commanded:
    """Path of a `path.csv`, or points of a `points.csv`. Raises BundleError."""
    table = read_csv(data, file)
    if len(table) > MAX_ROWS:
        problem = f"has {len(table)} rows, more than {MAX_ROWS}"
        raise BundleError(problem, file=file, remedy="divide it into several Runs")
    axes, position = machine.axis_names, _read_positions(table, machine)
    feed = _read_feed(table) if is_path else None
    rest = _read_dwell(table), _read_targets(table, machine)
    if feed is None:
        commanded = Configurations(axes, position, *rest)
    else:
        commanded = Path(axes, position, feed, *rest, _read_arcs(table))
        _reject_standing_lines(table, commanded)
        _reject_bad_arcs(table, commanded)
    _reject_out_of_travel(table, machine, commanded)
    _reject_metres(table, machine, commanded)
    return commanded


def encode_commanded(commanded: Commanded) -> bytes:
    """Bytes of `path.csv` for a path, of `points.csv` for points."""
    return encode_csv(list_columns(commanded))


def list_columns(commanded: Commanded) -> dict[str, Iterable[object]]:
    """Columns of `path.csv` or `points.csv`, in mm, deg, mm/min and s."""
    columns: dict[str, Iterable[object]] = dict(
        zip(name_columns(commanded.axes), commanded.position.T, strict=True)
    )
    if isinstance(commanded, Path):
        columns["feed_mm_min"] = commanded.feed_mm_min
    columns["dwell_s"] = commanded.dwell_s
    if commanded.target:
        columns["target"] = commanded.target
    if isinstance(commanded, Path) and any(commanded.arc):
        rows = [
            ("",) * 4 if arc is None else (arc.axes, *arc.centre_mm, arc.turn_deg)
            for arc in commanded.arc
        ]
        columns |= dict(zip(ARC_COLUMNS, zip(*rows, strict=True), strict=True))
    return columns


def encode_commanded_json(commanded: Commanded) -> dict[str, Any]:
    """The plan as JSON: mm and deg, one list per row in the order of `axes`."""
    is_path = isinstance(commanded, Path)
    content: dict[str, Any] = {
        "kind": "path" if is_path else "points",
        "axes": list(commanded.axes),
        "position": np.round(commanded.position, 6).tolist(),
        "feed_mm_min": commanded.feed_mm_min.tolist() if is_path else [],
        "dwell_s": commanded.dwell_s.tolist(),
        "target": list(commanded.target),
    }
    if is_path and any(commanded.arc):
        content["arc"] = [
            None if arc is None else [arc.axes, *arc.centre_mm, arc.turn_deg]
            for arc in commanded.arc
        ]
    return content


def decode_commanded_json(content: Mapping[str, Any]) -> Commanded:
    """Inverse of `encode_commanded_json`."""
    axes, target = tuple(content["axes"]), tuple(content["target"])
    position = np.array(content["position"], float).reshape(-1, len(axes))
    dwell_s = np.array(content["dwell_s"], float)
    if content["kind"] == "points":
        return Configurations(axes, position, dwell_s, target)
    feed_mm_min = np.array(content["feed_mm_min"], float)
    arcs = tuple(
        None if arc is None else Arc(str(arc[0]), (arc[1], arc[2]), arc[3])
        for arc in content.get("arc", ())
    )
    return Path(axes, position, feed_mm_min, dwell_s, target, arcs)


def _read_positions(table: Table, machine: Machine) -> NDArray[np.float64]:
    wanted = name_columns(machine.axis_names)
    for name in table.names:
        if _AXIS_COLUMN.match(name) and name not in wanted:
            raise BundleError(
                "is an unknown axis",
                file=table.file,
                column=name,
                remedy=f"the machine has {', '.join(wanted)}",
            )
    table.require(*wanted)
    table.require_rows("command something")
    return np.stack([table.numbers(name) for name in wanted], axis=1)


def _read_dwell(table: Table) -> NDArray[np.float64]:
    dwell_s = table.numbers("dwell_s")
    table.reject(dwell_s < 0, "dwell_s", lambda k: f"is {dwell_s[k]:g}, below 0")
    return dwell_s


def _read_feed(table: Table) -> NDArray[np.float64]:
    feed = table.numbers("feed_mm_min")
    remedy = "a feed must be above 0"
    table.reject(feed <= 0, "feed_mm_min", lambda k: f"is {feed[k]:g}", remedy)
    return feed


def _read_targets(table: Table, machine: Machine) -> tuple[str, ...]:
    if "target" not in table.names:
        return ()
    known = {target.name for target in machine.targets}
    named = ", ".join(sorted(known - {""})) or "no named target"
    return tuple(table.choices("target", known, f"machine.json has {named}"))


def _read_arcs(table: Table) -> tuple[Arc | None, ...]:
    if ARC_COLUMNS[0] not in table.names:
        return ()
    axes = [cell.strip() for cell in table.cells(ARC_COLUMNS[0])]
    numbers = [table.numbers(name, nan=True) for name in ARC_COLUMNS[1:]]
    for name, column in zip(ARC_COLUMNS[1:], numbers, strict=True):
        stated = np.array([text != "" for text in axes])
        table.reject(stated & np.isnan(column), name, lambda _: "is empty on an arc")
    return tuple(
        Arc(name, (float(u), float(v)), float(turn)) if name else None
        for name, u, v, turn in zip(axes, *numbers, strict=True)
    )


def _reject_bad_arcs(table: Table, path: Path) -> None:
    for row, arc in enumerate(path.arc):
        if arc is None or row == 0:  # a part of a Run may begin where an arc ended
            continue
        begin, end = path.position[row - 1], path.position[row]
        problem = describe_bad_arc(path.axes, begin, end, arc)
        if problem:
            remedy = "correct row, centre or turn"
            raise table.error(problem, row, ARC_COLUMNS[0], remedy)


def _reject_standing_lines(table: Table, path: Path) -> None:
    if len(path) < 2:
        raise BundleError(
            "has one row, and no line", file=table.file, remedy="a path needs two rows"
        )
    repeated = (np.diff(path.position, axis=0) == 0).all(axis=1)
    for index in np.flatnonzero(repeated) + 1:
        if path.arc and path.arc[index] is not None:
            continue
        if not path.target or path.target[index] == path.target[index - 1]:
            raise table.error(
                "the line starts where it ends: the row repeats the one before",
                int(index),
                None,
                "remove the row; give a longer dwell_s to stand still",
            )


def _reject_metres(table: Table, machine: Machine, commanded: Commanded) -> None:
    columns = [machine.axis_names.index(axis.name) for axis in machine.linear_axes]
    if not columns:
        return
    low, high = np.array([(axis.low, axis.high) for axis in machine.linear_axes]).T
    position = commanded.position[:, columns]
    slack = 0.05 * (high - low)  # of the travel
    in_mm = _MM_PER_M * position
    fits = ((in_mm > low - slack) & (in_mm < high + slack)).all()
    share = np.ptp(position, axis=0) / (high - low)
    longest = int(np.argmax(share))
    if fits and _LEAST_SHARE < _MM_PER_M * share[longest] < _MOST_SHARE:
        row = int(np.argmax(np.abs(position[:, longest])))
        axis = machine.linear_axes[longest]
        raise table.error(
            f"{position[row, longest]:g} mm is the farthest, on a travel of "
            f"{axis.high - axis.low:g} mm: it looks like m",
            row,
            name_columns([axis.name])[0],
            "convert the positions to mm",
        )


def _reject_out_of_travel(table: Table, machine: Machine, commanded: Commanded) -> None:
    breach = first_breach(machine, commanded)
    if breach is not None:
        raise table.error(
            f"is out of travel: {breach}",
            breach.index,
            name_columns([breach.axis.name])[0],
            "correct the row, or the travel in machine.json",
        )


def read_commanded_program(
    file: FilePath, machine: Machine, dialect: str = ""
) -> tuple[Path, str]:
    """The path of a measuring program, and the dialect that parsed it.

    dialect : of the control; if empty, the one that parses the whole program

    Raises BundleError naming the line, or the dialects that parse it differently.
    """
    text = read_whole(file).decode("utf-8", "replace")
    motions: dict[str, ProgrammedMotion] = {}
    refusals: list[str] = []
    for name in [dialect] if dialect else list_dialects():
        try:
            motion = read_program(text, name)
        except (PlanningError, PluginFailed) as error:
            refusals.append(f"{name}: {error}")
        else:
            if len(motion) > 1:
                motions[name] = motion
    readings = {
        (motion.checksum, *motion.feed_mm_min, *motion.dwell_s)
        for motion in motions.values()
    }
    if not motions:
        raise BundleError(
            f"is no measuring program: {'; '.join(refusals)[:300]}",
            file=str(file),
            remedy="give path.csv, or name the control by --dialect",
        )
    if len(readings) > 1:
        raise BundleError(
            f"is read differently as {', '.join(motions)}",
            file=str(file),
            remedy="name the control by --dialect",
        )
    name, motion = next(iter(motions.items()))
    _require_unchanged(motion, file)
    check_travel(machine, motion.path)
    return motion.path, name


def _require_unchanged(motion: ProgrammedMotion, file: FilePath) -> None:
    if not motion.exact_stop.all():
        problem = "has motions without an exact stop"
    elif motion.stated_checksum not in ("", motion.checksum):
        problem = "states the checksum of another path: positions were changed"
    else:
        return
    remedy = "give the program that the machine ran, as it was written"
    raise BundleError(problem, file=str(file), remedy=remedy)
