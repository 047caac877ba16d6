"""Exports as the software of the field writes them, made by hand from truth."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from truepath.cli import command
from truepath.errors import BundleError
from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.files.imports.options import TextOptions
from truepath.files.imports.recording import read_recording
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.turning_paths import turning_path
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic


@pytest.fixture(scope="module")
def drive(record):
    """A recording on the fly."""
    return record(1, rows=12)[0]


@pytest.fixture(scope="module")
def spots(record):
    """Commanded points, and where a tracker that stands turned sees them."""
    commanded = record(2, "standstill", rows=30)[0].commanded
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return commanded, commanded.position @ turn.T + [3000.0, 100.0, -50.0]


def read(text, commanded, **options):
    data = text if isinstance(text, bytes) else text.encode()
    return read_recording(data, "export.txt", commanded, TextOptions(**options))


def lines_of(run, form, first=None):
    """Return a line a sample: form(number, seconds since the first, x, y, z)."""
    time_s = run.tracker.device_time_s - run.tracker.device_time_s[0]
    p = run.tracker.position_mm
    rows = [form(k, t, *p[k]) for k, t in enumerate(time_s.tolist())]
    return "\n".join([first, *rows] if first else rows)


def assert_stream(read, run, mm=6e-4, second=2e-6):
    valid = run.tracker.status == 0
    assert (read.samples.status == 0).tolist() == valid.tolist()
    gap = read.samples.position_mm[valid] - run.tracker.position_mm[valid]
    assert np.abs(gap).max() < mm
    time_s = run.tracker.device_time_s - run.tracker.device_time_s[0]
    assert np.abs(read.samples.device_time_s - time_s).max() < second


SA_HEAD = (
    "// Points Relative to Coordinate Frame 'A::WORLD'\n"
    "// AXES = CARTESIAN: X,  Y,  Z (mm)\n//"
)


def spatial(k, t, x, y, z):
    """Collection, group, number, place, and a date of whole seconds."""
    second = int(t + 0.3)
    clock = f"11/28/2026 02:{second // 60:02d}:{second % 60:02d} AM"
    return f"A, run, {k + 1}, {x:.4f}, {y:.4f}, {z:.4f}, {clock}"


def spatial_blanks(k, t, x, y, z):
    return spatial(k, t, x, y, z).replace(", ", "  ")


def udp(k, t, x, y, z):
    return (
        f"X,{x:.4f},Y,{y:.4f},Z,{z:.4f},Rx,0.0012,Ry,-0.0301,Rz,1.2,Time(sec),{t:.6f}"
    )


def equals(k, t, x, y, z):
    return f"Cnt={k + 1} X={x:.4f} Y={y:.4f} Z={z:.4f}"


def fortran(k, t, x, y, z):
    return f"{t:.9E}  {x:.9E}  {y:.9E}  {z:.9E}".replace("E", "D")


def exponents(k, t, x, y, z):
    return f"{t:.9e}  {x:.9e}  {y:.9e}  {z:.9e}"


def trailing(k, t, x, y, z):
    return f"{t:.6f},{x:.4f},{y:.4f},{z:.4f},,"


def comment(k, t, x, y, z):
    return f"{t:.6f},{x:.4f},{y:.4f},{z:.4f}," + ("start" if k == 5 else "")


def swiss(k, t, x, y, z):
    cells = [f"{v:,.4f}".replace(",", "\u2019") for v in (1e3 * x, 1e3 * y, 1e3 * z)]
    return f"{t:.6f};" + ";".join(cells).replace("-", "\u2212")


def french(k, t, x, y, z):
    cells = [f"{v:,.4f}".replace(",", "\u202f") for v in (1e3 * x, 1e3 * y, 1e3 * z)]
    return ";".join([f"{t:.3f}", *cells]).replace(".", ",")


def nbsp(k, t, x, y, z):
    cells = [f"{v:,.1f}".replace(",", "\u00a0") for v in (1e3 * x, 1e3 * y, 1e3 * z)]
    return "  ".join([f"{t:.6f}", *cells]).replace(".", ",")


def angles(k, t, x, y, z):
    return f"{t:.6f}\t{x:.4f}\t{y:.4f}\t{z:.4f}\t{k % 400}.1\t99.2"


STREAMS = {
    "SpatialAnalyzer": (spatial, SA_HEAD, 3e-3),
    "SpatialAnalyzer, blanks": (spatial_blanks, SA_HEAD, 3e-3),
    "UDP": (udp, None, 2e-6),
    "exponents": (exponents, None, 2e-6),
    "exponents of Fortran": (fortran, None, 2e-6),
    "trailing commas": (trailing, "t_s,x_mm,y_mm,z_mm", 2e-6),
    "a column mostly empty": (comment, "t_s,x_mm,y_mm,z_mm,Comment", 2e-6),
    "apostrophe and minus": (swiss, "t [s];x [um];y [um];z [um]", 2e-6),
    "narrow blanks, decimal commas": (french, "t [s];x [µm];y [µm];z [µm]", 1e-3),
    "blanks that do not break": (nbsp, "t[s] x[um] y[um] z[um]", 2e-6),
    "gon": (angles, "t [s]\tx [mm]\ty [mm]\tz [mm]\tHz [gon]\tV [gon]", 2e-6),
    "no units": (trailing, "t,x,y,z", 2e-6),
}


@pytest.mark.parametrize("style", STREAMS)
def test_a_stream_is_read_as_its_software_writes_it(style, drive):
    form, head, second = STREAMS[style]
    assert_stream(
        read(lines_of(drive, form, head), drive.commanded), drive, second=second
    )


def test_a_log_without_times_is_read_at_a_rate_or_refused_naming_it(drive):
    text = lines_of(drive, equals)
    with pytest.raises(BundleError, match=r"time.*--rate"):
        read(text, drive.commanded)
    assert_stream(read(text, drive.commanded, rate_hz=500.0), drive)


@pytest.mark.parametrize("unit", [1e3, 1e6])
def test_the_one_unit_that_fits_is_taken_and_said(unit, drive):
    text = lines_of(
        drive,
        lambda k, t, x, y, z: (
            f"{t * unit:.0f} {x / 25.4:.7f} {y / 25.4:.7f} {z / 25.4:.7f}"
        ),
        "time x y z",
    )
    got = read(text, drive.commanded)
    assert_stream(got, drive)
    assert "inch" in got.facts["unit"]
    assert "500 Hz" in got.facts["time"]
    assert {1e3: "ms", 1e6: "us"}[unit] in got.facts["time"]


def test_metres_that_are_stated_as_mm_are_refused_with_file_and_factor(drive):
    text = lines_of(
        drive,
        lambda k, t, x, y, z: f"{t:.6f},{x / 1e3:.7f},{y / 1e3:.7f},{z / 1e3:.7f}",
        "t_s,x_mm,y_mm,z_mm",
    )
    with pytest.raises(BundleError, match=r"export.txt.* 1000 times .*look like m\b"):
        read(text, drive.commanded)


@pytest.mark.parametrize("beam", ["alone", "side by side"])
def test_rows_of_a_lost_beam_keep_their_place(beam, drive):
    gone = {500, 501, 502} if beam == "side by side" else {500, 900, 1500}
    text = lines_of(
        drive,
        lambda k, t, x, y, z: (
            f"{t:.6f}," + ("0,0,0" if k in gone else f"{x:.4f},{y:.4f},{z:.4f}")
        ),
        "t_s,x_mm,y_mm,z_mm",
    )
    got = read(text, drive.commanded)
    assert set(np.flatnonzero(got.samples.status).tolist()) == gone


def name_points(seen, form, count=None):
    return "\n".join(form(k, *p) for k, p in enumerate(seen[:count]))


@pytest.mark.parametrize("gone", [(), (7,), (7, 8)])
def test_points_keep_their_place_beside_lost_ones(gone, spots):
    commanded, seen = spots
    text = "x_mm,y_mm,z_mm\n" + name_points(
        seen,
        lambda k, x, y, z: "0.0,0.0,0.0" if k in gone else f"{x:.4f},{y:.4f},{z:.4f}",
    )
    got = read(text, commanded)
    assert got.points.row.tolist() == [
        k for k in range(len(commanded)) if k not in gone
    ]


@pytest.mark.parametrize("tick", [0.016, 0.1])
def test_stamps_in_bursts_become_the_times_of_rows_that_come_evenly(tick, drive):
    text = lines_of(
        drive,
        lambda k, t, x, y, z: f"{t // tick * tick:.6f},{x:.4f},{y:.4f},{z:.4f}",
        "t_s,x_mm,y_mm,z_mm",
    )
    got = read(text, drive.commanded)
    assert_stream(got, drive, second=2.0 * tick)
    step = np.diff(got.samples.device_time_s)
    np.testing.assert_allclose(step, 0.002, rtol=1e-3)
    assert any("500 Hz" in note for note in got.notes)


def test_stamps_of_arrival_in_bursts_become_even(drive):
    text = lines_of(
        drive,
        lambda k, t, x, y, z: (
            f"{k // 8 * 0.016 + k % 8 * 2e-5:.6f},{x:.4f},{y:.4f},{z:.4f}"
        ),
        "t_s,x_mm,y_mm,z_mm",
    )
    got = read(text, drive.commanded)
    np.testing.assert_allclose(np.diff(got.samples.device_time_s), 0.002, rtol=1e-3)


def test_rounded_stamps_beside_a_hole_are_not_smoothed_over(drive):
    lines = lines_of(
        drive,
        lambda k, t, x, y, z: f"{t // 1.0:.0f},{x:.4f},{y:.4f},{z:.4f}",
        "t_s,x_mm,y_mm,z_mm",
    ).split("\n")
    with pytest.raises(BundleError, match=r"row .*does not increase"):
        read("\n".join(lines[:3100] + lines[3500:]), drive.commanded)
    whole = read("\n".join(lines[:3001] + lines[5001:]), drive.commanded)
    assert np.isclose(np.diff(whole.samples.device_time_s).max(), 4.0, atol=0.1)


@pytest.mark.parametrize(
    ("size", "unit", "head"),
    [(2**32, 1e6, "us"), (2**16, 1e3, "ms"), (3600, 1.0, "s"), (2**32, 1e6, "signed")],
)
def test_a_counter_that_wraps_goes_on(size, unit, head, drive):
    def form(k, t, x, y, z):
        value = (t * unit + size - 9.0 * unit) % size
        value -= size if head == "signed" and value >= size / 2 else 0
        return f"{value:.6f},{x:.4f},{y:.4f},{z:.4f}"

    if head == "signed":
        begin = size / 2 - 9.0 * unit

        def form(k, t, x, y, z):
            value = (t * unit + begin + size / 2) % size - size / 2
            return f"{value:.0f},{x:.4f},{y:.4f},{z:.4f}"

    text = lines_of(drive, form, f"t_{head.replace('signed', 'us')},x_mm,y_mm,z_mm")
    assert_stream(read(text, drive.commanded), drive, second=1e-5)


def gsi(seen, digits, unit, factor):
    blocks = ["410001+" + "0" * (digits - 2) + "17"]
    for k, place in enumerate(seen):
        words = [f"11{k + 1:04d}+" + f"P{k + 1}".rjust(digits, "0")]
        words += [
            f"{81 + axis}..1{unit}{'+-'[int(v < 0)]}{abs(round(v * factor)):0{digits}d}"
            for axis, v in enumerate(place)
        ]
        words.append("87..10+" + "0" * digits)
        blocks.append(" ".join(words) + " ")
    star = "*" if digits == 16 else ""
    return "\r\n".join(star + block for block in blocks)


@pytest.mark.parametrize(
    ("digits", "unit", "factor"), [(8, 6, 10.0), (16, 8, 100.0), (16, 0, 1.0)]
)
def test_points_of_gsi_are_read_with_their_names_and_unit(digits, unit, factor, spots):
    commanded, seen = spots
    got = read(gsi(seen, digits, unit, factor), commanded)
    assert got.points.row.tolist() == list(range(len(commanded)))
    assert np.abs(got.samples.position_mm - seen).max() < 0.51 / factor + 1e-6


SEEN = {
    "GSI angles": (
        "\n".join(f"11{k:04d}+0000000{k} 21.102+19723700 " for k in range(9)),
        "21",
    ),
    "spherical": (
        "// AXES = SPHERICAL: R, THETA, PHI (mm, deg)\n"
        + "\n".join(f"A, g, p{k}, 2000.{k}, 12.{k}, 3.{k}" for k in range(9)),
        "SPHERICAL",
    ),
    "polar": (
        "Nr;Hz [gon];V [gon];D [mm]\n"
        + "\n".join(f"{k};{k}.5;99.{k};2000.{k}" for k in range(9)),
        r"Hz \[gon\]",
    ),
    "an interferometer": (
        "HEADER::\nFile type 0-RTL\nTARGETS:: 5\nTarget-data: \nDEVIATIONS::\n"
        "Run Target Data:\n1 0.0012\n2 0.0013\nEOF::\n",
        "HEADER::",
    ),
    "prose": ("Some words\nof a log\nthat holds nothing\n", "that holds nothing"),
}  # fmt: skip


@pytest.mark.parametrize("case", SEEN)
def test_what_is_no_export_of_x_y_z_is_refused_naming_what_was_seen(case, spots):
    text, words = SEEN[case]
    with pytest.raises(BundleError, match=words):
        read(text, spots[0])


def test_names_are_matched_whole(spots):
    commanded, seen = spots
    few = replace(
        commanded, position=commanded.position[:3], dwell_s=commanded.dwell_s[:3]
    )
    head = "Name;x_mm;y_mm;z_mm\n"

    def named(*names):
        return head + "\n".join(
            f"{name};{x:.4f};{y:.4f};{z:.4f}"
            for name, (x, y, z) in zip(names, seen, strict=False)
        )

    for names in (["P12-1", "P12-2", "P12-3"], ["P1", "P2", "Q1"], ["P1", "P2", "P9"]):
        with pytest.raises(BundleError, match=r"export.txt, row \d, column Name: "):
            read(named(*names), few)
    got = read(named("Run 2::P3", "Run 2::P1", "Run 2::P2"), few)
    assert got.points.row.tolist() == [2, 0, 1]
    assert "Run 2::P3 is 3" in got.facts["rows of points"]
    shots = read(named("P1", "P1", "P2", "P3"), few)
    assert shots.points.count.tolist() == [2, 1, 1]


def test_shots_within_one_second_are_shots(spots):
    commanded, seen = spots
    text = (
        SA_HEAD
        + "\n"
        + "\n".join(
            f"A,run,P{k + 1},{x:.4f},{y:.4f},{z + shot:.4f},11/28/2026 2:{k:02d}:05"
            for k, (x, y, z) in enumerate(seen)
            for shot in (0.0, 0.001, 0.002)
        )
    )
    got = read(text, commanded)
    assert got.points.row.tolist() == list(range(len(commanded)))
    assert set(got.points.count.tolist()) == {3}


def test_a_name_in_points_csv_is_the_whole_name(spots, tmp_path, record):
    truth = record(2, "standstill", rows=30)[0]
    write_bundle(truth, tmp_path / "points")
    rows = (tmp_path / "points" / "points.csv").read_text().splitlines()
    named = [f"{row},P12-{k}" for k, row in enumerate(rows)]
    named[0] = f"{rows[0]},name"
    (tmp_path / "points" / "points.csv").write_text("\n".join(named) + "\n")
    lines = ["Name;x_mm;y_mm;z_mm"]
    for k, (x, y, z) in enumerate(spots[1]):
        lines.append(f"A::b::P12-{k + 1};{x:.4f};{y:.4f};{z:.4f}")
    (tmp_path / "export.txt").write_text("\n".join(lines))
    shown = run_import(tmp_path, tmp_path / "points", "points.csv")
    assert shown.returncode == 0, shown.stderr
    assert "A::b::P12-3 is 3" in " ".join(shown.stdout.replace("│", " ").split())


def test_points_beside_lost_ones_and_a_stray_fit_what_was_commanded(
    spots, tmp_path, record
):
    write_bundle(record(2, "standstill", rows=30)[0], tmp_path / "truth")
    seen = spots[1].copy()
    seen[[7, 8]] = 0.0
    seen[20] += [30.0, -20.0, 10.0]
    lines = [f"{x:.4f},{y:.4f},{z:.4f}" for x, y, z in seen]
    (tmp_path / "export.txt").write_text("\n".join(["x_mm,y_mm,z_mm", *lines]))
    shown = run_import(tmp_path, tmp_path / "truth", "points.csv")
    assert shown.returncode == 0, shown.stderr
    assert "2 rows of 0, 0, 0" in shown.stderr


def test_a_rotary_axis_that_is_counted_the_other_way_is_named(tmp_path, capsys):
    content = load_machine("trunnion")
    program = turning_path(parse_machine(content), 5, 16, 9000.0)
    made = synthetic.record(content, program, 3, "otf")
    axes = tuple(content["axes"])
    position = program.position.copy()
    position[:, axes.index("C")] *= -1.0
    content["axes"]["C"] |= {"min_deg": -3600.0, "max_deg": 3600.0}
    rows = [program.feed_mm_s * 60.0, program.dwell_s, program.target]
    samples = [np.arange(len(made)), made.time_s, made.position_mm, made.status]
    run = Run(
        "turned",
        machine_from_json(content),
        Path(axes, position, *rows),
        TrackerSamples(*samples),
    )
    write_bundle(run, tmp_path / "truth")
    text = lines_of(
        run,
        lambda k, t, x, y, z: f"{t:.6f},{x:.5f},{y:.5f},{z:.5f}",
        "t_s,x_mm,y_mm,z_mm",
    )
    (tmp_path / "export.txt").write_text(text)
    assert command.run(arguments(tmp_path, tmp_path / "truth", "path.csv")) == 2
    assert "axis C counted the other way" in capsys.readouterr().err


def arguments(folder, truth, path):
    return [
        "import", str(folder / "export.txt"), "--machine",
        str(truth / "machine.json"), "--path", str(truth / path), "-o",
        str(folder / "bundle"), "--dry-run",
    ]  # fmt: skip


def run_import(folder, truth, path, environment=None):
    main = "from truepath.cli.command import main; main()"
    words = [sys.executable, "-c", main, *arguments(folder, truth, path)]
    return subprocess.run(words, capture_output=True, text=True, env=environment)


def test_what_is_shown_survives_a_terminal_of_ascii(drive, tmp_path):
    write_bundle(drive, tmp_path / "truth")
    text = lines_of(
        drive,
        lambda k, t, x, y, z: f"{t:.6f};{x:.4f};{y:.4f};{z:.4f};20.5;1",
        "t [s];x [mm];y [mm];z [mm];Lufttemperatur [°C];Δ",
    )
    (tmp_path / "export.txt").write_text(text, encoding="utf-8")
    plain = {"LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    shown = run_import(tmp_path, tmp_path / "truth", "path.csv", plain)
    assert shown.returncode == 0, shown.stderr
    assert "Lufttemperatur" in shown.stdout
