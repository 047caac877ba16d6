"""The table of bad input: one edit of one file of a good bundle, one clear error."""

import json
import os
import pickle
from functools import reduce

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from truepath.errors import BundleError
from truepath.files import tables
from truepath.files.bundle import machine_file
from truepath.files.bundle.bundle import read_bundle
from truepath.files.bundle.machine_file import decode_machine, encode_machine

HEADER = "x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n"
TARGETED = "target," + HEADER
POINTS = "x_mm,y_mm,z_mm,dwell_s\n0,0,0,2\n0,0,1,2\n"
ROTARY = {"type": "rotary", "min_deg": 0, "max_deg": 360}
APPROACHES = [{"order": ["Z", "Y", "X"]}, {"clearance_mm": {}, "feed_mm_min": 300.0}]
APPROACHES += [{"clearance_mm": {"Y": 0.0, "Z": 0.0}}]


def without(name):
    return lambda folder: (folder / name).unlink()


def holding(name, data):
    content = data.encode() if isinstance(data, str) else data
    return lambda folder: (folder / name).write_bytes(content)


def cut(name, size):
    return lambda folder: os.truncate(folder / name, size)


def change_lines(name, change):
    def edit(folder):
        lines = (folder / name).read_text().splitlines()
        change(lines)
        (folder / name).write_text("\n".join(lines) + "\n")

    return edit


def cell(name, row, column, text):
    def change(lines):
        cells = lines[row - 1].split(",")
        cells[lines[0].split(",").index(column)] = text
        lines[row - 1] = ",".join(cells)

    return change_lines(name, change)


def row(name, number, text):
    return change_lines(name, lambda lines: lines.__setitem__(number - 1, text))


def column(name, value, at=None):
    """Set a column of the tracker's Parquet file, or one of its values; None drops."""

    def edit(folder):
        table = pq.read_table(folder / "tracker.parquet").to_pydict()
        if at is not None:
            table[name][at] = value
        elif value is None:
            del table[name]
        else:
            table[name] = value
        pq.write_table(pa.table(table), folder / "tracker.parquet")

    return edit


def key(path, value):
    """Set a key of machine.json, `axes.X.min_mm`; None removes it."""

    def edit(folder):
        content = json.loads((folder / "machine.json").read_text())
        *way, last = path.split(".")
        at = reduce(dict.get, way, content)
        at[last] = value
        if value is None:
            del at[last]
        (folder / "machine.json").write_text(json.dumps(content))

    return edit


def both(first, second):
    return lambda folder: (first(folder), second(folder))


def targets(**placed):
    stated = {name: {"on": on, "offset_mm": [0, 0, 0]} for name, on in placed.items()}
    return both(key("targets", stated), key("tool_offset_mm", None))


def streamed(text):
    text = "t_s,x_mm,y_mm,z_mm\n" + text
    return both(without("tracker.parquet"), holding("tracker.csv", text))


def turning(stated):
    chain = key("kinematic_chain", "w-C-X-b-Y-Z-t")
    return both(key("axes.C", {**ROTARY, **stated}), chain)


# Keys of machine.json, what they are set to, and what is said of it.
KEYS = [
    ("name", "x\ud800", "machine.json: holds \\ud800, which"),
    ("name", "x\x00", "machine.json: holds \\u0000, which"),
    ("schema", None, 'schema is missing; add it, as "schema": "machine/1"'),
    ("schema", "machine/2", 'schema is "machine/2"; write'),
    ("schema", "y" * 500, f'schema is "{"y" * 56}…'),
    ("name", 5, "machine.json: name is 5; write a text"),
    ("axes", None, "machine.json: axes is missing"),
    ("axes.Z", None, "machine.json: axes.Z is missing"),
    ("axes.U", ROTARY, "axes.U is an unknown axis; linear axes"),
    ("axes.X.type", "rotary", 'axes.X.type is "rotary"; write "typ'),
    ("axes.X.min_mm", None, 'axes.X.min_mm is missing; add it, as "min_mm": 0'),
    ("axes.X.max_mm", "500", 'axes.X.max_mm is "500"; write a numb'),
    ("axes.X.max_mm", True, "axes.X.max_mm is true; write a number"),
    ("axes.X.max_mm", float("inf"), "max_mm is not finite"),
    ("axes.X.max_mm", 10**400, "axes.X.max_mm is not finite"),
    ("axes.X.max_mm", float("nan"), "axes.X.max_mm is not finite"),
    ("axes.X.max_mm", 0.0, "axes.X.max_mm is 0; it must exceed min_m"),
    ("axes.X.max_mm", 1e308, "X.max_mm is 1e+308; it must"),
    ("axes.X.min_mm", -1e308, "X.min_mm is -1e+308; it mu"),
    ("axes.X.max_mm", 1e-09, "max_mm is 1e-09; it must exceed"),
    ("tool_offset_mm", [0, 1e300, 0], "tool_offset_mm[1] is 1e+300; it must be within"),
    ("tracker.rate_hz", 1000000000.0, "rate_hz is 1e+09; it must be"),
    ("name", "x" * 100_000, "100000 characters; write 200 at"),
    ("name", "a\nb", "name holds \\u000a at character 2"),
    ("name", "a\u202eb", "name holds \\u202e at character 2"),
    ("kinematic_chain", 1, "kinematic_chain is 1; write a text"),
    ("kinematic_chain", "w-X-Y-Z-t", "write w-…-b-…-t"),
    ("kinematic_chain", "w-b-X-Y-t", "but the axes are X, Y, Z"),
    ("kinematic_chain", "w-X-b-X-Y-Z-t", "name every axis once"),
    ("tool_offset_mm", None, 'missing; add it, as "tool_offset_mm": [20, 30, -150]'),
    ("approach", {"clearance_mm": {"Z": 900}}, "clearance_mm.Z is 900; it mus"),
    ("approach", {"clearance_mm": {"C": 0}}, "approach.clearance_mm.C is no linear"),
    ("approach", {"order": ["Z", "X"]}, "approach.order is"),
    ("approach", {"feed_mm_min": 0}, "approach.feed_mm_min is 0"),
    ("tool_offset_mm", [1, 2], "is [1, 2]; write three num"),
    ("tool_offset_mm", [1, "2", 3], 'offset_mm[1] is "2"'),
    ("targets", {"T1": {}}, "tool_offset_mm stands beside"),
    ("tracker.range_sigma_um", -1, "is -1; it must be above 0"),
    ("tracker.range_ppm", -1, "range_ppm is -1; it must be 0 or mo"),
    ("tracker.rate_hz", 0, "tracker.rate_hz is 0; it must be above 0"),
    ("tracker.stands_on", "air", "write one of workpiece, base"),
]

# Cells of CSV files: file, row, column and text.
CELLS = [
    ("path.csv", 4, "y_mm", "abc", "row 4, column y_mm: is 'abc', not a"),
    ("path.csv", 2, "x_mm", '"1,5"', "row 2, column x_mm: is '1,5', not"),
    ("path.csv", 3, "z_mm", "NaN", "path.csv, row 3, column z_mm: is empty"),
    ("path.csv", 5, "x_mm", "", "path.csv, row 5, column x_mm: is empty"),
    ("path.csv", 2, "x_mm", "inf", "row 2, column x_mm: is infinite"),
    ("path.csv", 2, "x_mm", "1e999", "row 2, column x_mm: is infinite"),
    ("path.csv", 3, "x_mm", "612.4", "X = 612.4 mm exceeds 500 mm"),
    ("path.csv", 5, "z_mm", "-301", "Z = -301 mm is below -300 mm"),
    ("path.csv", 3, "feed_mm_min", "0", "column feed_mm_min: is 0; a fe"),
    ("path.csv", 2, "feed_mm_min", "-100", "feed_mm_min: is -100; a feed m"),
    ("path.csv", 2, "dwell_s", "-1", "dwell_s: is -1, below 0"),
    ("environment.csv", 2, "X_degC", "warm", "is 'warm', not a n"),
    ("environment.csv", 3, "air_degC", "", "row 3, column air_degC: i"),
    ("environment.csv", 3, "t_s", "1", "row 3, column t_s: does not in"),
    ("reference.csv", 2, "error", "yaw", "column error: is 'yaw'; write"),
    ("reference.csv", 3, "direction", "up", "row 3, column direction: is"),
    ("reference.csv", 4, "unit", "inch", "row 4, column unit: is 'inch'; w"),
]

FILES = [
    (without("machine.json"), "machine.json: is missing"),
    (cut("machine.json", 40), "machine.json, row 3: is not JSON"),
    (holding("machine.json", b"\xff\xfe{}"), "is not text in UTF-8"),
    (holding("machine.json", "[]"), "machine.json: is []; write an ob"),
    (holding("machine.json", "[" * 100_000), "nested too deeply"),
    (targets(**{"a\nb": "tool"}), 'targets has the name "a\\nb"; write'),
    (targets(), "targets is empty"),
    (targets(T1="roof"), 'targets.T1.on is "roof"; write one of tool, workpiece'),
    (targets(**{"": "tool"}), "targets. has no name; name every target"),
    (turning({"direction": [0, 0, 0]}), "axes.C.direction is [0, 0, 0]; write"),
    (
        both(key("tracker.transverse_sigma_um", 0), key("tracker.angle_sigma_urad", 0)),
        "transverse_sigma_um and angle_sigma_urad are both 0",
    ),
    (without("path.csv"), "path.csv: is missing from the bundle, and so"),
    (holding("points.csv", "x_mm\n"), "path.csv: stands beside points"),
    (without("tracker.parquet"), "tracker.parquet: is missing from the bu"),
    (holding("tracker.csv", "t_s\n"), "tracker.parquet: stands beside tr"),
    (holding("path.csv", ""), "path.csv, row 1: has no header"),
    (holding("path.csv", " , \n"), "path.csv, row 1: has no header"),
    (holding("path.csv", b"\xff\xfe\x00"), "path.csv, row 1: is not te"),
    (holding("path.csv", HEADER.encode() + b"\xe9,1,1,1,1\n"), "row 2: is not te"),
    (holding("path.csv", HEADER), "path.csv: has no rows"),
    (holding("path.csv", HEADER + "0,0,0,1,0\n"), "has one row, and no line"),
    (cell("path.csv", 1, "feed_mm_min", "feed"), "feed_mm_min: is missing; the"),
    (cell("path.csv", 1, "y_mm", "why"), "path.csv, column y_mm: is missing"),
    (holding("path.csv", HEADER.replace(",", ";")), "is missing; the file has x_mm;y"),
    (cell("path.csv", 1, "dwell_s", "a_deg"), "a_deg: is an unknown axis; the mac"),
    (cell("path.csv", 1, "y_mm", "x_mm"), "column x_mm: appears more than once"),
    (row("path.csv", 3, "1,2,3,4"), "path.csv, row 3: has 4 cells, the header 5"),
    (row("path.csv", 3, "\n110,10,-10,6000"), "row 4: has 4 cells, the header 5"),
    (row("path.csv", 4, "110.0,10.0,-10.0,6000.0,0.1"), "row 4: the line starts"),
    (
        holding("path.csv", TARGETED + "T9,0,0,0,1,0\nT9,1,0,0,1,0\n"),
        "path.csv, row 2, column target: is 'T9', unknown; machine.json has no named",
    ),
    (holding("path.csv", TARGETED + ",0,0,0,1,0\n,1,0,0,1,0\n"), "target: is empty"),
    (both(without("path.csv"), holding("points.csv", POINTS)), "column z_mm: is out"),
    (cut("tracker.parquet", 2000), "tracker.parquet: is truncated or not a"),
    (holding("tracker.parquet", b""), "tracker.parquet: is truncated"),
    (column("y_mm", None), "tracker.parquet, column y_mm: is missing"),
    (column("x_mm", ["a"] * 400), "row 1, column x_mm: is 'a', not a number"),
    (column("x_mm", [True] * 400), "column x_mm: holds bool, not numbers"),
    (column("t_s", np.nan, at=9), "tracker.parquet, row 10, column t_s: is empty"),
    (column("t_s", 1234.5, at=10), "row 11, column t_s: does not increase"),
    (column("t_s", 1234.5, at=1), "row 2, column t_s: does not increase"),
    (column("point", [1] * 400), "column point: names points of a path"),
    (column("point", [0] * 400), "row 1, column point: is 0, no row"),
    (both(column("point", [1] * 400), column("shots", [0.5] * 400)), "shots: is 0.5"),
    (column("status", [0.5] * 400), "row 1, column status: is 0.5, no wh"),
    (column("status", [1] * 400), "column status: holds no valid sam"),
    (streamed(""), "tracker.csv: holds no samples"),
    (streamed("0,1,1,1\n1,x,1,1\n"), "tracker.csv, row 3, column x_mm: is 'x'"),
    (streamed("0,1,1,1\n1,1,,1\n"), "row 3, column y_mm: is empty or NaN"),
    (cell("environment.csv", 1, "t_s", "t"), "environment.csv, column t_s: is"),
    (holding("environment.csv", "t_s,X_C\n1,2\n"), "has no temperatures; co"),
    (holding("environment.csv", "t_s,X_degC\n"), "nment.csv: has no ro"),
    (cell("reference.csv", 1, "value", "v"), "reference.csv, column value: is"),
    (
        holding("reference.csv", "error,position_mm,direction,value,unit\n"),
        "reference.csv: has no rows; leave out the file",
    ),
]

TABLE = [
    *((key(path, value), wanted) for path, value, wanted in KEYS),
    *((cell(*place), wanted) for *place, wanted in CELLS),
    *FILES,
]


@pytest.mark.parametrize(("edit", "wanted"), TABLE, ids=[said for _, said in TABLE])
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


def test_the_error_carries_its_place_as_fields_also_to_another_process(bundle):
    cell("path.csv", 4, "y_mm", "abc")(bundle)
    with pytest.raises(BundleError) as caught:
        read_bundle(bundle)
    error = caught.value
    assert (error.file, error.row, error.column) == ("path.csv", 4, "y_mm")
    error = BundleError("is odd", file="a.csv", row=3, column="x", remedy="mend it")
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), vars(copy)) == (str(error), vars(error))


def test_unknown_keys_and_columns_are_left_out_and_usual_noise_may_be_unsaid(bundle):
    good = read_bundle(bundle).machine
    for path in ("colour", "axes.X.pitch_mm", "tracker.serial_number"):
        key(path, "blue")(bundle)
    assert read_bundle(bundle).machine == good
    key("tracker", None)(bundle)
    assert read_bundle(bundle).machine == good
    cell("environment.csv", 1, "air_degC", "humidity_percent")(bundle)
    assert read_bundle(bundle).temperature.names == ("X",)


def test_a_row_may_repeat_the_one_before_to_change_the_target(bundle):
    targets(T1="tool", T2="workpiece")(bundle)
    rows = "T1,0,0,0,1,0\nT2,0,0,0,1,0\nT2,1,0,0,1,0\n"
    (bundle / "path.csv").write_text(TARGETED + rows)
    assert read_bundle(bundle).commanded.target == ("T1", "T2", "T2")


def test_a_machine_file_is_read_from_disk(bundle):
    machine = machine_file.read_machine(bundle / "machine.json")
    assert machine == read_bundle(bundle).machine
    with pytest.raises(BundleError, match=r"none\.json: cannot be read"):
        machine_file.read_machine(bundle / "none.json")


@pytest.mark.parametrize("stated", APPROACHES)
def test_how_an_nc_program_begins_survives_the_machine_file(bundle, stated):
    content = json.loads((bundle / "machine.json").read_text()) | {"approach": stated}
    machine = decode_machine(json.dumps(content).encode())
    written = json.loads(encode_machine(machine))
    assert written["approach"].items() >= stated.items()
    assert decode_machine(json.dumps(written).encode()) == machine


def test_a_path_in_metres_is_named_as_such(bundle):
    header, *rows = (bundle / "path.csv").read_text().splitlines()
    for k, (x, y, z, rest) in enumerate(row.split(",", 3) for row in rows):
        metres = [f"{float(each) / 1e3:.6f}" for each in (x, y, z)]
        rows[k] = ",".join([*metres, rest])
    (bundle / "path.csv").write_text("\n".join([header, *rows]) + "\n")
    with pytest.raises(BundleError, match=r"path\.csv, row \d+, column ._mm.* m; conv"):
        read_bundle(bundle)


def write_packed(folder, columns):
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
    kept = dict(zip(table.column_names, table.columns, strict=True))
    write_packed(bundle, {**kept, "w": bomb})
    assert len(read_bundle(bundle).tracker) == table.num_rows
    write_packed(bundle, {"t_s": pa.array([[0.0] * 100] * table.num_rows)})
    with pytest.raises(BundleError, match="column t_s: holds list<"):
        read_bundle(bundle)
    write_packed(bundle, dict.fromkeys(("t_s", "x_mm", "y_mm", "z_mm"), bomb))
    monkeypatch.setattr(tables, "SMALL_BYTES", 1 << 20)
    with pytest.raises(BundleError, match="column t_s: holds long texts"):
        read_bundle(bundle)
