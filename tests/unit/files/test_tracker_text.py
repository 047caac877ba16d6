"""Exports as the software of the field writes them, made by hand from truth."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.errors import BundleError
from truepath.files.imports.columns import TextOptions
from truepath.files.imports.recording import read_recording

MM_HEAD = "t_s,x_mm,y_mm,z_mm"
UDP = "X,{:.4f},Y,{:.4f},Z,{:.4f},Rx,0.0012,Ry,-0.0301,Rz,1.2"
SA_HEAD = (
    "// Points Relative to Coordinate Frame 'A::WORLD'\n"
    "// AXES = CARTESIAN: X,  Y,  Z (mm)\n//"
)
APOSTROPHE, MINUS, NARROW = "\u2019", "\u2212", "\u202f"
TOLD_TO_S = {"SpatialAnalyzer": 3e-3, "SpatialAnalyzer, blanks": 3e-3}
TOLD_TO_S["narrow blanks, decimal commas"] = 1e-3


@pytest.fixture(scope="module")
def drive(record):
    return record(1, rows=12)[0]


@pytest.fixture(scope="module")
def spots(record):
    commanded = record(2, "standstill", rows=30)[0].commanded
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return commanded, commanded.position @ turn.T + [3000.0, 100.0, -50.0]


def read(text, commanded, **options):
    data = text if isinstance(text, bytes) else text.encode()
    got = read_recording(data, "export.txt", commanded, TextOptions(**options))
    for problem in got.problems:
        raise problem
    return got


def lines_of(run, form, first=None):
    """Return a line a sample: form(number, seconds since the first, x, y, z)."""
    time_s = run.tracker.device_time_s - run.tracker.device_time_s[0]
    p = run.tracker.position_mm
    rows = [form(k, t, *p[k]) for k, t in enumerate(time_s.tolist())]
    return "\n".join([first, *rows] if first else rows)


def stamped(run, stamp):
    """Return lines of millimetres; stamp(number, seconds) writes the time."""
    form = "{:.6f},{:.4f},{:.4f},{:.4f}".format
    return lines_of(run, lambda k, t, *place: form(stamp(k, t), *place), MM_HEAD)


def assert_stream(read, run, mm=6e-4, second=2e-6):
    valid = run.tracker.status == 0
    assert (read.samples.status == 0).tolist() == valid.tolist()
    gap = read.samples.position_mm[valid] - run.tracker.position_mm[valid]
    assert np.abs(gap).max() < mm
    time_s = run.tracker.device_time_s - run.tracker.device_time_s[0]
    assert np.abs(read.samples.device_time_s - time_s).max() < second


def spatial(k, t, x, y, z):
    second = int(t + 0.3)
    clock = f"11/28/2026 02:{second // 60:02d}:{second % 60:02d} AM"
    return f"A, run, {k + 1}, {x:.4f}, {y:.4f}, {z:.4f}, {clock}"


def join(form, between, *values):
    return between.join(form.format(value) for value in values)


def group(between, mark, *place, form="{:,.4f}"):
    return between.join(form.format(1e3 * v).replace(",", mark) for v in place)


def trailing(k, t, x, y, z):
    return f"{t:.6f},{x:.4f},{y:.4f},{z:.4f},,"


# The line above all, and what writes one.
STREAMS = {
    "SpatialAnalyzer": (SA_HEAD, spatial),
    "SpatialAnalyzer, blanks": (SA_HEAD, lambda *p: spatial(*p).replace(", ", "  ")),
    "UDP": (None, lambda k, t, *p: f"{UDP.format(*p)},Time(sec),{t:.6f}"),
    "exponents": (None, lambda k, *p: join("{:.9e}", "  ", *p)),
    "Fortran": (None, lambda k, *p: join("{:.9E}", "  ", *p).replace("E", "D")),
    "trailing commas": (MM_HEAD, trailing),
    "a column mostly empty": (
        f"{MM_HEAD},Comment",
        lambda k, *p: trailing(k, *p)[:-1] + ("start" if k == 5 else ""),
    ),
    "apostrophe and minus": (
        "t [s];x [um];y [um];z [um]",
        lambda k, t, *p: f"{t:.6f};{group(';', APOSTROPHE, *p)}".replace("-", MINUS),
    ),
    "narrow blanks, decimal commas": (
        "t [s];x [µm];y [µm];z [µm]",
        lambda k, t, *p: f"{t:.3f};{group(';', NARROW, *p)}".replace(".", ","),
    ),
    "blanks that do not break": (
        "t[s] x[um] y[um] z[um]",
        lambda k, t, *p: join(
            "{}", "  ", f"{t:.6f}", group("  ", "\u00a0", *p, form="{:,.1f}")
        ).replace(".", ","),
    ),
    "gon": (
        "t [s]\tx [mm]\ty [mm]\tz [mm]\tHz [gon]\tV [gon]",
        lambda k, *p: join("{:.6f}", "\t", *p) + f"\t{k % 400}.1\t99.2",
    ),
    "no units": ("t,x,y,z", trailing),
}


@pytest.mark.parametrize("style", STREAMS)
def test_a_stream_is_read_as_its_software_writes_it(style, drive):
    head, form = STREAMS[style]
    got = read(lines_of(drive, form, head), drive.commanded)
    assert_stream(got, drive, second=TOLD_TO_S.get(style, 2e-6))


def test_a_log_without_times_is_read_at_a_rate_or_refused_naming_it(drive):
    form = "Cnt={} X={:.4f} Y={:.4f} Z={:.4f}".format
    text = lines_of(drive, lambda k, t, *place: form(k + 1, *place))
    with pytest.raises(BundleError, match=r"time.*--rate"):
        read(text, drive.commanded)
    assert_stream(read(text, drive.commanded, rate_hz=500.0), drive)


@pytest.mark.parametrize("unit", [1e3, 1e6])
def test_the_one_unit_that_fits_is_taken_and_said(unit, drive):
    def form(k, t, *place):
        return join("{}", " ", f"{t * unit:.0f}", *(f"{v / 25.4:.7f}" for v in place))

    got = read(lines_of(drive, form, "time x y z"), drive.commanded)
    assert_stream(got, drive)
    assert "inch" in got.facts["unit"]
    assert "500 Hz" in got.facts["time"]
    assert {1e3: "ms", 1e6: "us"}[unit] in got.facts["time"]


@pytest.mark.parametrize("beam", ["alone", "side by side"])
def test_rows_of_a_lost_beam_keep_their_place(beam, drive):
    gone = {500, 501, 502} if beam == "side by side" else {500, 900, 1500}

    def form(k, t, *place):
        return f"{t:.6f},{'0,0,0' if k in gone else join('{:.4f}', ',', *place)}"

    got = read(lines_of(drive, form, MM_HEAD), drive.commanded)
    assert set(np.flatnonzero(got.samples.status).tolist()) == gone


@pytest.mark.parametrize("tick", [0.016, 0.1])
def test_stamps_in_bursts_become_the_times_of_rows_that_come_evenly(tick, drive):
    got = read(stamped(drive, lambda k, t: t // tick * tick), drive.commanded)
    assert_stream(got, drive, second=2.0 * tick)
    np.testing.assert_allclose(np.diff(got.samples.device_time_s), 0.002, rtol=1e-3)
    assert any("500 Hz" in note for note in got.notes)


def test_stamps_of_arrival_in_bursts_become_even(drive):
    text = stamped(drive, lambda k, t: k // 8 * 0.016 + k % 8 * 2e-5)
    got = read(text, drive.commanded)
    np.testing.assert_allclose(np.diff(got.samples.device_time_s), 0.002, rtol=1e-3)


@pytest.mark.parametrize(
    ("tick", "first", "end"),
    [(1.0, 3100, 3500), (1.0, 3100, 5300), (1.0, 3000, 5000), (0.1, 3001, 3041)],
)
def test_rounded_stamps_beside_a_hole_are_not_smoothed_over(tick, first, end, drive):
    lines = stamped(drive, lambda k, t: t // tick * tick).split("\n")
    got = read("\n".join(lines[: first + 1] + lines[end + 1 :]), drive.commanded)
    time_s = np.delete(drive.tracker.device_time_s, np.arange(first, end))
    used = got.samples.status == 0
    assert np.ptp((got.samples.device_time_s - time_s)[used]) < 2e-3
    assert (~used).sum() < 500 * tick  # rows of one stamp
    assert any("rows are missing by their times" in note for note in got.notes)


@pytest.mark.parametrize(
    ("size", "head", "lowest"),
    [(2**32, "us", 0), (2**16, "ms", 0), (3600, "s", 0), (2**32, "us", -(2**31))],
)
def test_a_counter_that_wraps_goes_on(size, head, lowest, drive):
    unit = {"s": 1.0, "ms": 1e3, "us": 1e6}[head]
    begin = size + lowest - 9.0 * unit  # it wraps after nine seconds
    text = stamped(drive, lambda k, t: (t * unit + begin - lowest) % size + lowest)
    text = text.replace("t_s", f"t_{head}")
    assert_stream(read(text, drive.commanded), drive, second=1e-5)


@pytest.mark.parametrize(
    ("digits", "unit", "factor"), [(8, 6, 10.0), (16, 8, 100.0), (16, 0, 1.0)]
)
def test_points_of_gsi_are_read_with_their_names_and_unit(digits, unit, factor, spots):
    commanded, seen = spots
    blocks = ["410001+" + "0" * (digits - 2) + "17"]
    for k, place in enumerate(seen):
        words = [f"11{k + 1:04d}+" + f"P{k + 1}".rjust(digits, "0")]
        for axis, v in enumerate(place):
            number = f"{abs(round(v * factor)):0{digits}d}"
            words.append(f"{81 + axis}..1{unit}{'+-'[int(v < 0)]}{number}")
        words.append("87..10+" + "0" * digits)
        blocks.append(" ".join(words) + " ")
    star = "*" if digits == 16 else ""
    got = read("\r\n".join(star + block for block in blocks), commanded)
    assert got.points.row.tolist() == list(range(len(commanded)))
    assert np.abs(got.samples.position_mm - seen).max() < 0.51 / factor + 1e-6


def nine(head, row):
    return head + "\n".join(row.replace("K", str(k)) for k in range(9))


SEEN = {
    "GSI angles": (nine("", "11000K+0000000K 21.102+19723700 "), "21"),
    "spherical": (
        nine("// AXES = SPHERICAL: R, THETA, PHI (mm, deg)\n", "A,g,pK,2.K,12.K,3.K"),
        "SPHERICAL",
    ),
    "polar": (nine("Nr;Hz [gon];V [gon];D [mm]\n", "K;K.5;99.K;2000.K"), r"Hz \[gon\]"),
    "an interferometer": (
        "HEADER::\nFile type 0-RTL\nTARGETS:: 5\nTarget-data: \nDEVIATIONS::\n"
        "Run Target Data:\n1 0.0012\n2 0.0013\nEOF::\n",
        "HEADER::",
    ),
    "prose": ("Some words\nof a log\nthat holds nothing\n", "that holds nothing"),
}


@pytest.mark.parametrize("case", SEEN)
def test_what_is_no_export_of_x_y_z_is_refused_naming_what_was_seen(case, spots):
    text, words = SEEN[case]
    with pytest.raises(BundleError, match=words):
        read(text, spots[0])


def test_names_are_matched_whole(spots):
    commanded, seen = spots
    three = {"position": commanded.position[:3], "dwell_s": commanded.dwell_s[:3]}
    few = replace(commanded, **three)
    head = "Name;x_mm;y_mm;z_mm\n"

    def named(*names):
        pairs, form = zip(names, seen, strict=False), "{};{:.4f};{:.4f};{:.4f}".format
        return head + "\n".join(form(name, *place) for name, place in pairs)

    for names in (["P12-1", "P12-2", "P12-3"], ["P1", "P2", "Q1"], ["P1", "P2", "P9"]):
        with pytest.raises(BundleError, match=r"export.txt, row \d, column Name: "):
            read(named(*names), few)
    got = read(named("Run 2::P3", "Run 2::P1", "Run 2::P2"), few)
    assert got.points.row.tolist() == [2, 0, 1]
    assert "Run 2::P3 is 3" in got.facts["rows of points"]
    assert read(named("P1", "P1", "P2", "P3"), few).points.count.tolist() == [2, 1, 1]


def test_shots_within_one_second_are_shots(spots):
    commanded, seen = spots
    lines = [SA_HEAD]
    for k, place in enumerate(seen):
        for x, y, z in (place - 1e-3, place, place + 1e-3):
            stamp = f"11/28/2026 2:{k:02d}:05"
            lines.append(f"A,run,P{k + 1},{x:.4f},{y:.4f},{z:.4f},{stamp}")
    got = read("\n".join(lines), commanded)
    assert got.points.row.tolist() == list(range(len(commanded)))
    assert set(got.points.count.tolist()) == {3}
    np.testing.assert_allclose(got.points.covariance_mm2, 1e-6, rtol=1e-3)
