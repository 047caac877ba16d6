"""`import`: files as several makers' software writes them, made by hand from truth."""

import json

import numpy as np
import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.motion.nc_programs.programs import write_program

HZ = 500.0


def rows_of(run_of_truth):
    stream = run_of_truth.tracker
    return zip(stream.device_time_s, stream.position_mm, stream.status, strict=True)


def word(value, digits=4):
    return f"{value:.{digits}f}"


def leica(run_of_truth):
    """BOM, Windows line ends, a preamble, ISO times, units in brackets, air."""
    text = ["Leica Tracker Pilot export", "Operator,A. Smith", ""]
    text += ["Index,X [mm],Y [mm],Z [mm],Timestamp,Air Temperature [°C],Pressure [hPa]"]
    for k, (t, p, _) in enumerate(rows_of(run_of_truth)):
        clock = np.datetime64("2026-03-01T23:59:50") + np.timedelta64(
            round(t * 1e6), "us"
        )
        cells = [str(k + 1), *map(word, p), str(clock), "20.5", "1013.2"]
        text.append(",".join(cells))
    return ("\r\n".join(text) + "\r\n").encode("utf-8-sig")


def german(run_of_truth):
    """Semicolons, decimal commas, metres, ms, a footer, the header twice, cp1252."""
    head = "Nr.;Zeit [ms];X-Ist [m];Y-Ist [m];Z-Ist [m];Temperatur Z (°C)"
    text = ["Einheit: m", head, head]
    for k, (t, p, status) in enumerate(rows_of(run_of_truth)):
        cells = [word(v / 1e3, 7) for v in p] if status == 0 else ["---"] * 3
        cells = [str(k + 1), word(1e3 * t, 3), *cells, "21.25"]
        text.append(";".join(cells).replace(".", ","))
    text += ["", f"Anzahl Punkte: {k + 1}", "Ende"]
    return "\n".join(text).encode("cp1252")


def spatial(run_of_truth):
    """Comment lines, blanks between columns, inches named above, a name of a frame."""
    text = ["// SpatialAnalyzer ASCII export", "// Units: inches", "// Frame: TRACKER"]
    text += ["Units: inches", "X Y Z Elapsed[s] Status"]
    for t, p, status in rows_of(run_of_truth):
        cells = [word(v / 25.4, 7) for v in p] if status == 0 else ["NaN"] * 3
        text.append("  ".join([*cells, word(t, 6), "OK" if status == 0 else "LOST"]))
    return "\n".join(text).encode()


def french(run_of_truth):
    """Tabs, decimal commas, a line of units, the time of day."""
    text = ["Heure\tPosition X\tPosition Y\tPosition Z", "\tmm\tmm\tmm"]
    for t, p, _ in rows_of(run_of_truth):
        clock = f"10:{int(t // 60):02d}:{t % 60:09.6f}"
        text.append("\t".join([clock, *map(word, p)]).replace(".", ","))
    return "\n".join(text).encode("utf-16")


STYLES = [leica, german, spatial, french]


@pytest.fixture
def bring(tmp_path, record):
    """Import text beside machine and path of a recording; the exit status."""
    write_bundle(record(1, rows=12)[0], tmp_path / "truth")

    def bring(data, *options, path="path.csv", truth="truth"):
        (tmp_path / "export.txt").write_bytes(data)
        source = tmp_path / truth
        place = source / path if (source / path).exists() else tmp_path / path
        return run([
            "import", str(tmp_path / "export.txt"), "--machine",
            str(source / "machine.json"), "--path", str(place), "-o",
            str(tmp_path / "bundle"), *options,
        ])  # fmt: skip

    return bring


@pytest.mark.parametrize("style", STYLES)
def test_the_stream_of_an_export_is_the_one_that_was_recorded(
    style, bring, record, tmp_path
):
    truth = record(1, rows=12)[0]
    assert bring(style(truth)) == 0
    read = read_bundle(tmp_path / "bundle").tracker
    valid = truth.tracker.status == 0
    assert (read.status == 0).tolist() == valid.tolist()
    gap = read.position_mm[valid] - truth.tracker.position_mm[valid]
    assert np.abs(gap).max() < 2e-4
    time_s = truth.tracker.device_time_s
    np.testing.assert_allclose(read.device_time_s, time_s - time_s[0], atol=1.1e-6)


def test_temperatures_of_an_export_are_in_the_bundle(bring, record, tmp_path):
    assert bring(german(record(1, rows=12)[0])) == 0
    told = read_bundle(tmp_path / "bundle").temperature
    assert told.names == ("Z",)
    assert told.celsius.ravel().tolist() == [21.25, 21.25]


@pytest.mark.fault_row(43)
def test_a_temperature_that_cannot_be_is_left_out_with_a_note(
    bring, record, tmp_path, capsys
):
    """The sensor falls to 0 halfway, as with its words in the wrong order."""
    rows = list(rows_of(record(1, rows=12)[0]))
    text = ["t_s,x_mm,y_mm,z_mm,X_degC"]
    for number, (t, p, _) in enumerate(rows):
        degc = 20.0 + 0.1 * (number % 3) if 2 * number < len(rows) else 2.3e-41
        text.append(",".join(map(repr, (float(t), *map(float, p), degc))))
    assert bring("\n".join(text).encode()) == 0
    assert "X_degC: " in "".join(capsys.readouterr())
    run_of_export = read_bundle(tmp_path / "bundle")
    assert run_of_export.temperature.celsius.min() >= 20.0
    assert any("X_degC" in e.text for e in run_of_export.events)


def test_an_nc_program_is_the_path_that_it_drives(bring, record, tmp_path):
    truth = record(1, rows=12)[0]
    program = write_program(truth.commanded, truth.machine, "heidenhain")
    (tmp_path / "program.h").write_text(program)
    assert bring(german(truth), path="program.h") == 0
    read = read_bundle(tmp_path / "bundle").commanded
    np.testing.assert_allclose(read.position, truth.commanded.position, atol=1e-9)
    np.testing.assert_allclose(read.feed_mm_min, truth.commanded.feed_mm_min)


@pytest.mark.long
def test_an_export_and_an_nc_program_give_the_tables_of_the_machine(
    bring, record, tmp_path
):
    truth = record(1, rows=12)[0]
    program = write_program(truth.commanded, truth.machine, "heidenhain")
    (tmp_path / "program.h").write_text(program)
    assert bring(german(truth), path="program.h") == 0
    tables = []
    for name in ("truth", "bundle"):
        out = tmp_path / f"{name}-result"
        assert run(["analyse", str(tmp_path / name), "-o", str(out)]) == 0
        tables.append(json.loads((out / "result.json").read_text())["error_tables"])
    for symbol in ("EXX", "EYX", "EZZ"):
        ours, theirs = (np.array(table[symbol]["value_um"]) for table in tables)
        assert np.abs(ours - theirs).max() < 0.1


def test_a_list_of_points_is_a_bundle_of_points(bring, record, tmp_path):
    truth = record(2, "standstill", rows=30)[0]
    write_bundle(truth, tmp_path / "points")

    position = truth.commanded.position
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    text = ["Name;X [mm];Y [mm];Z [mm]"]
    for k, p in enumerate(position @ turn.T + [3000.0, 100.0, -50.0]):
        for shot in (-1, 1):
            x, y, z = (f"{v + shot * 1e-3:.4f}".replace(".", ",") for v in p)
            text.append(f"P{k + 1};{x};{y};{z}")
    data = "\n".join(text).encode()
    assert bring(data, path="points.csv", truth="points") == 0
    read = read_bundle(tmp_path / "bundle")
    assert read.points.row.tolist() == list(range(len(position)))
    assert set(read.points.count.tolist()) == {2}
    np.testing.assert_allclose(read.points.covariance_mm2, 2e-6, rtol=1e-3)


def edit(style, *pairs):
    def make(truth):
        data = style(truth)
        for old, new in pairs:
            assert old in data
            data = data.replace(old, new)
        return data

    return make


def plain(truth, head="t_s,x_mm,y_mm,z_mm", scale=(1.0, 1.0, 1.0), time="{:.6f}", d=4):
    rows = [head] if head else []
    for t, p, _ in rows_of(truth):
        rows.append(
            ",".join(
                [
                    time.format(t),
                    *(word(v * s, d) for v, s in zip(p, scale, strict=True)),
                ]
            )
        )
    return "\n".join(rows).encode()


def missing(data):
    lines = data.split(b"\n")
    return b"\n".join(lines[:3010] + lines[3050:6010] + lines[6050:])


def late(truth, day=""):
    rows = ["Time,X[mm],Y[mm],Z[mm]"]
    for t, p, _ in rows_of(truth):
        s = (86395.0 + t - truth.tracker.device_time_s[0]) % 86400
        rows.append(
            ",".join(
                [
                    f"{int(s // 3600):02d}:{int(s // 60 % 60):02d}:{s % 60:09.6f}",
                    *map(word, p),
                ]
            )
        )
    return "\n".join(rows).encode()


AMBIGUOUS = {
    "a unit that is not usual": (
        lambda t: plain(t, "t_s,x,y,z", (0.1, 0.1, 0.1), d=6), "--unit", "--unit cm",
    ),
    "wrong unit": (
        lambda t: plain(t, "t_s,x_m,y_m,z_m"), "extend over", "--unit mm",
    ),
    "more decimals without names than x, y, z": (
        lambda t: plain(t, "").replace(b"\n", b",0.5\n"), "--column x=NUMBER",
        "--column time=1 --column x=2 --column y=3 --column z=4",
    ),
    "two columns of x": (
        lambda t: plain(t, "x measured,x_mm,y_mm,z_mm"), "'x measured' (1)",
        "--column x=2 --column time=1 --time-unit s",
    ),
    "left-handed": (
        lambda t: plain(t, scale=(1, -1, 1)), "--axes", "--axes x,-y,z",
    ),
    "midnight": (late, "--across-midnight", "--across-midnight"),
    "times that are rounded": (
        lambda t: missing(plain(t, time="{:.1f}")), "--rate", "--rate 500",
    ),
    "a status nobody knows": (
        edit(spatial, (b"OK", b"4")), "--valid", "--valid 4",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_is_ambiguous_is_refused_and_the_named_option_settles_it(
    case, bring, record, capsys, tmp_path
):
    make, words, option = AMBIGUOUS[case]
    data = make(record(1, rows=12)[0])
    assert bring(data) == 2
    text = capsys.readouterr().err
    assert words in text, text
    assert not (tmp_path / "bundle").exists()
    assert bring(data, *option.split()) == 0, capsys.readouterr().err


REFUSED = {
    "commas for both": lambda t: german(t).replace(b";", b","),
    "a broken line": lambda t: plain(t).replace(b"\n", b"\n1.0,2.0\n", 5),
    "a word for a number": edit(plain, (b"\n", b"\nabc,")),
    "a picture": lambda t: b"\x89PNG\0\0",
    "nothing": lambda t: b"",
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused(case, bring, record, capsys, tmp_path):
    assert bring(REFUSED[case](record(1, rows=12)[0])) == 2
    assert "export.txt" in capsys.readouterr().err
    assert not (tmp_path / "bundle").exists()


def test_a_row_that_came_twice_is_one_sample(bring, record, capsys, tmp_path):
    truth = record(1, rows=12)[0]
    lines = plain(truth).split(b"\n")
    assert bring(b"\n".join([*lines[:300], *lines[299:]])) == 0
    assert "1 rows that repeat" in capsys.readouterr().err
    assert len(read_bundle(tmp_path / "bundle").tracker) == len(truth.tracker)


def test_a_dry_run_shows_what_is_recognised_and_writes_nothing(
    bring, record, capsys, tmp_path
):
    assert bring(leica(record(1, rows=12)[0]), "--dry-run") == 0
    shown = capsys.readouterr().out
    assert "X [mm]" in shown
    assert "left out" in shown
    assert not (tmp_path / "bundle").exists()


def by_clock(truth, stamp, also=lambda k, cells: cells):
    rows = ["Timestamp,X [mm],Y [mm],Z [mm]"]
    first = truth.tracker.device_time_s[0]
    for k, (t, p, _) in enumerate(rows_of(truth)):
        rows.append(",".join(also(k, [stamp(float(t - first)), *map(word, p)])))
    return "\n".join(rows).encode()


def iso(t, zone_h=0, begin="2026-03-29T00:59:50"):
    passed = np.timedelta64(round(1e6 * t) + 3_600_000_000 * zone_h, "us")
    return f"{np.datetime64(begin) + passed}+{zone_h:02d}:00"


def test_a_zone_that_changes_to_summer_time_is_no_gap(bring, record, tmp_path):
    truth = record(1, rows=12)[0]
    data = by_clock(truth, lambda t: iso(t, 1 if t < 10.0 else 2))
    assert bring(data) == 0
    read = read_bundle(tmp_path / "bundle").tracker.device_time_s
    time_s = truth.tracker.device_time_s
    np.testing.assert_allclose(read, time_s - time_s[0], atol=1.1e-6)


def test_a_clock_that_is_set_back_is_refused_at_its_row(bring, record, capsys):
    def local(t):
        return iso(t if t < 10.0 else t - 3600.0)[:-6]

    assert bring(by_clock(record(1, rows=12)[0], local)) == 2
    text = capsys.readouterr().err
    for word_of in ("export.txt", "Timestamp", "does not increase", "2026-03-29T00:59"):
        assert word_of in text


def test_a_long_gap_and_a_position_that_stays_are_noted_with_their_rows(
    bring, record, capsys
):
    truth = record(1, rows=12)[0]
    stuck = [word(v) for v in truth.tracker.position_mm[4000]]
    data = by_clock(
        truth,
        lambda t: iso(t if t < 10.0 else t + 3600.0)[:-6],
        lambda k, cells: [cells[0], *stuck] if 4000 <= k < 4100 else cells,
    )
    bring(data, "--dry-run")
    said = capsys.readouterr().err
    assert "a gap of 3600 s before row" in said
    assert "rows 4002 to 4101 repeat one position" in said
