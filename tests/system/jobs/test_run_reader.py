"""Whatever a bundle holds, reading it ends within limits and names file and remedy."""

import io
import json
import os
import signal
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from scripted_cell import wait_until
from truepath.catalogue.run_reader import ReadingLimits, RunReader
from truepath.errors import BundleError
from truepath_simulators.machine_file import load_machine

LARGEST_BYTES = 1 << 30
HEADER = b"t_s,x_mm,y_mm,z_mm\n"
PATH = b"x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n10,10,10,1000,1\n400,300,200,1000,1\n"
COLUMNS = ("t_s", "x_mm", "y_mm", "z_mm")
pytestmark = pytest.mark.fault_row(36)


def pack(folder, member, content):
    members = {
        "machine.json": json.dumps(load_machine("demo")).encode(),
        "path.csv": PATH,
        **({} if "tracker" in member else {"tracker.csv": HEADER}),
        member: content,
    }
    file = folder / "bundle.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file


def pack_good(folder):
    rows = b"".join(b"%.3f,%d,0,0\n" % (n / 500, n) for n in range(100))
    return pack(folder, "tracker.csv", HEADER + rows)


def encode(column, **others):
    sink = io.BytesIO()
    table = pa.table(dict.fromkeys(COLUMNS, column) | others)
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


BEYOND = "cannot be read within 64 MiB of memory"
PARQUET, CSV, MACHINE = "tracker.parquet", "tracker.csv", "machine.json"
MANY = np.zeros(3_000_000)
DEEP = b'{"a":' * 980 + b'"\\u0041"' + b"}" * 980  # as can just be read
WIDE = b",".join(b"c%d" % n for n in range(501)) + b"\n"
LINE, RAISE = "is longer than 64 KiB", f"{BEYOND}; send less, or raise upload_memory_mb"
HOSTILE = [
    (lambda: encode(np.zeros(2_200_000)), PARQUET, "packs so well"),
    (lambda: encode(pa.array(["0" * 100_000] * 700)), PARQUET, "long texts"),
    (lambda: encode(MANY, t_s=np.arange(3_000_000) / 500), PARQUET, RAISE),
    (lambda: HEADER + b"1" * 6_000_000, f"{CSV}, row 2", f"{LINE}; end every row with"),
    (lambda: HEADER[:-1] + b"," * 6_000_000, f"{CSV}, row 1", LINE),
    (lambda: WIDE, f"{CSV}, row 1", "has 501 columns, more than 500"),
    (lambda: b"a\rb,c\n", f"{CSV}, row 1", "cannot be read as CSV"),
    (lambda: bytes(100 << 20), CSV, BEYOND),
    (lambda: b"[" * 2_000_000, MACHINE, "nested too deeply"),
    (lambda: DEEP, MACHINE, ""),
    (lambda: b"[" + b'{"a":{}},' * 500_000 + b"{}]", MACHINE, BEYOND),
    (lambda: b'{"schema": %s}' % (b"9" * 4000), MACHINE, ""),
    (lambda: b'{"schema": %s}' % (b"9" * 5000), MACHINE, "too many digits"),
    (lambda: b'{"name": "\\ud800"}', MACHINE, "no character"),
    (lambda: PATH + b"10,10,10,1000,1\n" * 100_000, "path.csv", "more than 100000"),
]


@pytest.fixture(scope="module")
def small_reader():
    reader = RunReader(ReadingLimits(memory_mb=64, patience_s=30.0))
    yield reader
    reader.close()


@pytest.mark.parametrize(("make", "place", "text"), HOSTILE)
def test_a_hostile_bundle_is_refused_by_file(small_reader, make, place, text, tmp_path):
    member = place.partition(",")[0]
    with pytest.raises(BundleError) as caught:
        small_reader.read_facts(pack(tmp_path, member, make()), LARGEST_BYTES)
    assert str(caught.value).startswith(place)
    assert text in str(caught.value)
    good = small_reader.read_facts(pack_good(tmp_path), LARGEST_BYTES)
    assert (good.samples, good.machine) == (100, load_machine("demo")["name"])


@pytest.fixture
def signal_reader(small_reader, tmp_path):
    good = pack_good(tmp_path)

    def send(number):
        small_reader.read_facts(good, LARGEST_BYTES)
        process = small_reader._process
        os.kill(process._process.process_id, number)
        return process, good

    return send


@pytest.mark.parametrize(
    ("number", "patience_s", "text"),
    [
        (signal.SIGKILL, 30.0, BEYOND),
        (signal.SIGSTOP, 0.2, "cannot be read within 0.2"),
    ],
)
def test_a_reader_that_dies_or_hangs_is_replaced(
    small_reader, signal_reader, number, patience_s, text, monkeypatch
):
    _, good = signal_reader(number)
    limits = ReadingLimits(memory_mb=64, patience_s=patience_s)
    with monkeypatch.context() as patient:
        patient.setattr(small_reader, "_limits", limits)
        with pytest.raises(BundleError, match=f"bundle: {text}"):
            small_reader.read_facts(good, LARGEST_BYTES)
    assert small_reader.read_facts(good, LARGEST_BYTES).samples == 100


def test_to_close_ends_what_is_being_read(small_reader, signal_reader):
    process, good = signal_reader(signal.SIGSTOP)
    with ThreadPoolExecutor() as pool:
        read = pool.submit(small_reader.read_facts, good, LARGEST_BYTES)
        wait_until(lambda: process._is_busy)
        small_reader.close()
        assert isinstance(read.exception(10), BundleError)
    assert small_reader._process is None
