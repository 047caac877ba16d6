"""`import`: files as several makers' software writes them, made by hand from truth."""

import re

import numpy as np
import pytest

from exports_of_makers import (
    clock,
    french,
    german,
    leica,
    of_stream,
    plain,
    spatial,
)
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.motion.nc_programs.programs import write_program


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
    """The command line that imports a file beside machine and path."""

    def spell(data, *options, path=source / "path.csv"):
        export = tmp_path / "export.txt"
        export.write_bytes(data)
        given = ["--machine", source / "machine.json", "--path", path]
        return ["import", export, *given, "-o", tmp_path / "bundle", *options]

    return spell


@pytest.fixture
def bring(command, words, tmp_path):
    """Import a file; return the Run and what was said."""

    def ask(data, *options, **given):
        said = command.run(*words(data, *options, **given))
        return read_bundle(tmp_path / "bundle"), said

    return ask


@pytest.fixture
def refuse(command, words, tmp_path):
    """Try to import a file that is refused; return the line that says why."""

    def ask(data):
        said = command.refuse(*words(data), shows=True)
        assert not (tmp_path / "bundle").exists()
        return said

    return ask


@pytest.fixture(scope="module")
def written(truth):
    """Write the recording plainly: written(head=…, stamp=…, scale=…)."""

    def write(scale=1.0, **form):
        time_s, position = truth.tracker.device_time_s, truth.tracker.position_mm
        return plain(time_s - time_s[0], np.array(scale) * position, **form)

    return write


def assert_times(read, truth):
    time_s = truth.tracker.device_time_s
    np.testing.assert_allclose(
        read.tracker.device_time_s, time_s - time_s[0], atol=1.1e-6
    )


@pytest.mark.parametrize("style", [leica, german, spatial, french])
def test_the_stream_of_an_export_is_the_one_that_was_recorded(style, bring, truth):
    data, options = of_stream(style, truth.tracker)
    read, _ = bring(data, *options)
    valid = truth.tracker.status == 0
    assert (read.tracker.status == 0).tolist() == valid.tolist()
    gap = read.tracker.position_mm[valid] - truth.tracker.position_mm[valid]
    assert np.abs(gap).max() < 2e-4
    assert_times(read, truth)


def test_an_nc_program_is_the_path_that_it_drives_and_temperatures_come_along(
    bring, truth, tmp_path
):
    program = tmp_path / "program.h"
    program.write_text(write_program(truth.commanded, truth.machine, "heidenhain"))
    read, _ = bring(of_stream(german, truth.tracker)[0], path=program)
    commanded, told = read.commanded, read.temperature
    np.testing.assert_allclose(commanded.position, truth.commanded.position, atol=1e-9)
    np.testing.assert_allclose(commanded.feed_mm_min, truth.commanded.feed_mm_min)
    assert told.names == ("Z",)
    assert told.celsius.ravel().tolist() == [21.25, 21.25]


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


def test_a_list_of_points_is_a_bundle_of_points(bring, record, tmp_path):
    commanded = record(2, "standstill", rows=30)[0]
    write_bundle(commanded, tmp_path / "points")
    position = commanded.commanded.position
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    text = ["Name;X [mm];Y [mm];Z [mm]"]
    for k, p in enumerate(position @ turn.T + [3000.0, 100.0, -50.0]):
        for shot in (-1, 1):
            x, y, z = (f"{v + shot * 1e-3:.4f}".replace(".", ",") for v in p)
            text.append(f"P{k + 1};{x};{y};{z}")
    path = tmp_path / "points" / "points.csv"
    points = bring("\n".join(text).encode(), path=path)[0].points
    assert points.row.tolist() == list(range(len(position)))
    assert set(points.count.tolist()) == {2}
    np.testing.assert_allclose(points.covariance_mm2, 2e-6, rtol=1e-3)


def missing(data):
    lines = data.split(b"\n")
    return b"\n".join(lines[:602] + lines[610:1202] + lines[1210:])


def beside(data, head, cell):
    """Put a column beside the others."""
    first, *rows = data.split(b"\n")
    return b"\n".join([first + b"," + head, *(row + b"," + cell for row in rows)])


AMBIGUOUS = {
    "a unit that is not usual": (
        lambda w: w(0.1, head="t_s,x,y,z", d=6),
        "--unit",
        "--unit cm",
    ),
    "wrong unit": (lambda w: w(head="t_s,x_m,y_m,z_m"), "extend over", "--unit mm"),
    "more decimals without names than x, y, z": (
        lambda w: w(head="").replace(b"\n", b",0.5\n"),
        "--column x=NUMBER",
        "--column time=1 --column x=2 --column y=3 --column z=4",
    ),
    "two columns of x": (
        lambda w: w(head="x measured,x_mm,y_mm,z_mm"),
        "'x measured' (1)",
        "--column x=2 --column time=1 --time-unit s",
    ),
    "left-handed": (lambda w: w((1, -1, 1)), "--axes", "--axes x,-y,z"),
    "midnight": (
        lambda w: w(
            head="Time,X[mm],Y[mm],Z[mm]", stamp=lambda t: clock(t, begin="23:59:55")
        ),
        "--across-midnight",
        "--across-midnight",
    ),
    "times that are rounded": (
        lambda w: missing(w(stamp="{:.1f}".format)),
        "--rate",
        "--rate 100",
    ),
    "a status nobody knows": (
        lambda w: beside(w(), b"Status", b"4"),
        "--valid",
        "--valid 4",
    ),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_is_ambiguous_is_refused_and_the_named_option_settles_it(
    case, bring, refuse, written
):
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


def test_a_row_that_came_twice_is_one_sample(bring, written, truth):
    lines = written().split(b"\n")
    read, said = bring(b"\n".join([*lines[:300], *lines[299:]]))
    assert "1 rows that repeat" in said.err
    assert len(read.tracker) == len(truth.tracker)


def test_a_dry_run_shows_what_is_recognised_and_writes_nothing(
    command, words, truth, tmp_path
):
    data, _ = of_stream(leica, truth.tracker)
    shown = command.run(*words(data, "--dry-run")).out
    assert "X [mm]" in shown
    assert "left out" in shown
    assert not (tmp_path / "bundle").exists()


def iso(t, zone_h=0, begin="2026-03-29T00:59:50"):
    passed = np.timedelta64(round(1e6 * t) + 3_600_000_000 * zone_h, "us")
    return f"{np.datetime64(begin) + passed}+{zone_h:02d}:00"


BY_CLOCK = "Timestamp,X [mm],Y [mm],Z [mm]"


def test_a_zone_that_changes_to_summer_time_is_no_gap(bring, written, truth):
    data = written(head=BY_CLOCK, stamp=lambda t: iso(t, 1 if t < 10.0 else 2))
    assert_times(bring(data)[0], truth)


def test_a_clock_that_is_set_back_is_refused_at_its_row(refuse, written):
    def local(t):
        return iso(t if t < 10.0 else t - 3600.0)[:-6]

    said = refuse(written(head=BY_CLOCK, stamp=local))
    for word in ("export.txt", "Timestamp", "does not increase", "2026-03-29T00:59"):
        assert word in said


def test_a_long_gap_and_a_position_that_stays_are_noted_with_their_rows(
    command, words, written
):
    def late(t):
        return iso(t if t < 10.0 else t + 3600.0)[:-6]

    lines = written(head=BY_CLOCK, stamp=late).split(b"\n")
    stuck = lines[801].partition(b",")[2]
    for row in range(801, 901):
        lines[row] = lines[row].partition(b",")[0] + b"," + stuck
    said = command.run(*words(b"\n".join(lines), "--dry-run")).err
    assert "a gap of 3600.01 s before row" in said
    assert "rows 802 to 901 repeat one position" in said
