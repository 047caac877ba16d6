"""Files that a controller applies are read as they were written."""

import hashlib
import json

import numpy as np
import pytest
from tests.compensation.written_tables import CONTENT, write_files

from truepath.compensation.active_files import read_active_files
from truepath.compensation.installed import load_format
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import Conditions

MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
DIFFERENCE = {"backlash_reading": "difference"}


@pytest.fixture
def written(tmp_path):
    """Files whose BACKLASH is the difference of both directions."""
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
    added = active.added(moments(position_mm, direction))
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
    usual = read(tmp_path, "siemens", files).added(at)
    names = {"round-lec.ini": "AX_EEC.INI", "round-cec.ini": "NC_CEC.INI"}
    assert np.abs(usual).max() > 1e-3
    assert read(tmp_path, "siemens", files, names).added(at) == pytest.approx(usual)


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
