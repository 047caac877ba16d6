"""Runs on disk: written batch by batch, closed, killed, damaged, full disks."""

import os
import sqlite3
import threading
from dataclasses import replace

import numpy as np
import pytest

from processes import until
from truepath.errors import BundleError, MeasurementFailed
from truepath.files.bundle.run import summarize_run
from truepath.measurement.run_file import recorder as recorder_module
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader, hash_file
from truepath.measurement.run_file.run_loader import open_run, repair_run
from truepath.motion.configurations import Configurations
from truepath.plugins import PluginOrigin
from truepath_drivers.interfaces.records import AxisSamples, Identity, TrackerSamples

PLUGINS = {"tracker": PluginOrigin("t", "ours", "1.2", 1)}
TRACKER, MOTION = Identity("Us", "T", "1", "0.1"), Identity("Us", "C", "2", "0.2")
DEVICES = {"tracker": TRACKER, "motion": MOTION}


@pytest.fixture
def header(mill, square):
    axes = ("X", "Y", "Z")
    return RunHeader("monday", mill, square, 500.0, DEVICES, axes, plugins=PLUGINS)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "runs" / "monday.sqlite"


@pytest.fixture
def recorder(file, header):
    made = Recorder(file, header, reserve_bytes=0)
    yield made
    made.close("aborted")


def block(first, count=50):
    sequence = np.arange(first, first + count, dtype=np.int64)
    place_mm = np.random.default_rng(first).normal(0, 100, (count, 3))
    status = (sequence % 7 == 0).astype(np.int64)
    return TrackerSamples(sequence, 1000.0 + sequence * 0.002, place_mm, status)


def fill(recorder, blocks=20):
    made = [block(1000 + 50 * i) for i in range(blocks)]
    for i, one in enumerate(made):
        recorder.put_tracker(one, b"%03d" % i * 20)
    return TrackerSamples.join(made)


def test_one_signed_file_gives_back_everything(recorder, file, header, read_link_bytes):
    written = fill(recorder)
    recorder.put_tracker(TrackerSamples.empty(), b"noise")
    rows = np.array([[0.1, 1, 2, 3], [0.2, 4, 5, 6]])
    recorder.put_axes(AxisSamples(("X", "Y", "Z"), rows[:, 0], rows[:, 1:]))
    recorder.put_axes(AxisSamples(("X", "Y", "Z"), rows[:1, 0] + 1, rows[:1, 1:]))
    recorder.event("start", "cycle start")
    closed = recorder.close("finished")
    assert [p.name for p in file.parent.iterdir()] == ["monday.sqlite"]
    assert (file.stat().st_mode & 0o777, closed.sha256) == (0o444, hash_file(file))
    assert (closed.samples, closed.lost_samples, closed.failure) == (1000, 0, "")
    run = open_run(file)
    for name in ("sequence", "device_time_s", "position_mm", "status"):
        kept, put = getattr(run.tracker, name), getattr(written, name)
        np.testing.assert_array_equal(kept, put)
    link = b"".join(b"%03d" % i * 20 for i in range(20))
    assert (read_link_bytes(file), run.name) == (link + b"noise", "monday")
    assert run.machine == header.machine
    np.testing.assert_array_equal(run.commanded.position, header.commanded.position)
    np.testing.assert_array_equal(run.commanded.dwell_s, header.commanded.dwell_s)
    np.testing.assert_array_equal(run.axis_samples.host_time_s, [0.1, 0.2, 1.1])
    np.testing.assert_array_equal(run.axis_samples.position_mm[1], [4, 5, 6])
    assert [(e.kind, e.text) for e in run.events] == [("start", "cycle start")]
    assert run.provenance["outcome"] == "finished"
    assert run.provenance["motion"] == "Us C 2 0.2"
    assert run.provenance["tracker_plugin"] == "t of ours 1.2, interface 1"
    assert run.tracker.quality is None, "it was never told"
    assert summarize_run(run).quality is None


def test_the_quality_of_samples_is_kept_where_the_tracker_tells_it(recorder, file):
    told = np.linspace(0.5, 1.0, 50).astype(np.float32)
    recorder.put_tracker(block(1))
    recorder.put_tracker(replace(block(51), quality=told))
    recorder.close("finished")
    run = open_run(file)
    np.testing.assert_array_equal(run.tracker.quality, [*[np.nan] * 50, *told])
    quality = summarize_run(run).quality
    valid = told[block(51).status == 0]
    assert quality is not None
    assert quality.mean == pytest.approx(valid.mean(), rel=1e-6)
    assert quality.told == pytest.approx(0.5, abs=0.02)
    assert valid.min() <= quality.low < 0.55


def test_points_are_read_back(file, header, square):
    names = ("a", "b", "a", "b")
    points = Configurations(square.axes, square.position, square.dwell_s, names)
    Recorder(file, replace(header, commanded=points), reserve_bytes=0).close("failed")
    run = open_run(file)
    assert (run.mode, run.commanded.target) == ("standstill", names)
    assert (len(run.tracker), run.axis_samples) == (0, None)


def test_a_hole_in_the_counter_is_named_and_one_that_goes_back_refused(recorder, file):
    recorder.put_tracker(block(0))
    recorder.put_tracker(block(60))
    for first in (60, 109, 0):
        with pytest.raises(MeasurementFailed, match="counter went back"):
            recorder.put_tracker(block(first))
    assert recorder.close("finished").lost_samples == 10
    gaps = [e.text for e in open_run(file).events if e.kind == "gap"]
    assert gaps == ["gap: 10 samples after sequence 49"]


def test_nothing_sees_a_block_before_it_is_on_disk(file, header):
    seen = []

    def look(samples):
        with sqlite3.connect(file) as database:
            rows = database.execute("SELECT sum(n) FROM batch").fetchone()
        database.close()
        seen.append((len(samples), rows[0]))

    recorder = Recorder(file, header, on_recorded=look, reserve_bytes=0)
    for i in range(3):
        recorder.put_tracker(block(50 * i))
    recorder.close("finished")
    assert [n for n, _ in seen] == [50, 50, 50]
    assert all(on_disk >= 50 * (i + 1) for i, (_, on_disk) in enumerate(seen))


def test_a_display_that_fails_stops_no_recording(file, header, caplog, monkeypatch):
    def fail(samples):
        raise ValueError("no screen")

    monkeypatch.setattr(recorder_module, "QUEUE_ITEMS", 3)
    recorder = Recorder(file, header, on_recorded=fail, reserve_bytes=0)
    for i in range(20):
        recorder.put_tracker(block(50 * i))
    closed = recorder.close("finished")
    assert closed.failure == ""
    assert closed.samples == len(open_run(file).tracker) == 1000
    (record,) = caplog.records
    assert record.getMessage() == "recorded samples cannot be shown; recording goes on"


def test_a_run_that_cannot_begin_says_why_and_a_disk_that_fills_up_is_noticed(
    recorder, file, header, tmp_path, monkeypatch
):
    with pytest.raises(MeasurementFailed, match="exists; give the Run another name"):
        Recorder(file, header, reserve_bytes=0)
    (tmp_path / "text").write_text("not a folder")
    with pytest.raises(MeasurementFailed, match="cannot be written"):
        Recorder(tmp_path / "text" / "a.sqlite", header, reserve_bytes=0)
    other = file.with_name("tuesday.sqlite")
    monkeypatch.setattr(recorder_module, "SPACE_CHECK_S", 0.0)
    free = [10 << 20]
    monkeypatch.setattr(Recorder, "_free_bytes", lambda _: free[0])
    with pytest.raises(MeasurementFailed, match="less than 500 MiB are free"):
        Recorder(other, header)
    free[0] = 1 << 40
    recorder = Recorder(other, header)
    recorder.put_tracker(block(0))
    free[0] = 1 << 20
    recorder.put_tracker(block(50))
    until(lambda: recorder.is_space_low)
    assert recorder.close("failed").failure == ""


@pytest.mark.fault_row(27)
def test_a_full_disk_loses_nothing_committed(file, header, monkeypatch, measured):
    recorder = Recorder(file, header, reserve_bytes=0)
    written = fill(recorder, 4)
    recorder._queue.put(recorder_module._Item())
    until(recorder._queue.empty)
    recorder._database.execute("PRAGMA max_page_count = 1")
    recorder.put_tracker(block(5000, 5000))
    until(lambda: "full" in recorder.failure)
    assert "check disk space" in recorder.failure
    with pytest.raises(MeasurementFailed):
        recorder.event("late", "too late")
    assert "full" in recorder.close("failed").failure
    recorded = open_run(file).tracker
    assert len(recorded) >= 200
    measured(f"{len(recorded)} samples, all that were committed")
    np.testing.assert_array_equal(recorded.sequence[:200], written.sequence)


@pytest.mark.fault_row(28)
def test_a_disk_too_slow_is_an_error_once_the_queue_is_full(file, header, monkeypatch):
    monkeypatch.setattr(recorder_module, "PUT_TIMEOUT_S", 0.05)
    monkeypatch.setattr(recorder_module, "QUEUE_ITEMS", 4)
    recorder = Recorder(file, header, reserve_bytes=0)
    go_on, commit = threading.Event(), recorder._commit

    def stuck(item):
        go_on.wait(10.0)
        commit(item)

    monkeypatch.setattr(recorder, "_commit", stuck)
    recorder.put_tracker(block(0))
    until(recorder._queue.empty)
    for i in range(1, 5):
        recorder.put_tracker(block(50 * i))
    with pytest.raises(MeasurementFailed, match="too slow: 4 batches wait"):
        recorder.put_tracker(block(250))
    assert recorder.is_strained
    go_on.set()
    assert "too slow" in recorder.close("failed").failure
    assert len(open_run(file).tracker) >= 50


def test_a_disk_that_hangs_does_not_hang_the_end(file, header, monkeypatch):
    monkeypatch.setattr(recorder_module, "CLOSE_TIMEOUT_S", 0.1)
    recorder = Recorder(file, header, reserve_bytes=0)
    go_on = threading.Event()
    monkeypatch.setattr(recorder, "_commit", lambda _item: go_on.wait(10.0))
    recorder.put_tracker(block(0))
    assert "does not answer" in recorder.close("failed").failure
    go_on.set()
    recorder._writer.join(5.0)
    recorder._database.close()


def test_a_run_that_somebody_reads_cannot_be_sealed(recorder, file):
    fill(recorder, 2)
    reader = sqlite3.connect(file)
    reader.execute("BEGIN")
    reader.execute("SELECT count(*) FROM batch").fetchone()
    recorder._database.execute("PRAGMA busy_timeout = 10")
    closed = recorder.close("finished")
    reader.close()
    assert closed.sha256 == ""
    assert "open elsewhere" in closed.failure or "locked" in closed.failure
    assert len(open_run(file).tracker) == 100
    assert repair_run(file).sha256


@pytest.fixture
def closed_file(recorder, file):
    fill(recorder, 40)
    recorder.event("start", "cycle start")
    recorder.close("finished")
    file.chmod(0o644)
    return file


def damage(file, needle, offset=0):
    data = bytearray(file.read_bytes())
    at = data.index(needle) + offset
    data[at] ^= 0x40
    file.write_bytes(data)


@pytest.mark.fault_row(26)
def test_a_flipped_bit_costs_one_batch_is_named_and_the_run_salvaged(closed_file):
    lost = block(1000 + 50 * 7)
    damage(closed_file, lost.position_mm[10].tobytes())
    run = open_run(closed_file)
    assert len(run.tracker) == 39 * 50
    assert not np.isin(lost.sequence, run.tracker.sequence).any()
    texts = {e.kind: e.text for e in run.events}
    assert texts["bad-batch"] == "batch of tracker at 1350: its CRC does not match"
    assert texts["gap"] == "gap: 50 samples after sequence 1349"
    before = closed_file.read_bytes()
    closed = repair_run(closed_file)
    assert "CRC does not match" in closed.failure
    assert (closed.samples, closed.lost_samples) == (39 * 50, 50)
    torn = closed_file.with_name("monday.sqlite.torn")
    assert (torn.read_bytes(), closed.sha256) == (before, hash_file(closed_file))
    run = open_run(closed_file)
    assert len(run.tracker) == 39 * 50
    assert [e.kind for e in run.events] == ["start", "gap"]
    assert run.provenance["outcome"] == "finished"


@pytest.mark.fault_row(26)
def test_no_flipped_bit_ever_gives_a_wrong_sample(closed_file, rng, measured):
    good = open_run(closed_file)
    whole = {int(s): i for i, s in enumerate(good.tracker.sequence)}
    data = closed_file.read_bytes()
    refused = 0
    for at in rng.integers(100, len(data), 40):
        broken = bytearray(data)
        broken[at] ^= 1 << int(rng.integers(8))
        closed_file.write_bytes(broken)
        try:
            run = open_run(closed_file)
        except BundleError:
            refused += 1
            continue
        kept = [whole[int(s)] for s in run.tracker.sequence]
        written = good.tracker.position_mm[kept]
        np.testing.assert_array_equal(run.tracker.position_mm, written)
        np.testing.assert_array_equal(run.commanded.position, good.commanded.position)
    measured(f"40 flipped bits: {refused} files refused, 0 wrong samples")


@pytest.mark.fault_row(26)
def test_lost_pages_leave_the_rest_readable(closed_file):
    data = bytearray(closed_file.read_bytes())
    page = 4096
    for number in (12, 13, 25):
        data[number * page : (number + 1) * page] = os.urandom(page)
    closed_file.write_bytes(data)
    run = open_run(closed_file)
    assert 50 * 20 < len(run.tracker) < 50 * 40
    assert any(e.kind == "bad-batch" for e in run.events)


def test_a_damaged_manifest_is_an_error_and_a_damaged_event_is_left_out(closed_file):
    damage(closed_file, b'{"text": "cycle start"}')
    assert [e.kind for e in open_run(closed_file).events] == ["bad-batch"]
    damage(closed_file, b"410.0" if b"410.0" in closed_file.read_bytes() else b"110.0")
    with pytest.raises(BundleError, match="manifest is damaged"):
        open_run(closed_file)


def test_a_later_schema_is_refused(file, header, monkeypatch):
    monkeypatch.setattr("truepath.measurement.run_file.run_file.SCHEMA", "run/2")
    Recorder(file, header, reserve_bytes=0).close("finished")
    monkeypatch.undo()
    with pytest.raises(BundleError, match="schema is 'run/2', not 'run/1'"):
        open_run(file)


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\0", b"nothing of the kind"])
def test_another_file_or_none_is_not_a_run(tmp_path, content):
    with pytest.raises(BundleError, match="no such Run"):
        open_run(tmp_path / "other.sqlite")
    other = tmp_path / "other.sqlite"
    other.write_bytes(content)
    with pytest.raises(BundleError, match=r"other\.sqlite: is not a Run file"):
        open_run(other)
