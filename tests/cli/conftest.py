"""A recording as files, and what `analyse` makes of it, for every command."""

import json
import shutil

import pytest

from truepath.cli.command import run
from truepath.files.bundle.bundle import write_bundle


@pytest.fixture(scope="session")
def recorded(record, tmp_path_factory):
    """A good measurement bundle; not to be changed."""
    folder = tmp_path_factory.mktemp("recorded") / "bundle"
    run_of_truth, _ = record(1, rows=24)
    write_bundle(run_of_truth, folder)
    return folder


@pytest.fixture(scope="session")
def analysed(recorded, tmp_path_factory):
    """The files of its result; not to be changed."""
    folder = tmp_path_factory.mktemp("analysed")
    assert run(["analyse", str(recorded), "-o", str(folder)]) == 0
    return folder


@pytest.fixture
def bundle(recorded, tmp_path):
    """A bundle to spoil."""
    return shutil.copytree(recorded, tmp_path / "bundle")


@pytest.fixture
def points(tmp_path):
    """Points to predict at."""
    file = tmp_path / "points.csv"
    file.write_text("x_mm,y_mm,z_mm\n0,0,0\n250,200,150\n500,400,300\n")
    return file


@pytest.fixture
def summary(capsys):
    """The object that `--json` has printed, alone on standard output."""

    def read():
        return json.loads(capsys.readouterr().out)

    return read
