"""`import`: files as several makers' software writes them, made by hand from truth."""

import io
import json
import re
import shutil
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import exports_of_makers as makers
from api_builders import edited
from recorded import record_run
from truepath.answers.predicted_points import predict_points
from truepath.cli import command as command_line
from truepath.errors import BundleError
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.nc_programs.programs import write_program
from truepath_drivers.interfaces.records import Path
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion.paths import turning_path


@pytest.fixture(scope="module")
def truth(record):
    return record(1, rows=12)[0]


@pytest.fixture(scope="module")
def source(truth, tmp_path_factory):
    """Machine and path of the recording; not to be changed."""
    folder = tmp_path_factory.mktemp("truth")
    write_bundle(truth, folder)
    return folder


@pytest.fixture
def words(source, tmp_path):
    def spell(data, *options, place=source, path=source / "path.csv"):
        export = tmp_path / "export.txt"
        export.write_bytes(data)
        given = ["--machine", place / "machine.json", "--path", path]
        return ["import", export, *given, "-o", tmp_path / "bundle", *options]

    return spell


@pytest.fixture
def bring(command, words, tmp_path):
    def ask(data, *options, **given):
        said = command.run(*words(data, *options, **given))
        return read_bundle(tmp_path / "bundle"), said

    return ask


@pytest.fixture
def refuse(command, words, tmp_path):
    def ask(data):
        said = command.refuse(*words(data), shows=True)
        assert not (tmp_path / "bundle").exists()
        return said

    return ask


@pytest.fixture(scope="module")
def written(truth):
    def write(scale=1.0, **form):
        time_s, position = truth.tracker.device_time_s, truth.tracker.position_mm
        return makers.plain(time_s - time_s[0], np.array(scale) * position, **form)

    return write


def assert_times(read, truth):
    time_s = truth.tracker.device_time_s - truth.tracker.device_time_s[0]
    np.testing.assert_allclose(read.tracker.device_time_s, time_s, atol=1.1e-6)


@pytest.mark.parametrize("style", ["leica", "german", "spatial", "french"])
def test_the_stream_of_an_export_is_the_one_that_was_recorded(style, bring, truth):
    data, options = makers.of_stream(getattr(makers, style), truth.tracker)
    read, _ = bring(data, *options)
    valid = truth.tracker.status == 0
    assert (read.tracker.status == 0).tolist() == valid.tolist()
    gap = read.tracker.position_mm[valid] - truth.tracker.position_mm[valid]
    assert np.abs(gap).max() < 2e-4
    assert_times(read, truth)


def test_an_nc_program_is_its_path_and_temperatures_come_along(bring, truth, tmp_path):
    program = tmp_path / "program.h"
    program.write_text(write_program(truth.commanded, truth.machine, "heidenhain"))
    read, _ = bring(makers.of_stream(makers.german, truth.tracker)[0], path=program)
    commanded, told = read.commanded, read.temperature
    np.testing.assert_allclose(commanded.position, truth.commanded.position, atol=1e-9)
    np.testing.assert_allclose(commanded.feed_mm_min, truth.commanded.feed_mm_min)
    assert told.names == ("Z",)
    assert told.celsius.ravel().tolist() == [21.25, 21.25]


def test_a_recording_keeps_when_it_began(bring, truth, written, tmp_path):
    read, _ = bring(makers.of_stream(makers.leica, truth.tracker)[0])
    assert read.provenance["started"] == "2026-03-01T23:59:40+00:00"
    shutil.rmtree(tmp_path / "bundle")
    # No zone: that of this computer. No date: nothing. Which is the month: nothing.
    for day, began in (("2026-11-30", "2026-11-30"), ("", None), ("03/04/2026", None)):

        def stamp(t, day=day):
            return f"{day} {makers.clock(t, begin='08:00:00')}".strip()

        read, said = bring(written(head="time,x_mm,y_mm,z_mm", stamp=stamp))
        started = read.provenance.get("started")
        assert (started or "").startswith(f"{began}T08:00:00" if began else "")
        assert bool(started) == bool(began) == ("no date" not in said.out)
    with edited(tmp_path / "bundle" / "machine.json") as content:
        content["started"] = "yesterday"
    with pytest.raises(BundleError, match='started is "yesterday"; write "started": "'):
        read_bundle(tmp_path / "bundle")


@pytest.mark.fault_row(43)
def test_a_temperature_that_cannot_be_is_left_out_with_a_note(bring, written):
    """The sensor falls to 0 halfway, as with its words in the wrong order."""
    head, *rows = written(head="t_s,x_mm,y_mm,z_mm,X_degC").decode().splitlines()
    for number in range(len(rows)):
        degc = 20.0 + 0.1 * (number % 3) if 2 * number < len(rows) else 2.3e-41
        rows[number] += f",{degc!r}"
    read, said = bring("\n".join([head, *rows]).encode())
    assert "X_degC: " in "".join(said)
    assert read.temperature.celsius.min() >= 20.0
    assert any("X_degC" in e.text for e in read.events)


def beside(data, head, cell):
    first, *rows = data.split(b"\n")
    return b"\n".join([first + b"," + head, *(row + b"," + cell for row in rows)])


about_midnight = partial(makers.clock, begin="23:59:55")
AMBIGUOUS = {
    "an unusual unit": (lambda w: w(0.1, head="t_s,x,y,z", d=6), "--unit", "--unit cm"),
    "metres": (lambda w: w(head="t_s,x_m,y_m,z_m"), "they look like mm", "--unit mm"),
    "more decimals without names than x, y, z": (
        lambda w: w(head="").replace(b"\n", b",0.5\n"),
        "--column x=NUMBER",
        "--column time=1 --column x=2 --column y=3 --column z=4",
    ),
    "x twice": (lambda w: beside(w(), b"x m", b"4.0"), "'x m' (5)", "--column x=2"),
    "left-handed": (lambda w: w((1, -1, 1)), "--axes", "--axes x,-y,z"),
    "midnight": (
        lambda w: w(head="Time,X[mm],Y[mm],Z[mm]", stamp=about_midnight),
        "--across-midnight",
        "--across-midnight",
    ),
    "unknown status": (lambda w: beside(w(), b"Status", b"4"), "--valid", "--valid 4"),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_is_ambiguous_is_refused_until_it_is_settled(case, bring, refuse, written):
    make, said, option = AMBIGUOUS[case]
    data = make(written)
    assert said in refuse(data)
    bring(data, *option.split())


REFUSED = {
    "commas for both": lambda w: re.sub(rb"(?<=\d)\.(?=\d)", b",", w()),
    "a broken line": lambda w: w().replace(b"\n", b"\n1.0,2.0\n", 5),
    "a word for a number": lambda w: w().replace(b"\n", b"\nabc,"),
    "a picture": lambda w: b"\x89PNG\0\0",
    "nothing": lambda w: b"",
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused(case, refuse, written):
    assert "export.txt" in refuse(REFUSED[case](written))


def test_a_dry_run_shows_all_and_writes_nothing(command, words, truth, tmp_path):
    data, _ = makers.of_stream(makers.leica, truth.tracker)
    shown = command.run(*words(data, "--dry-run")).out
    assert "X [mm]" in shown
    assert "left out" in shown
    assert not (tmp_path / "bundle").exists()


def iso(t, zone_h=0, begin="2026-03-29T00:59:50"):
    passed = np.timedelta64(round(1e6 * t) + 3_600_000_000 * zone_h, "us")
    return f"{np.datetime64(begin) + passed}+{zone_h:02d}:00"


def local(t):
    return iso(t).partition("+")[0]


BY_CLOCK = "Timestamp,X [mm],Y [mm],Z [mm]"


def test_a_zone_that_changes_to_summer_time_is_no_gap(bring, written, truth):
    data = written(head=BY_CLOCK, stamp=lambda t: iso(t, 1 if t < 10.0 else 2))
    assert_times(bring(data)[0], truth)


def test_a_clock_that_is_set_back_is_refused_at_its_row(refuse, written):
    data = written(head=BY_CLOCK, stamp=lambda t: local(t if t < 10 else t - 3600))
    said = refuse(data)
    for word in ("export.txt", "Timestamp", "does not increase", "2026-03-29T00:59"):
        assert word in said


def test_a_gap_and_a_position_that_stays_are_noted_with_rows(command, words, written):
    data = written(head=BY_CLOCK, stamp=lambda t: local(t if t < 10 else t + 3600))
    lines = data.split(b"\n")
    stuck = lines[801].partition(b",")[2]
    for row in range(801, 901):
        lines[row] = lines[row].partition(b",")[0] + b"," + stuck
    said = command.run(*words(b"\n".join(lines), "--dry-run")).err
    assert "a gap of 3600.01 s before row" in said
    assert "rows 802 to 901 repeat one position" in said


def test_all_that_is_wrong_is_told_to_all_at_once(command, words, written, tmp_path):
    data = beside(written((1, -1, 1), head="t,x,y,z"), b"Status", b"4")
    data = data.replace(b"\n", b"\nnot a row\n", 3)
    told = command.list_problems(*words(data))
    assert len(told) == 3
    remedies = ("remove the line", "--valid", "--axes")
    assert all(map(str.count, told, remedies))
    found = command.json(*words(data), status=2)
    assert len(found["problems"]) == 3
    assert all(map(str.count, found["problems"], remedies))
    assert found["unit"].startswith("mm: ")
    assert found["rows"] == str(len(written().splitlines()) - 1)
    assert not (tmp_path / "bundle").exists()


def test_a_row_that_came_twice_is_one_sample_a_program_is_said(bring, written, truth):
    once = written().split(b"\n")
    read, said = bring(b"\n".join([*once[:300], *once[299:]]))
    assert "1 rows that repeat" in said.err
    assert len(read.tracker) == len(truth.tracker)
    time_s = truth.tracker.device_time_s
    later = time_s[-1] - time_s[0] + 0.01
    again = written(stamp=lambda t: f"{t + later:.6f}").split(b"\n")[1:]
    said = bring(b"\n".join([*once, *again]))[1].err
    assert "The program was recorded more than once: " in said


def test_a_rate_against_times_and_drive_is_said_and_no_feed(bring, written):
    said = bring(written(), "--rate", "200")[1].err
    assert "--rate 200 contradicts the times of the file: 100 Hz" in said
    assert "took 50.0 % of the time" in said
    assert "of the feed of the path" not in said


@pytest.fixture
def shots(record, tmp_path):
    """Points of a program, and where a tracker that stands turned sees them."""
    run = record(2, "standstill", rows=30)[0]
    write_bundle(run, tmp_path / "points")
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    seen = run.commanded.position @ turn.T + [3000.0, 100.0, -50.0]
    return run, seen, tmp_path / "points" / "points.csv"


def list_shots(seen, rows, names=None):
    head = "// Points\n// AXES = CARTESIAN: X,  Y,  Z (mm)\n//\n"
    lines = []
    for k, row in enumerate(rows):
        x, y, z = seen[row] + 1e-3 * (k % 2)
        name = f"A, run, P{names[k]}, " if names else ""
        lines.append(f"{name}{x:.4f}, {y:.4f}, {z:.4f}")
    return (head + "\n".join(lines)).encode()


def test_shots_without_names_find_their_points_though_some_are_missing(bring, shots):
    _, seen, path = shots
    rows = [0, 1, 2, 2, 3, 6, *range(7, 20), 19, 19, *range(21, len(seen))]
    read, said = bring(list_shots(seen, rows), path=path)
    assert read.points.row.tolist() == sorted({*rows})
    assert read.points.count[2] == 2
    assert "points without a shot: 5, 6, 21\n" in said.err


def test_names_that_slipped_are_said_to_be_shifted_and_not_taken(bring, shots):
    _, seen, path = shots
    names = [k + 1 + (k >= 12) for k in range(len(seen))]
    read, said = bring(list_shots(seen, range(len(seen)), names), path=path)
    assert "names are shifted by +1 from row 16 on" in said.err
    assert read.points.row.tolist() == list(range(len(seen)))


def test_points_of_an_nc_program_are_its_stops(bring, shots, tmp_path):
    run, seen, _ = shots
    program, n = tmp_path / "program.h", len(seen)
    axes, position = run.commanded.axes, run.commanded.position
    path = Path(axes, position, np.full(n, 3000.0), np.full(n, 2.0))
    program.write_text(write_program(path, run.machine, "heidenhain"))
    read, _ = bring(list_shots(seen, range(n)), path=program)
    assert read.points.row.tolist() == list(range(n))
    np.testing.assert_allclose(read.commanded.position, path.position, atol=1e-3)


def test_names_of_columns_and_the_rate_may_stand_in_comments(bring, written, truth):
    _, *rows = written().split(b"\n")
    body = b"\n".join(row.partition(b",")[2] for row in rows)
    read, _ = bring(b"# Tracker log\n# Rate: 100 Hz\n# x [mm], y [mm], z [mm]\n" + body)
    assert_times(read, truth)


@pytest.mark.parametrize("numbered", [True, False])
def test_row_numbers_tell_where_rows_are_missing(numbered, bring, truth):
    """Whole seconds tell the rate, and how many rows a second lacks."""
    gone = range(1010, 1030)
    text = ["// AXES = CARTESIAN: X,  Y,  Z (mm)"]
    time_s = truth.tracker.device_time_s - truth.tracker.device_time_s[0]
    for k, (t, p) in enumerate(zip(time_s, truth.tracker.position_mm, strict=True)):
        stamp = makers.clock(float(int(t)), "02:00:00", "%m/%d/%Y %I:%M:%S %p")
        if k not in gone:
            number = k + 1 if numbered else k + 1 - 20 * (k > 1010)
            text.append(f"A,run,{number}, {p[0]:.4f}, {p[1]:.4f}, {p[2]:.4f}, {stamp}")
    read, said = bring("\n".join(text).encode())
    used = read.tracker.status == 0
    late_s = read.tracker.device_time_s - np.delete(time_s, gone)
    assert np.ptp(late_s[used]) < 1e-3
    assert used.all() == numbered
    assert "20 rows are missing" in said.err or "20 samples are missing" in said.err


@pytest.mark.parametrize("gone", [[7], [7, 8]])
def test_points_beside_lost_ones_and_a_stray_keep_their_place(gone, bring, shots):
    _, seen, path = shots
    seen[gone] = 0.0
    seen[20] += [30.0, -20.0, 10.0]
    lines = ["x_mm,y_mm,z_mm", *(f"{x:.4f},{y:.4f},{z:.4f}" for x, y, z in seen)]
    read, said = bring("\n".join(lines).encode(), path=path)
    kept = [k for k in range(len(seen)) if k not in (*gone, 20)]
    assert read.points.row.tolist() == kept
    assert f"{len(gone)} rows of 0, 0, 0" in said.err


def test_a_name_in_points_csv_is_the_whole_name(bring, shots):
    _, seen, path = shots
    head, *rows = path.read_text().splitlines()
    named = [f"{row},P12-{k}" for k, row in enumerate(rows, 1)]
    path.write_text("\n".join([f"{head},name", *named]) + "\n")
    lines = ["Name;x_mm;y_mm;z_mm"]
    for k, (x, y, z) in enumerate(seen, 1):
        lines.append(f"A::b::P12-{k};{x:.4f};{y:.4f};{z:.4f}")
    _, said = bring("\n".join(lines).encode(), path=path)
    assert "A::b::P12-3 is 3" in " ".join(said.out.replace("│", " ").split())


def test_a_rotary_axis_that_is_counted_the_other_way_is_named(command, words, tmp_path):
    content = load_machine("trunnion")
    run, _ = record_run(content, turning_path(parse_machine(content), 5, 16, 9000.0))
    position = run.commanded.position.copy()
    position[:, run.commanded.axes.index("C")] *= -1.0
    content["axes"]["C"] |= {"min_deg": -3600.0, "max_deg": 3600.0}
    commanded = replace(run.commanded, position=position)
    run = replace(run, machine=machine_from_json(content), commanded=commanded)
    write_bundle(run, tmp_path)
    data = makers.plain(run.tracker.device_time_s, run.tracker.position_mm, d=5)
    order = words(data, place=tmp_path, path=tmp_path / "path.csv")
    assert "axis C counted the other way" in command.refuse(*order, shows=True)


def test_what_is_shown_survives_a_terminal_of_ascii(words, written, monkeypatch):
    data = beside(written(), "Lufttemperatur [°C]".encode(), b"20.5")
    order = words(beside(data, "Δ".encode(), b"1"), "--dry-run")
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(sys, "argv", ["truepath", *map(str, order)])
    monkeypatch.setattr(command_line, "choose_thread_limits", dict)
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    shown.flush()
    assert ended.value.code == 0
    assert b"Lufttemperatur" in shown.buffer.getvalue()


def shots_of(truth, recording, shots=3):
    """Return some shots at each point, each the mean of a while of the stream."""
    row, count = recording.row, len(truth.commanded)
    way = recording.commanded_mm - truth.commanded.position[row]
    still = np.linalg.norm(way, axis=1) < 1e-9
    picked = []
    for k in range(count):
        at = np.flatnonzero((row == k) & still)
        picked += np.array_split(at[len(at) // 4 : -len(at) // 4], shots)
    times, position = (
        np.array([values[part].mean(axis=0) for part in picked])
        for values in (recording.time_s, truth.tracker.position_mm)
    )
    names = [f"P{k + 1}" for k in range(count) for _ in range(shots)]
    return times, position, np.zeros(len(picked), int), names


@pytest.mark.long
@pytest.mark.timeout(200)
@pytest.mark.parametrize("mode", ["otf", "standstill"])
@pytest.mark.parametrize("style", ["leica", "spatial", "polyworks", "generic"])
def test_an_export_becomes_the_tables_of_the_machine(
    style, mode, record, tmp_path, volume, rigid_free, command
):
    truth, world = record(1012, mode, rows=40 if mode == "otf" else 60)
    write_bundle(truth, tmp_path / "truth")
    write = getattr(makers, style)
    if mode == "otf":
        data, options = makers.of_stream(write, truth.tracker)
    else:
        data, options = write(*shots_of(truth, world.recording))
    (tmp_path / "export.txt").write_bytes(data)
    bundle, out, place = (tmp_path / name for name in ("bundle", "out", "truth"))
    path = place / ("path.csv" if mode == "otf" else "points.csv")
    given = ["--machine", place / "machine.json", "--path", path, *options]
    command.run("import", tmp_path / "export.txt", *given, "-o", bundle)
    command.run("analyse", bundle, "-o", out)
    verdict = json.loads((out / "result.json").read_text())["verdict"]
    assert verdict["state"] == "usable", verdict["reasons"]
    q = volume(truth.machine)
    points = tmp_path / "points.csv"
    np.savetxt(points, q, "%.6f", ",", header="x_mm,y_mm,z_mm", comments="")
    told = predict_points(out / "result.json", points, tmp_path / "predicted.csv")
    before = 1e3 * rigid_free(q, world.deviation_mm(q))
    left = before - rigid_free(q, told.error_um)
    inside = (np.abs(left) < 2.0 * told.uncertainty_um).mean()
    was, rest = (np.sqrt(np.mean(v**2)) for v in (before, left))
    print(f"{style} {mode}: {was:.1f} to {rest:.2f} µm, {inside:.1%} in 2u")
    assert rest < 0.12 * was
    assert inside > 0.85
