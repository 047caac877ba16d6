"""The table of bad input: one edit of one file of a good bundle, one clear error."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from truepath.errors import BundleError
from truepath.files import tables
from truepath.files.bundle.bundle import read_bundle
from truepath.files.bundle.machine_file import decode_machine, read_machine

Edit = Callable[[Path], None]


def without(name: str) -> Edit:
    """Leave a file out."""
    return lambda folder: (folder / name).unlink()


def holding(name: str, data: str | bytes) -> Edit:
    """Put a file with this content in."""
    content = data.encode() if isinstance(data, str) else data
    return lambda folder: (folder / name).write_bytes(content) and None


def cut(name: str, size: int) -> Edit:
    """Keep only the beginning of a file."""

    def edit(folder: Path) -> None:
        (folder / name).write_bytes((folder / name).read_bytes()[:size])

    return edit


def cell(name: str, row: int, column: str, text: str) -> Edit:
    """Change one cell of a CSV file; row 1 is the header."""

    def edit(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        cells = lines[row - 1].split(",")
        cells[lines[0].split(",").index(column)] = text
        lines[row - 1] = ",".join(cells)
        (folder / name).write_text("\n".join(lines) + "\n")

    return edit


def renamed(name: str, column: str, to: str) -> Edit:
    """Rename a column of a CSV file."""
    return cell(name, 1, column, to)


def row(name: str, number: int, text: str) -> Edit:
    """Replace one row of a CSV file."""

    def edit(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        lines[number - 1] = text
        (folder / name).write_text("\n".join(lines) + "\n")

    return edit


def column(name: str, value: object) -> Edit:
    """Set a column of the tracker's Parquet file; None drops it."""

    def edit(folder: Path) -> None:
        table = pq.read_table(folder / "tracker.parquet").to_pydict()
        if value is None:
            del table[name]
        else:
            table[name] = value
        pq.write_table(pa.table(table), folder / "tracker.parquet")

    return edit


def sample(name: str, index: int, value: float) -> Edit:
    """Change one value of the tracker's Parquet file."""

    def edit(folder: Path) -> None:
        table = pq.read_table(folder / "tracker.parquet").to_pydict()
        table[name][index] = value
        pq.write_table(pa.table(table), folder / "tracker.parquet")

    return edit


def key(path: str, value: object) -> Edit:
    """Set a key of machine.json, `axes.X.min_mm`; None removes it."""

    def edit(folder: Path) -> None:
        content = json.loads((folder / "machine.json").read_text())
        at = content
        *way, last = path.split(".")
        for step in way:
            at = at[step]
        if value is None:
            del at[last]
        else:
            at[last] = value
        (folder / "machine.json").write_text(json.dumps(content))

    return edit


def both(first: Edit, second: Edit) -> Edit:
    """Do two edits."""

    def edit(folder: Path) -> None:
        first(folder)
        second(folder)

    return edit


HEADER = "x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n"
TRACKER_HEADER = "t_s,x_mm,y_mm,z_mm\n"
ROTARY = {"type": "rotary", "min_deg": 0, "max_deg": 360}

TABLE: list[tuple[str, Edit, str]] = [
    # machine.json
    ("no machine file", without("machine.json"), "machine.json: is missing"),
    ("machine file cut", cut("machine.json", 40), "machine.json, row 3: is not JSON"),
    (
        "machine not text",
        holding("machine.json", b"\xff\xfe{}"),
        "is not text in UTF-8",
    ),
    (
        "machine a list",
        holding("machine.json", "[]"),
        "machine.json: is []; write an ob",
    ),
    ("half a character", key("name", "x\ud800"), r"machine.json: holds \ud800, which"),
    ("an empty character", key("name", "x\0"), r"machine.json: holds \u0000, which"),
    ("machine too deep", holding("machine.json", "[" * 100_000), "nested too deeply"),
    ("no schema", key("schema", None), "machine.json: schema is missing; add it"),
    ("later schema", key("schema", "machine/2"), 'schema is "machine/2"; write'),
    ("name a number", key("name", 5), "machine.json: name is 5; write a text"),
    ("no axes", key("axes", None), "machine.json: axes is missing"),
    ("no axis Z", key("axes.Z", None), "machine.json: axes.Z is missing"),
    ("unknown axis", key("axes.U", ROTARY), "axes.U is an unknown axis; linear axes"),
    (
        "wrong type",
        key("axes.X.type", "rotary"),
        'axes.X.type is "rotary"; write "typ',
    ),
    ("no limit", key("axes.X.min_mm", None), "axes.X.min_mm is missing"),
    ("text limit", key("axes.X.max_mm", "500"), 'axes.X.max_mm is "500"; write a numb'),
    ("true limit", key("axes.X.max_mm", True), "axes.X.max_mm is true; write a number"),
    ("infinite limit", key("axes.X.max_mm", float("inf")), "max_mm is not finite"),
    ("huge limit", key("axes.X.max_mm", 10**400), "axes.X.max_mm is not finite"),
    ("NaN limit", key("axes.X.max_mm", float("nan")), "axes.X.max_mm is not finite"),
    (
        "no travel",
        key("axes.X.max_mm", 0.0),
        "axes.X.max_mm is 0; it must exceed min_m",
    ),
    ("travel of 1e308 mm", key("axes.X.max_mm", 1e308), "X.max_mm is 1e+308; it must"),
    ("begin at -1e308 mm", key("axes.X.min_mm", -1e308), "X.min_mm is -1e+308; it mu"),
    ("travel of 1 nm", key("axes.X.max_mm", 1e-9), "max_mm is 1e-09; it must exceed"),
    (
        "tool too long",
        key("tool_offset_mm", [0, 1e300, 0]),
        "tool_offset_mm[1] is 1e+300; it must be within",
    ),
    ("rate too high", key("tracker.rate_hz", 1e9), "rate_hz is 1e+09; it must be"),
    ("name too long", key("name", "x" * 100_000), "100000 characters; write 200 at"),
    ("name of two lines", key("name", "a\nb"), r"name holds \u000a at character 2"),
    ("name turned", key("name", "a\u202eb"), r"name holds \u202e at character 2"),
    (
        "target of two lines",
        both(
            key("targets", {"a\nb": {"on": "tool", "offset_mm": [0, 0, 0]}}),
            key("tool_offset_mm", None),
        ),
        r'targets has the name "a\nb"; write',
    ),
    ("chain a number", key("kinematic_chain", 1), "kinematic_chain is 1; write a text"),
    ("chain unbased", key("kinematic_chain", "w-X-Y-Z-t"), "write w-…-b-…-t"),
    ("chain short", key("kinematic_chain", "w-b-X-Y-t"), "but the axes are X, Y, Z"),
    ("axis twice", key("kinematic_chain", "w-X-b-X-Y-Z-t"), "name every axis once"),
    ("no tool offset", key("tool_offset_mm", None), "tool_offset_mm is missing"),
    ("short tool offset", key("tool_offset_mm", [1, 2]), "is [1, 2]; write three num"),
    ("text in tool offset", key("tool_offset_mm", [1, "2", 3]), 'offset_mm[1] is "2"'),
    ("targets and offset", key("targets", {"T1": {}}), "tool_offset_mm stands beside"),
    (
        "no target",
        both(key("targets", {}), key("tool_offset_mm", None)),
        "targets is empty",
    ),
    (
        "target in the air",
        both(
            key("targets", {"T1": {"on": "roof", "offset_mm": [0, 0, 0]}}),
            key("tool_offset_mm", None),
        ),
        'targets.T1.on is "roof"; write one of tool, workpiece',
    ),
    (
        "target unnamed",
        both(
            key("targets", {"": {"on": "tool", "offset_mm": [0, 0, 0]}}),
            key("tool_offset_mm", None),
        ),
        "targets. has no name; name every target",
    ),
    (
        "rotary without direction",
        both(
            key("axes.C", {**ROTARY, "direction": [0, 0, 0]}),
            key("kinematic_chain", "w-C-X-b-Y-Z-t"),
        ),
        "axes.C.direction is [0, 0, 0]; write a direction",
    ),
    ("negative noise", key("tracker.range_sigma_um", -1), "is -1; it must be above 0"),
    (
        "negative ppm",
        key("tracker.range_ppm", -1),
        "range_ppm is -1; it must be 0 or mo",
    ),
    (
        "no noise across",
        both(key("tracker.transverse_sigma_um", 0), key("tracker.angle_sigma_urad", 0)),
        "transverse_sigma_um and angle_sigma_urad are both 0",
    ),
    ("no rate", key("tracker.rate_hz", 0), "tracker.rate_hz is 0; it must be above 0"),
    ("tracker on air", key("tracker.stands_on", "air"), "write one of workpiece, base"),
    # which files
    (
        "no commands",
        without("path.csv"),
        "path.csv: is missing from the bundle, and so",
    ),
    ("two commands", holding("points.csv", "x_mm\n"), "path.csv: stands beside points"),
    (
        "no stream",
        without("tracker.parquet"),
        "tracker.parquet: is missing from the bu",
    ),
    (
        "two streams",
        holding("tracker.csv", "t_s\n"),
        "tracker.parquet: stands beside tr",
    ),
    # path.csv
    ("empty path", holding("path.csv", ""), "path.csv, row 1: has no header"),
    ("path of blanks", holding("path.csv", " , \n"), "path.csv, row 1: has no header"),
    (
        "path not text",
        holding("path.csv", b"\xff\xfe\x00"),
        "path.csv, row 1: is not te",
    ),
    (
        "path not text further on",
        holding("path.csv", HEADER.encode() + b"\xe9,1,1,1,1\n"),
        "path.csv, row 2: is not text in UTF-8",
    ),
    ("no rows", holding("path.csv", HEADER), "path.csv: has no rows"),
    (
        "one row",
        holding("path.csv", HEADER + "0,0,0,1,0\n"),
        "has one row, and no line",
    ),
    (
        "column missing",
        renamed("path.csv", "feed_mm_min", "feed"),
        "path.csv, column feed_mm_min: is missing; the file has x_mm",
    ),
    (
        "axis missing",
        renamed("path.csv", "y_mm", "why"),
        "path.csv, column y_mm: is missing",
    ),
    (
        "semicolons",
        holding("path.csv", HEADER.replace(",", ";")),
        "path.csv, column x_mm: is missing; the file has x_mm;y_mm",
    ),
    (
        "unknown axis in path",
        renamed("path.csv", "dwell_s", "a_deg"),
        "path.csv, column a_deg: is an unknown axis; the machine has x_mm, y_mm, z_mm",
    ),
    (
        "column twice",
        renamed("path.csv", "y_mm", "x_mm"),
        "path.csv, column x_mm: appears more than once",
    ),
    (
        "cell missing",
        row("path.csv", 3, "1,2,3,4"),
        "path.csv, row 3: has 4 cells, the header 5",
    ),
    (
        "cell missing after a blank line",
        row("path.csv", 3, "\n110,10,-10,6000"),
        "path.csv, row 4: has 4 cells, the header 5",
    ),
    ("text", cell("path.csv", 4, "y_mm", "abc"), "row 4, column y_mm: is 'abc', not a"),
    (
        "comma",
        cell("path.csv", 2, "x_mm", '"1,5"'),
        "row 2, column x_mm: is '1,5', not",
    ),
    (
        "NaN",
        cell("path.csv", 3, "z_mm", "NaN"),
        "path.csv, row 3, column z_mm: is empty",
    ),
    (
        "blank",
        cell("path.csv", 5, "x_mm", ""),
        "path.csv, row 5, column x_mm: is empty",
    ),
    ("infinite", cell("path.csv", 2, "x_mm", "inf"), "row 2, column x_mm: is infinite"),
    (
        "too large",
        cell("path.csv", 2, "x_mm", "1e999"),
        "row 2, column x_mm: is infinite",
    ),
    (
        "out of travel",
        cell("path.csv", 3, "x_mm", "612.4"),
        "path.csv, row 3, column x_mm: is out of travel: X = 612.4 mm exceeds 500 mm",
    ),
    (
        "below travel",
        cell("path.csv", 5, "z_mm", "-301"),
        "path.csv, row 5, column z_mm: is out of travel: Z = -301 mm is below -300 mm",
    ),
    (
        "start equals end",
        row("path.csv", 4, "110.0,10.0,-10.0,6000.0,0.1"),
        "path.csv, row 4: the line starts where it ends",
    ),
    (
        "no feed",
        cell("path.csv", 3, "feed_mm_min", "0"),
        "column feed_mm_min: is 0; a fe",
    ),
    (
        "feed backwards",
        cell("path.csv", 2, "feed_mm_min", "-100"),
        "path.csv, row 2, column feed_mm_min: is -100; a feed must be above 0",
    ),
    ("dwell back", cell("path.csv", 2, "dwell_s", "-1"), "dwell_s: is -1, below 0"),
    (
        "unknown target",
        holding("path.csv", "target," + HEADER + "T9,0,0,0,1,0\nT9,1,0,0,1,0\n"),
        "path.csv, row 2, column target: is 'T9', unknown; machine.json has no named",
    ),
    (
        "empty target",
        holding("path.csv", "target," + HEADER + ",0,0,0,1,0\n,1,0,0,1,0\n"),
        "path.csv, row 2, column target: is empty",
    ),
    # points.csv
    (
        "points out of travel",
        both(
            without("path.csv"),
            holding("points.csv", "x_mm,y_mm,z_mm,dwell_s\n0,0,0,2\n0,0,1,2\n"),
        ),
        "points.csv, row 3, column z_mm: is out of travel",
    ),
    # tracker
    (
        "cut stream",
        cut("tracker.parquet", 2000),
        "tracker.parquet: is truncated or not a",
    ),
    ("empty file", holding("tracker.parquet", b""), "tracker.parquet: is truncated"),
    ("column gone", column("y_mm", None), "tracker.parquet, column y_mm: is missing"),
    ("words", column("x_mm", ["a"] * 400), "row 1, column x_mm: is 'a', not a number"),
    ("truths", column("x_mm", [True] * 400), "column x_mm: holds bool, not numbers"),
    (
        "NaN time",
        sample("t_s", 9, np.nan),
        "tracker.parquet, row 10, column t_s: is empty",
    ),
    (
        "time back",
        sample("t_s", 10, 1234.5),
        "tracker.parquet, row 11, column t_s: does not increase: 1234.500000 after",
    ),
    ("time still", sample("t_s", 1, 1234.5), "row 2, column t_s: does not increase"),
    (
        "points of a path",
        column("point", [1] * 400),
        "tracker.parquet, column point: names points of a path",
    ),
    ("point 0", column("point", [0] * 400), "row 1, column point: is 0, no row"),
    (
        "half a shot",
        both(column("point", [1] * 400), column("shots", [0.5] * 400)),
        "row 1, column shots: is 0.5, no number",
    ),
    (
        "half status",
        column("status", [0.5] * 400),
        "row 1, column status: is 0.5, no wh",
    ),
    (
        "no valid sample",
        column("status", [1] * 400),
        "column status: holds no valid sam",
    ),
    (
        "empty stream",
        both(without("tracker.parquet"), holding("tracker.csv", TRACKER_HEADER)),
        "tracker.csv: holds no samples",
    ),
    (
        "text in the stream",
        both(
            without("tracker.parquet"),
            holding("tracker.csv", TRACKER_HEADER + "0,1,1,1\n1,x,1,1\n"),
        ),
        "tracker.csv, row 3, column x_mm: is 'x', not a number",
    ),
    (
        "NaN without a status",
        both(
            without("tracker.parquet"),
            holding("tracker.csv", TRACKER_HEADER + "0,1,1,1\n1,1,,1\n"),
        ),
        "tracker.csv, row 3, column y_mm: is empty or NaN; a sample without a position",
    ),
    # environment.csv and reference.csv
    (
        "no clock",
        renamed("environment.csv", "t_s", "t"),
        "environment.csv, column t_s: is",
    ),
    (
        "no sensor",
        holding("environment.csv", "t_s,X_C\n1,2\n"),
        "has no temperatures; co",
    ),
    (
        "no temperatures",
        holding("environment.csv", "t_s,X_degC\n"),
        "nment.csv: has no ro",
    ),
    (
        "odd temperature",
        cell("environment.csv", 2, "X_degC", "warm"),
        "is 'warm', not a n",
    ),
    (
        "sensor off",
        cell("environment.csv", 3, "air_degC", ""),
        "row 3, column air_degC: i",
    ),
    (
        "clock back",
        cell("environment.csv", 3, "t_s", "1"),
        "row 3, column t_s: does not in",
    ),
    (
        "no value",
        renamed("reference.csv", "value", "v"),
        "reference.csv, column value: is",
    ),
    (
        "no reference",
        holding("reference.csv", "error,position_mm,direction,value,unit\n"),
        "reference.csv: has no rows; leave out the file",
    ),
    (
        "odd error",
        cell("reference.csv", 2, "error", "yaw"),
        "column error: is 'yaw'; write",
    ),
    (
        "sideways",
        cell("reference.csv", 3, "direction", "up"),
        "row 3, column direction: is",
    ),
    (
        "inches",
        cell("reference.csv", 4, "unit", "inch"),
        "row 4, column unit: is 'inch'; w",
    ),
]


@pytest.mark.parametrize(
    ("edit", "wanted"), [case[1:] for case in TABLE], ids=[case[0] for case in TABLE]
)
def test_a_bad_bundle_gives_one_clear_error(bundle, edit, wanted):
    edit(bundle)
    with pytest.raises(BundleError) as caught:
        read_bundle(bundle)
    text = str(caught.value)
    assert wanted in text
    assert "\n" not in text
    assert len(text) < 220


def test_a_stream_of_too_many_rows_is_refused(bundle, monkeypatch):
    monkeypatch.setattr(tables, "MAX_ROWS", 399)
    with pytest.raises(BundleError, match=r"tracker\.parquet: has 400 rows, more than"):
        read_bundle(bundle)


def test_the_error_carries_its_place_as_fields(bundle):
    cell("path.csv", 4, "y_mm", "abc")(bundle)
    with pytest.raises(BundleError) as caught:
        read_bundle(bundle)
    error = caught.value
    assert (error.file, error.row, error.column) == ("path.csv", 4, "y_mm")


def test_unknown_keys_of_the_machine_are_tolerated_and_kept_out(bundle):
    good = read_bundle(bundle).machine
    for path in ("colour", "axes.X.pitch_mm", "tracker.serial_number"):
        key(path, "blue")(bundle)
    assert read_bundle(bundle).machine == good


def test_a_machine_without_a_tracker_has_the_usual_noise(bundle):
    good = read_bundle(bundle).machine
    key("tracker", None)(bundle)
    assert read_bundle(bundle).machine == good


def test_unknown_columns_are_tolerated(bundle):
    renamed("environment.csv", "air_degC", "humidity_percent")(bundle)
    assert read_bundle(bundle).temperature.names == ("X",)


def test_a_row_may_repeat_the_one_before_to_change_the_target(bundle):
    both(
        key("tool_offset_mm", None),
        key(
            "targets",
            {
                "T1": {"on": "tool", "offset_mm": [0, 0, 0]},
                "T2": {"on": "workpiece", "offset_mm": [0, 0, 9]},
            },
        ),
    )(bundle)
    rows = "T1,0,0,0,1,0\nT2,0,0,0,1,0\nT2,1,0,0,1,0\n"
    (bundle / "path.csv").write_text("target," + HEADER + rows)
    assert read_bundle(bundle).commanded.target == ("T1", "T2", "T2")


def test_a_machine_file_is_read_from_disk(bundle):
    assert read_machine(bundle / "machine.json") == read_bundle(bundle).machine
    with pytest.raises(BundleError, match=r"none\.json: cannot be read"):
        read_machine(bundle / "none.json")


def test_a_long_value_is_shortened_in_the_error():
    with pytest.raises(BundleError, match=r"schema is \"y{56}…"):
        decode_machine(json.dumps({"schema": "y" * 500}).encode())


def test_a_path_in_metres_is_named_as_such(bundle):
    lines = (bundle / "path.csv").read_text().splitlines()
    places = [[float(c) for c in line.split(",")[:3]] for line in lines[1:]]
    rest = [line.split(",", 3)[3] for line in lines[1:]]
    metres = [
        ",".join([*(f"{value / 1e3:.6f}" for value in place), end])
        for place, end in zip(places, rest, strict=True)
    ]
    (bundle / "path.csv").write_text("\n".join([lines[0], *metres]) + "\n")
    with pytest.raises(BundleError, match=r"path\.csv, row \d+, column ._mm.* m; conv"):
        read_bundle(bundle)


def write_packed(folder: Path, columns: dict[str, pa.Array]) -> int:
    file = folder / "tracker.parquet"
    pq.write_table(pa.table(columns), file, compression="zstd")
    return file.stat().st_size


@pytest.mark.fault_row(35)
def test_a_small_file_of_very_many_rows_is_refused_before_it_is_unpacked(bundle):
    zeros = pa.array(np.zeros(3_000_000))
    columns = dict.fromkeys(("t_s", "x_mm", "y_mm", "z_mm"), zeros)
    assert write_packed(bundle, columns) < 100_000
    before = pa.total_allocated_bytes()
    with pytest.raises(BundleError, match=r"tracker\.parquet: has 3000000 rows in"):
        read_bundle(bundle)
    assert pa.total_allocated_bytes() - before < 1 << 20


@pytest.mark.fault_row(35)
def test_lists_are_refused_and_unknown_columns_are_not_unpacked(bundle, monkeypatch):
    table = pq.read_table(bundle / "tracker.parquet")
    bomb = pa.array(["0" * 100_000] * table.num_rows)
    write_packed(
        bundle, {**dict(zip(table.column_names, table.columns, strict=True)), "w": bomb}
    )
    assert len(read_bundle(bundle).tracker) == table.num_rows
    lists = pa.array([[0.0] * 100] * table.num_rows)
    write_packed(bundle, {"t_s": lists})
    with pytest.raises(BundleError, match="column t_s: holds list<"):
        read_bundle(bundle)
    texts = dict.fromkeys(("t_s", "x_mm", "y_mm", "z_mm"), bomb)
    write_packed(bundle, texts)
    monkeypatch.setattr(tables, "SMALL_BYTES", 1 << 20)
    with pytest.raises(BundleError, match="column t_s: holds long texts"):
        read_bundle(bundle)


def test_the_error_crosses_to_another_process_whole():
    error = BundleError("is odd", file="a.csv", row=3, column="x", remedy="mend it")
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), vars(copy)) == (str(error), vars(error))
