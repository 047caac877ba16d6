"""Runs whose writer was killed at full speed: whole up to the last batch, settled."""

import os
import pickle
import shutil
import signal
import sqlite3
import subprocess
import sys

import numpy as np
import pytest

from paths_by_hand import path_of
from truepath.measurement.run_file import run_file, run_loader
from truepath.measurement.run_file.run_loader import open_run

WRITER = """
import pickle, sys
import numpy as np
from truepath.measurement.run_file.recorder import Recorder
from truepath_drivers.interfaces.records import TrackerSamples
file, header = pickle.loads(bytes.fromhex(sys.argv[1]))
tell = lambda samples: print(samples.sequence[-1], flush=True)
recorder = Recorder(file, header, on_recorded=tell, reserve_bytes=0)
first = 0
while True:
    s = np.arange(first, first + 50)
    first += 50
    recorder.put_tracker(
        TrackerSamples(s, s * 0.002, np.ones((50, 3)) * s[:, None], 0 * s), b"x" * 99)
"""


@pytest.fixture(scope="module")
def left(mill, tmp_path_factory):
    """What a writer leaves that was killed, and the last counter that it told."""
    file = tmp_path_factory.mktemp("killed") / "monday.sqlite"
    path = path_of((10.0, 10.0, -10.0), (110.0, 10.0, -10.0))
    header = run_file.RunHeader("monday", mill, path, 500.0, {}, mill.axis_names)
    given = pickle.dumps((file, header)).hex()
    command = [sys.executable, "-c", WRITER, given]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        for _ in range(30):
            last = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
        for line in writer.stdout:
            last = int(line) if line.endswith(b"\n") else last
    return file, last


@pytest.fixture
def killed(left, tmp_path):
    file, last = left
    return shutil.copytree(file.parent, tmp_path / "runs") / file.name, last


def test_nothing_committed_is_lost_when_the_writer_is_killed(killed):
    file, last = killed
    log = file.with_name(file.name + "-wal")
    assert log.exists()
    run = open_run(file)
    assert run.tracker.sequence[-1] >= last
    assert (np.diff(run.tracker.sequence) == 1).all()
    np.testing.assert_array_equal(run.tracker.position_mm[:, 0], run.tracker.sequence)
    assert run.provenance["outcome"] == "torn"
    assert log.exists()
    closed = run_loader.repair_run(file)  # it is settled into one file
    assert closed.samples > last
    assert (closed.lost_samples, closed.failure) == (0, "")
    assert [p.name for p in file.parent.iterdir()] == [file.name]
    assert run_loader.repair_run(file) == closed
    assert len(open_run(file).tracker) == closed.samples


@pytest.mark.fault_row(26)
def test_a_log_cut_anywhere_gives_the_batches_before_the_cut(killed):
    file, _ = killed
    whole = open_run(file).tracker
    log = file.with_name(file.name + "-wal")
    size = log.stat().st_size
    for share in (0.99, 0.7, 0.3, 0.0):
        os.truncate(log, int(share * size))
        part = open_run(file).tracker
        assert len(part) <= len(whole)
        kept = whole.select(slice(len(part)))
        for name in ("sequence", "device_time_s", "position_mm", "status"):
            np.testing.assert_array_equal(getattr(part, name), getattr(kept, name))


def test_a_killed_run_that_is_damaged_as_well_is_kept_as_torn(killed):
    file, _ = killed
    with sqlite3.connect(file) as database:
        database.execute("UPDATE batch SET crc32 = 0 WHERE seq0 = 100")
    run_loader.repair_run(file)
    database.close()
    assert len(open_run(file).tracker) > 100
    assert file.with_name(file.name + ".torn").exists()
