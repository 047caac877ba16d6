"""Files that a controller applies are read as they were written, and added to."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from known_machines import tabulate
from truepath.compensation.active_files import make_active_files, read_active_files
from truepath.compensation.format_registry import list_formats, load_format
from truepath.compensation.residual_error import sample_travel
from truepath.compensation.tables.error_map import map_errors
from truepath.errors import BadInput
from truepath.files.earlier.result_file import HalfDifference
from truepath.kinematics.conditions import Conditions
from written_tables import MACHINE, write_files

DIFFERENCE = {"backlash_reading": "difference"}
ROUNDING_UM = {"fanuc": 3.0, "heidenhain": 0.2}  # of three files; 0.1 of the others


def store(folder, files, names=None):
    written = []
    for name, text in files.items():
        place = folder / (names or {}).get(name, name)
        place.write_text(text)
        written.append(place)
    return written


def moments(position_mm, direction):
    n, none = len(position_mm), np.zeros_like(position_mm)
    at = np.zeros(n), np.full(n, -1), np.zeros(n)
    return Conditions(MACHINE, position_mm, none, *at, none, none + direction)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_files_are_read_by_the_choices_of_the_account_beside_them(tmp_path, direction):
    texts = write_files("heidenhain-difference")
    digests = {n: hashlib.sha256(t.encode()).hexdigest() for n, t in texts.items()}
    account = {"format": "heidenhain", "files_sha256": digests, "choices": DIFFERENCE}
    (tmp_path / "round.json").write_text(json.dumps(account))
    (tmp_path / "other.json").write_text("{")
    position_mm = np.array([[100.0, 30.0, 40.0], [300.0, 60.0, 90.0]])
    active = read_active_files(store(tmp_path, texts), "heidenhain", MACHINE)
    added = active.additional_correction_at(moments(position_mm, direction))
    read = load_format("heidenhain", DIFFERENCE).read(texts, MACHINE)
    usual = load_format("heidenhain").read(texts, MACHINE)
    assert added == pytest.approx(read(position_mm, direction), abs=1e-12)
    apart = np.abs(added - usual(position_mm, direction)).max()
    assert (apart > 1e-4) == (direction < 0.0)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_siemens_files_under_the_names_of_the_control_are_the_same(tmp_path, direction):
    at = moments(np.array([[90.0, 30.0, 40.0]]), direction)
    own = {"round-lec.ini": "AX_EEC.INI", "round-cec.ini": "NC_CEC.INI"}
    added = []
    for names in ({}, own):
        written = store(tmp_path, write_files("siemens"), names)
        active = read_active_files(written, "siemens", MACHINE)
        added.append(active.additional_correction_at(at))
    assert np.abs(added[0]).max() > 1e-3
    assert added[1] == pytest.approx(added[0])


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
def test_missing_or_useless_files_are_refused(tmp_path, order, change, words):
    files = write_files(order)
    change(files)
    with pytest.raises(BadInput, match=words):
        read_active_files(store(tmp_path, files), order, MACHINE)


def make_errors(loaded, size, lost_um):
    half = {"EXX": HalfDifference(np.array([-200.0, 300.0]), np.array(lost_um))}
    theta = size * loaded.theta
    return map_errors(replace(loaded, theta=theta, halves=half))


@pytest.mark.parametrize("name", list_formats())
def test_combined_files_add_what_active_ones_and_the_difference_add(name, loaded):
    found = make_errors(loaded, 0.6, [3.0, 5.0])
    left = make_errors(loaded, -0.2, [-1.0, 2.0])
    made = tabulate(found, name, 10.0)
    data = {file: text.encode() for file, text in made.write(found).items()}
    active = make_active_files(data, name, found.machine, {})
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
