"""Files that a controller applies are read as they were written, and added to."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from truepath.compensation.account.residual_error import sample_travel
from truepath.compensation.active_files import make_active_files, read_active_files
from truepath.compensation.format_registry import load_format
from truepath.compensation.tables.error_map import map_errors
from truepath.compensation.tables.tabulation import Tabulation
from truepath.compensation.tables.unmeasured_range import (
    Unmeasured,
    find_measured_ranges,
)
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import Conditions
from written_tables import CONTENT, write_files

MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
DIFFERENCE = {"backlash_reading": "difference"}


@pytest.fixture
def written(tmp_path):
    files = []
    for name, text in write_files("heidenhain-difference").items():
        (tmp_path / name).write_text(text)
        files.append(tmp_path / name)
    return files


def moments(position_mm, direction):
    """Standstills that every axis comes to in one direction."""
    n, none = len(position_mm), np.zeros_like(position_mm)
    at = (np.zeros(n), np.full(n, -1), np.zeros(n))
    return Conditions(MACHINE, position_mm, none, *at, none, none + direction)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_choices_of_the_account_beside_the_files_are_those_they_are_read_by(
    written, direction
):
    digests = {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in written}
    account = {"format": "heidenhain", "files_sha256": digests, "choices": DIFFERENCE}
    (written[0].parent / "round.json").write_text(json.dumps(account))
    (written[0].parent / "other.json").write_text("{")
    position_mm = np.array([[100.0, 30.0, 40.0], [300.0, 60.0, 90.0]])
    active = read_active_files(written, "heidenhain", MACHINE)
    added = active.additional_correction_at(moments(position_mm, direction))
    texts = {file.name: file.read_text() for file in written}
    read = load_format("heidenhain", DIFFERENCE).read(texts, MACHINE)
    usual = load_format("heidenhain").read(texts, MACHINE)
    assert added == pytest.approx(read(position_mm, direction), abs=1e-12)
    apart = np.abs(added - usual(position_mm, direction)).max()
    assert (apart > 1e-4) == (direction < 0.0)


def read(folder, order, files, names=None):
    """What files are taken for, under other names where these are given."""
    written = []
    for name, text in files.items():
        place = folder / (names or {}).get(name, name)
        place.write_text(text)
        written.append(place)
    return read_active_files(written, order, MACHINE)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_siemens_files_under_the_names_of_the_control_are_the_same(tmp_path, direction):
    files = write_files("siemens")
    at = moments(np.array([[90.0, 30.0, 40.0]]), direction)
    usual = read(tmp_path, "siemens", files).additional_correction_at(at)
    names = {"round-lec.ini": "AX_EEC.INI", "round-cec.ini": "NC_CEC.INI"}
    assert np.abs(usual).max() > 1e-3
    assert read(tmp_path, "siemens", files, names).additional_correction_at(
        at
    ) == pytest.approx(usual)


@pytest.mark.parametrize(
    ("order", "change", "words"),
    [
        ("siemens", lambda f: f.pop("round-cec.ini"), "holds _CEC tables"),
        ("siemens", lambda f: f.update({"a.ini": "M17"}), "a.ini: holds no tables"),
        ("heidenhain", lambda f: f.pop("config.cma"), "config.cma is missing"),
        ("heidenhain", lambda f: f.pop("round-X.com"), "round-X.com is missing"),
        ("linuxcnc", lambda f: f.update({"x.comp": f.pop("round-X.tbl")}), "x.comp"),
        ("fanuc", lambda f: f.pop(next(iter(f))), "has a name that ends in"),
        ("csv", lambda f: f.update({"b.csv": ""}), "cannot be read as files of csv"),
    ],
)
def test_files_that_are_missing_or_of_no_use_are_never_a_compensation_of_nothing(
    tmp_path, order, change, words
):
    files = write_files(order)
    change(files)
    with pytest.raises(BadInput, match=words):
        read(tmp_path, order, files)


ROUNDING_UM = {"fanuc": 3.0, "heidenhain": 0.2}  # of three files; 0.1 of the others
FORMATS = ("linuxcnc", "siemens", "siemens-lec", "siemens-cec", "heidenhain")
FORMATS += ("fanuc", "isg-csv", "etalon-exchange", "csv", "json")


def make_errors(loaded, size, lost_um):
    """A machine whose errors are so many times those of the result."""
    half = {"X": (np.array([-200.0, 300.0]), np.array(lost_um))}
    theta = size * loaded.theta
    return map_errors(replace(loaded, theta=theta, half_difference_um=half))


@pytest.mark.parametrize("name", FORMATS)
def test_combined_files_add_what_active_ones_and_the_difference_add(name, loaded):
    found = make_errors(loaded, 0.6, [3.0, 5.0])
    left = make_errors(loaded, -0.2, [-1.0, 2.0])
    kind, machine = load_format(name), found.machine
    measured = find_measured_ranges(machine, {}, Unmeasured.HOLD)
    made = Tabulation(kind, "a", (), 10.0, measured)
    texts = made.write(found)
    data = {file: text.encode() for file, text in texts.items()}
    active = make_active_files(data, name, machine, {})
    combined = replace(made, active=active)
    place, _ = sample_travel(found)
    off_um = []
    for side in (1.0, -1.0):
        both = (one.read_back(left)(place, side) for one in (combined, made))
        off_um.append(1e3 * np.subtract(*both))
    off_um -= np.mean(off_um, axis=(0, 1))
    added_um = 1e3 * active.correction(place, 1.0)
    assert np.abs(added_um).max() > 10.0
    assert np.abs(off_um).max() < ROUNDING_UM.get(name, 0.1)
