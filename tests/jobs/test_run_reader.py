"""Whatever a bundle holds, reading it ends within limits and names file and remedy."""

from __future__ import annotations

import io
import json
import os
import signal
import threading
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scripted_cell import wait_until

from truepath.catalogue.run_reader import ReadingLimits, RunReader
from truepath.errors import BundleError
from truepath_simulators.scenario import load_machine

LARGEST_BYTES = 1 << 30
HEADER = b"t_s,x_mm,y_mm,z_mm\n"
PATH = b"x_mm,y_mm,z_mm,feed_mm_min,dwell_s\n10,10,10,1000,1\n400,300,200,1000,1\n"
COLUMNS = ("t_s", "x_mm", "y_mm", "z_mm")

pytestmark = pytest.mark.fault_row(36)


def pack(folder, **members):
    content = {
        "machine.json": json.dumps(load_machine("demo")).encode(),
        "path.csv": PATH,
        **{name.replace("_", "."): data for name, data in members.items()},
    }
    file = folder / "bundle.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return file


def pack_good(folder):
    rows = b"".join(b"%.3f,%d,0,0\n" % (n / 500, n) for n in range(100))
    return pack(folder, tracker_csv=HEADER + rows)


def encode(columns):
    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink, compression="zstd")
    return sink.getvalue()


def make_steady_parquet():
    steady = np.zeros(12_000_000)
    rising = {"t_s": np.arange(len(steady)) / 500}
    return {"tracker_parquet": encode(dict.fromkeys(COLUMNS, steady) | rising)}


def make_zeros():
    return {"tracker_parquet": encode(dict.fromkeys(COLUMNS, np.zeros(3_000_000)))}


def make_texts():
    texts = pa.array(["0" * 100_000] * 1000)
    return {"tracker_parquet": encode(dict.fromkeys(COLUMNS, texts))}


HOSTILE = {
    "many rows in a small parquet": (make_zeros, "tracker.parquet", "packs so well"),
    "long texts in a parquet": (make_texts, "tracker.parquet", "long texts"),
    "rows beyond the memory": (
        make_steady_parquet,
        "tracker.parquet",
        "cannot be read within 256 MiB of memory; send less, or raise upload_memory_mb",
    ),
    "60 MB in one line": (
        lambda: {"tracker_csv": HEADER + b"1" * 60_000_000},
        "tracker.csv, row 2",
        "is longer than 64 KiB; end every row with a line break",
    ),
    "a 60 MB header": (
        lambda: {"tracker_csv": HEADER[:-1] + b"," * 60_000_000},
        "tracker.csv, row 1",
        "is longer than 64 KiB",
    ),
    "too many columns": (
        lambda: {"tracker_csv": b",".join(b"c%d" % n for n in range(501)) + b"\n"},
        "tracker.csv, row 1",
        "has 501 columns, more than 500",
    ),
    "a carriage return in the header": (
        lambda: {"tracker_csv": b"a\rb,c\n"},
        "tracker.csv, row 1",
        "cannot be read as CSV",
    ),
    "a zip bomb": (
        lambda: {"tracker_csv": bytes(400 << 20)},
        "tracker.csv",
        "cannot be read within 256 MiB of memory",
    ),
    "deep JSON": (
        lambda: {"machine_json": b"[" * 10_000_000},
        "machine.json",
        "nested too deeply",
    ),
    "JSON as deep as can be read": (
        lambda: {"machine_json": b'{"a":' * 980 + b'"\\u0041"' + b"}" * 980},
        "machine.json",
        "",
    ),
    "wide JSON": (
        lambda: {"machine_json": b"[" + b'{"a":{}},' * 2_000_000 + b"{}]"},
        "machine.json",
        "cannot be read within 256 MiB of memory",
    ),
    "a huge integer": (
        lambda: {"machine_json": b'{"schema": %s}' % (b"9" * 4000)},
        "machine.json",
        "",
    ),
    "an integer of too many digits": (
        lambda: {"machine_json": b'{"schema": %s}' % (b"9" * 5000)},
        "machine.json",
        "too many digits",
    ),
    "a lone surrogate": (
        lambda: {"machine_json": b'{"name": "\\ud800"}'},
        "machine.json",
        "no character",
    ),
    "a path of very many rows": (
        lambda: {"path_csv": PATH + b"10,10,10,1000,1\n" * 100_000, "tracker_csv": b""},
        "path.csv",
        "more than 100000",
    ),
}


@pytest.fixture(scope="module")
def small_reader():
    reader = RunReader(ReadingLimits(memory_mb=256, patience_s=30.0))
    yield reader
    reader.close()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_bundle_is_refused_by_file_and_remedy(small_reader, name, tmp_path):
    make, file, text = HOSTILE[name]
    with pytest.raises(BundleError) as caught:
        small_reader.read_facts(pack(tmp_path, **make()), LARGEST_BYTES)
    refused = str(caught.value)
    beyond = f"{file.partition(',')[0]}: cannot be read within 256 MiB of memory"
    large = "60 MB" in name and refused.startswith(beyond)  # whichever is met first
    assert large or (refused.startswith(file) and text in refused)
    good = small_reader.read_facts(pack_good(tmp_path), LARGEST_BYTES)
    assert (good.samples, good.machine) == (100, load_machine("demo")["name"])


@pytest.mark.parametrize(
    ("number", "patience_s", "text"),
    [
        (signal.SIGKILL, 30.0, "bundle: cannot be read within 2048 MiB of memory"),
        (signal.SIGSTOP, 0.2, "bundle: cannot be read within 0.2 s"),
    ],
)
def test_a_reader_that_dies_or_hangs_is_replaced(number, patience_s, text, tmp_path):
    reader = RunReader(ReadingLimits(patience_s=patience_s))
    try:
        with reader._turn:
            process = reader._process = reader._start()
        process.call(int)  # it is up
        os.kill(process._process.process_id, number)
        with pytest.raises(BundleError, match=text):
            reader.read_facts(pack_good(tmp_path), LARGEST_BYTES)
        reader._limits = ReadingLimits()
        assert reader.read_facts(pack_good(tmp_path), LARGEST_BYTES).samples == 100
    finally:
        reader.close()


def test_to_close_ends_what_is_being_read(tmp_path):
    reader, refused = RunReader(), []

    def read():
        try:
            reader.read_facts(pack_good(tmp_path), LARGEST_BYTES)
        except BundleError as error:
            refused.append(error)

    with reader._turn:
        process = reader._process = reader._start()
    process.call(int)
    os.kill(process._process.process_id, signal.SIGSTOP)
    thread = threading.Thread(target=read)
    thread.start()
    wait_until(lambda: process._is_busy)
    reader.close()
    thread.join(10)
    assert refused
    assert reader._process is None
