"""Small files: covariances, identities, known lengths; written whole or not at all."""

import base64
import json
import os
import threading
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from truepath.documents import whole_files
from truepath.documents.whole_files import read_whole, replace_file
from truepath.errors import BadInput, BundleError
from truepath.files.bundle import identity_file
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.recorded_files import (
    add_known_lengths,
    decode_known_lengths,
    encode_known_lengths,
)
from truepath.files.earlier.model_file import pack_symmetric, unpack_symmetric
from truepath.files.environment import Refraction
from truepath.measurement.run_file.run_loader import name_known_lengths
from truepath_drivers.interfaces.tracker_records import Light


@pytest.mark.parametrize("size", [0, 1, 2, 37])
def test_what_was_packed_comes_back_bit_for_bit(rng, size):
    scale = 10.0 ** rng.integers(-200, 200, (size, size))
    square = rng.standard_normal((size, size)) * scale
    symmetric = np.tril(square) + np.tril(square, -1).T
    assert (unpack_symmetric(pack_symmetric(symmetric), size) == symmetric).all()


def packed(*numbers):
    data = np.array(numbers, "<f8").tobytes()
    return base64.b64encode(zlib.compress(data)).decode()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("not base64!", "cannot be unpacked"),
        ("émile", "cannot be unpacked"),
        (base64.b64encode(b"no zlib").decode(), "cannot be unpacked"),
        (packed(1.0, 2.0), "size 2"),
        (packed(1.0, 2.0, 3.0, 4.0), "size 2"),
        (packed(1.0, np.nan, 3.0), "not finite"),
        (packed(1.0, 2.0, np.inf), "not finite"),
    ],
)
def test_a_damaged_text_is_refused(text, problem):
    with pytest.raises(ValueError, match=problem):
        unpack_symmetric(text, 2)


def test_a_text_that_unpacks_without_end_costs_no_memory():
    bomb = base64.b64encode(zlib.compress(bytes(50_000_000), 9)).decode()
    with pytest.raises(ValueError, match="size 2"):
        unpack_symmetric(bomb, 2)


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ({"schema": "identity/2"}, "schema"),
        ({"opertor": "A"}, '"opertor" is no field'),
        ({"operator": 3}, "operator is 3"),
        ({"operator": "A\nB"}, "one line"),
        ([], "is no object"),
    ],
)
def test_a_wrong_identity_is_refused_by_its_key(tmp_path, content, place):
    file = tmp_path / "identity.json"
    file.write_text(json.dumps(content))
    with pytest.raises(BundleError, match=place):
        identity_file.read_identity(file)


def test_earlier_names_are_read_on_and_what_is_of_no_use_is_named(tmp_path):
    stated = identity_file.read_assignments(["machine_serial=1", "tracker_serial=2"])
    assert stated == {"serial_number": "1", "tracker_serial_number": "2"}
    (tmp_path / "identities.json").write_text("{}")
    with pytest.raises(BundleError, match="holds no machines"):
        identity_file.read_stored_identities(tmp_path / "identities.json")
    assert identity_file.read_stored_identities(tmp_path / "none.json") == {}
    with pytest.raises(BadInput, match="FIELD=TEXT"):
        identity_file.read_assignments(["operator"])


HEADER = "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,length_mm,u_mm"
ROW = "1000,0,0,3000.02,0,0,2000.01,0.001"
WARM = ",temperature_degC,expansion_um_per_m_K"


def decode(row=ROW, more=""):
    return decode_known_lengths(f"{HEADER}{more}\n{row}\n".encode())


def test_the_ends_of_a_length_say_what_the_tracker_made_of_it():
    (one,) = decode()
    assert one.measured_mm == pytest.approx(2000.02)
    assert (one.length_mm, one.sigma_mm) == (2000.01, 0.001)
    (stated,) = decode(f"{ROW},2000.015", ",measured_mm")
    assert stated.measured_mm == 2000.015
    assert decode_known_lengths(encode_known_lengths((one, stated))) == (one, stated)


def test_a_bar_is_as_long_as_it_is_warm_and_read_again_as_it_was_written():
    (one,) = decode(f"{ROW},22.0,11.5", WARM)
    assert one.length_mm == pytest.approx(2000.01 * (1.0 + 2.0 * 11.5e-6))
    assert one.sigma_mm == pytest.approx(np.hypot(0.001, 2000.01 * 0.5 * 11.5e-6))
    cold = decode("1000,0,0,1099.998,0,0,100,0.001,18,11.5", WARM)
    assert decode_known_lengths(encode_known_lengths(cold)) == cold


@pytest.mark.parametrize(
    ("row", "more", "column"),
    [
        ("1000,0,0,3000.02,0,,2000.01,0.001", "", "z2_mm"),
        ("1000,0,0,3000.02,0,0,2.00001,0.001", "", "length_mm"),
        ("1000,0,0,3000.02,0,0,2000.01,0", "", "u_mm"),
        ("1000,0,0,3005.02,0,0,2000.01,0.001", "", "x1_mm"),
        ("0,0,0,2000.02,0,0,2000.01,0.001", "", "x1_mm"),
        (f"{ROW},2009", ",measured_mm", "measured_mm"),
        (f"{ROW},295", ",temperature_degC", "expansion_um_per_m_K"),
        (f"{ROW},295,11.5", WARM, "temperature_degC"),
        (f"{ROW},22,1150", WARM, "expansion"),
        ("\n".join([ROW] * 1001), "", "1001 rows"),
    ],
)
def test_a_row_that_cannot_be_is_one_error_with_its_place_and_remedy(row, more, column):
    with pytest.raises(BundleError, match=column) as refused:
        decode(row, more)
    assert refused.value.remedy
    if refused.value.row is not None:
        assert "known_lengths.csv, row 2" in str(refused.value)


def test_known_lengths_stay_with_a_bundle_and_belong_to_its_digest(run, tmp_path):
    told = add_known_lengths(run, decode())
    write_bundle(told, tmp_path / "bundle")
    assert read_bundle(tmp_path / "bundle").known_lengths == told.known_lengths
    assert told.known_lengths == decode()


def test_a_length_is_corrected_for_the_air_as_the_samples_are(run):
    done = Refraction("truepath", Light(633.0, is_group=False), 1.00027)
    (one,) = add_known_lengths(replace(run, refraction=done), decode()).known_lengths
    assert one.measured_mm == pytest.approx(2000.02 / 1.00027)
    assert one.ends_mm[0][0] == pytest.approx(1000.0 / 1.00027)


def test_lengths_beside_a_bundle_have_its_whole_name(tmp_path, monkeypatch):
    (tmp_path / "2026.11.29").mkdir()
    named = name_known_lengths(tmp_path / "2026.11.29")
    assert named.name == "2026.11.29.known_lengths.csv"
    assert name_known_lengths(tmp_path / "mill.zip").name == "mill.known_lengths.csv"
    monkeypatch.chdir(tmp_path / "2026.11.29")
    assert name_known_lengths(Path()) == named


def test_what_was_written_is_read_unless_it_is_larger_than_it_may_be(tmp_path):
    file = tmp_path / "a.json"
    replace_file(file, b"old")
    replace_file(file, b"new")
    assert read_whole(file) == b"new"
    assert [one.name for one in tmp_path.iterdir()] == ["a.json"]
    file = tmp_path / "large.csv"
    file.write_bytes(b"x" * ((1 << 20) + 1))
    assert len(read_whole(file)) == (1 << 20) + 1
    with pytest.raises(BundleError, match=r"large\.csv.*is larger than 1 MiB"):
        read_whole(file, largest_bytes=1 << 20)


def test_two_threads_may_write_one_file_at_once(tmp_path, monkeypatch):
    file, both = tmp_path / "map.json", threading.Barrier(2, timeout=5)
    sync = os.fsync
    waits = threading.local()

    def sync_together(handle):
        if not hasattr(waits, "done"):
            waits.done = True
            both.wait()
        sync(handle)

    monkeypatch.setattr(whole_files.os, "fsync", sync_together)
    with ThreadPoolExecutor(2) as pool:
        writes = [pool.submit(replace_file, file, word * 999) for word in (b"a", b"b")]
        assert [one.result(10) for one in writes] == [None, None]
    assert set(file.read_bytes()) in ({ord("a")}, {ord("b")})
    assert [each.name for each in tmp_path.iterdir()] == ["map.json"]
