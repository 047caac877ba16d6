"""Bundles: there and back again, folders and archives, speed."""

import zipfile
from dataclasses import asdict, replace

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest

from truepath.documents import whole_files
from truepath.errors import BundleError
from truepath.files.bundle import bundle as bundle_file
from truepath.files.bundle.bundle import read_bundle, write_bundle, zip_bundle
from truepath.kinematics.machine.machine import RotaryAxis, Target
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import Path

OUTSIDE = ("../machine.json", "/etc/machine.json", "C:/machine.json", "a\\..\\b")


def assert_same(first, second):
    told = {"name": "", "provenance": {}, "stream_file": ""}
    runs = [replace(run, **told) for run in (first, second)]
    np.testing.assert_equal(*map(asdict, runs))


def test_the_quality_of_samples_is_kept_where_it_is_told(tmp_path, run):
    told = np.linspace(0.1, 1.0, len(run.tracker)).astype(np.float32)
    told[3] = np.nan
    graded = replace(run, tracker=replace(run.tracker, quality=told))
    write_bundle(graded, tmp_path / "told")
    np.testing.assert_array_equal(read_bundle(tmp_path / "told").tracker.quality, told)
    write_bundle(run, tmp_path / "untold")
    assert read_bundle(tmp_path / "untold").tracker.quality is None


def standstill(run):
    path = run.commanded
    points = Configurations(path.axes, path.position, np.full(len(path), 2.0))
    return replace(run, commanded=points, temperature=None, reference=())


def five_axes(run):
    b = RotaryAxis("B", -90.0, 90.0, (1.0, 2.0, 3.5), (0.0, 0.6, 0.8))
    c = RotaryAxis("C", 0.0, 360.0, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    on_tool = Target("T1", "tool", (20.0, 30.0, -150.0))
    on_table = Target("T2", "workpiece", (0.0, 100.0, 50.0), seat_sigma_mm=0.002)
    sides = {"workpiece_side": ("C", "X"), "tool_side": ("Y", "Z", "B")}
    own = {"axes": (*run.machine.axes, b, c), "targets": (on_tool, on_table)}
    tracker = replace(run.machine.tracker, stands_on="base", rate_hz=1000.0)
    machine = replace(run.machine, **sides, **own, tracker=tracker)
    path, angles = run.commanded, np.linspace(0.0, 80.0, 4)
    position = np.column_stack([path.position, angles, 2 * angles])
    given = np.full(4, 3000.1), path.dwell_s, ("T1", "T1", "T2", "T2")
    commanded = Path(("X", "Y", "Z", "B", "C"), position, *given)
    return replace(run, machine=machine, commanded=commanded)


@pytest.mark.parametrize("change", [lambda run: run, standstill, five_axes])
def test_reading_what_was_written_gives_the_run_back(run, tmp_path, change):
    wanted = change(run)
    write_bundle(wanted, tmp_path / "out")
    read = read_bundle(tmp_path / "out")
    assert_same(read, wanted)
    assert read.name == read.provenance["source"] == "out"
    assert len(read.provenance["tracker.parquet sha256"]) == 64
    stated = (tmp_path / "out" / "machine.json").read_text()
    assert stated.count("seat_sigma_mm") == (change is five_axes)  # of one target
    file = tmp_path / "upload.zip"
    file.write_bytes(zip_bundle(wanted))
    assert_same(read_bundle(file), wanted)
    assert read_bundle(file).name == "upload"


def zip_members(file, **members):
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file


def test_an_archive_may_hold_the_files_at_its_top(bundle, run, tmp_path):
    members = {one.name: one.read_bytes() for one in bundle.iterdir()}
    members["__MACOSX/._machine.json/x/machine.json"] = b"junk"
    members["notes.txt"] = b"mounted on the left"
    assert_same(read_bundle(zip_members(tmp_path / "flat.zip", **members)), run)


def test_an_odd_run_name_is_a_safe_folder_in_the_archive(run, tmp_path):
    file = tmp_path / "odd.zip"
    file.write_bytes(zip_bundle(replace(run, name="../../etc/ä b")))
    with zipfile.ZipFile(file) as archive:
        folders = {name.rsplit("/", 1)[0] for name in archive.namelist()}
    assert folders == {"-..-etc-ä-b"}
    assert_same(read_bundle(file), run)


def test_a_csv_stream_is_read_like_a_parquet_stream(bundle, run):
    table = pq.read_table(bundle / "tracker.parquet")
    (bundle / "tracker.parquet").unlink()
    pacsv.write_csv(table, bundle / "tracker.csv")
    assert_same(read_bundle(bundle), run)


def test_a_stream_of_single_precision_and_integers_is_read(bundle):
    columns = {"t_s": pa.array([0, 1, 2], pa.int64()), "z_mm": pa.array([0.0] * 3)}
    columns["x_mm"] = pa.array([1.5, 2.5, 3.5], pa.float32())
    columns["y_mm"] = pa.array([1, 2, 3], pa.int32())
    pq.write_table(pa.table(columns), bundle / "tracker.parquet")
    tracker = read_bundle(bundle).tracker
    places = [[1.5, 1, 0], [2.5, 2, 0], [3.5, 3, 0]]
    np.testing.assert_array_equal(tracker.position_mm, places)
    assert (tracker.status == 0).all()


def test_cells_with_blanks_around_numbers_are_read(bundle, run):
    file = bundle / "path.csv"
    header, *rows = file.read_text().splitlines()
    spaced = [header.replace(",", " , "), *(r.replace(",", " ,  ") for r in rows)]
    file.write_text("﻿" + "\r\n".join(spaced) + "\r\n", encoding="utf-8")
    assert_same(read_bundle(bundle), run)


@pytest.mark.parametrize("keep", [np.r_[0:100, 250:400], np.r_[0:1]])
def test_a_pause_in_the_stream_counts_as_lost_samples(bundle, run, keep):
    write_bundle(replace(run, tracker=run.tracker.select(keep)), bundle)
    np.testing.assert_array_equal(read_bundle(bundle).tracker.sequence, keep)


def test_a_frame_that_came_twice_counts_once(bundle, run):
    whole = run.tracker
    twice = np.repeat(np.arange(len(whole)), np.arange(len(whole)) % 7 == 3) + 1
    keep = np.sort(np.concatenate([np.arange(len(whole)), twice]))
    write_bundle(replace(run, tracker=whole.select(keep)), bundle)
    assert_same(read_bundle(bundle), run)


def test_writing_twice_replaces_the_files_and_mixes_no_other_bundle_in(run, bundle):
    write_bundle(replace(run, name="again"), bundle)
    assert_same(read_bundle(bundle), run)
    names = "environment.csv machine.json path.csv reference.csv tracker.parquet"
    assert sorted(p.name for p in bundle.iterdir()) == names.split()
    with pytest.raises(BundleError, match=r"path\.csv: of another bundle"):
        write_bundle(standstill(run), bundle)


def test_a_file_that_cannot_be_written_leaves_no_draft(run, tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole_files.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_bundle(run, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("members", "said"),
    [
        *(([name], "points out of the archive") for name in OUTSIDE),
        (["1.txt", "2.txt", "3.txt", "4.txt"], r"odd\.zip: holds more than 3 files"),
        (["a/machine.json", "b/path.csv"], "spreads a bundle over a, b"),
        (["a/machine.json", "b/machine.json"], r"machine\.json: is in the archive tw"),
    ],
)
def test_an_archive_of_odd_members_is_refused(tmp_path, monkeypatch, members, said):
    monkeypatch.setattr(bundle_file, "MAX_MEMBERS", 3)
    file = zip_members(tmp_path / "odd.zip", **dict.fromkeys(members, "{}"))
    with pytest.raises(BundleError, match=said):
        read_bundle(file)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle_file, "MAX_TEXT_BYTES", 1 << 20)
    members = {"machine.json": b" " * (5 << 20)}
    file = zip_members(tmp_path / "bomb.zip", **members)
    assert file.stat().st_size < 10_000
    with pytest.raises(BundleError, match=r"machine\.json: is larger than 1 MiB"):
        read_bundle(file)
    bundle_file.check_archive(file, 6 << 20)
    with pytest.raises(BundleError, match="unpacks to 5 MiB, more than 2 MiB"):
        bundle_file.check_archive(file, 2 << 20)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive"])
def test_what_is_no_archive_is_refused(tmp_path, content):
    file = tmp_path / "bundle.zip"
    file.write_bytes(content)
    with pytest.raises(BundleError, match="not a zip archive"):
        bundle_file.check_archive(file, 1 << 20)


def damage(data):
    at = data.index(b"PAR1") + 500
    data[at : at + 10] = bytes(10)


def encrypt(data):
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + flags] |= 1


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: data.__delitem__(slice(-100, None)), r"odd\.zip: is truncated"),
        (damage, r"tracker\.parquet: is damaged in the arch"),
        (encrypt, "without a password"),
    ],
)
def test_an_archive_that_cannot_be_unpacked_is_refused(run, tmp_path, spoil, said):
    file, data = tmp_path / "odd.zip", bytearray(zip_bundle(run))
    spoil(data)
    file.write_bytes(data)
    with pytest.raises(BundleError, match=said):
        read_bundle(file)
    with pytest.raises(BundleError, match=r"nowhere: no such folder or file"):
        read_bundle(tmp_path / "nowhere")


@pytest.mark.parametrize("odd", [np.nan, np.inf, -1e300])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_sample_that_is_nowhere_is_lost_whatever_its_status(bundle, kind, odd):
    file = bundle / "tracker.parquet"
    table = pq.read_table(file)
    x_mm = table["x_mm"].to_numpy().copy()
    x_mm[100:103] = odd
    table = table.set_column(table.column_names.index("x_mm"), "x_mm", pa.array(x_mm))
    if kind == "csv":
        file.unlink()
        pacsv.write_csv(table, bundle / "tracker.csv")
    else:
        pq.write_table(table, file)
    samples = read_bundle(bundle).tracker
    assert (samples.status[100:103] != 0).all()
    assert (samples.status == 0).sum() == (table["status"].to_numpy() == 0).sum() - 3
