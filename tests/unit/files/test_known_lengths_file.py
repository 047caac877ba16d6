"""`known_lengths.csv` in a bundle, and what is wrong with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from truepath.errors import BundleError
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.recorded_files import (
    add_known_lengths,
    decode_known_lengths,
    encode_known_lengths,
)
from truepath.files.environment import Refraction
from truepath.measurement.run_file.run_loader import name_known_lengths
from truepath_drivers.interfaces.tracker_records import Light

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
    corrected = replace(run, refraction=done)
    (one,) = add_known_lengths(corrected, decode()).known_lengths
    assert one.measured_mm == pytest.approx(2000.02 / 1.00027)
    assert one.ends_mm[0][0] == pytest.approx(1000.0 / 1.00027)


def test_lengths_beside_a_bundle_have_its_whole_name(tmp_path, monkeypatch):
    (tmp_path / "2026.11.29").mkdir()
    named = name_known_lengths(tmp_path / "2026.11.29")
    assert named.name == "2026.11.29.known_lengths.csv"
    assert name_known_lengths(tmp_path / "mill.zip").name == "mill.known_lengths.csv"
    monkeypatch.chdir(tmp_path / "2026.11.29")
    assert name_known_lengths(Path()) == named
