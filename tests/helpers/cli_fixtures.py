"""A recording as files, its result, and command lines, for every test."""

import copy
import json
import shutil
from dataclasses import replace

import pytest

from truepath.cli.command import run
from truepath.compensation import residual_error
from truepath.files.bundle.bundle import write_bundle
from truepath.kinematics import volumetric_map
from truepath.planning import forecast, plan
from truepath.planning.planner import SearchEffort
from truepath.planning.target_blocks import plan_in_turn
from truepath.results import volumetric_error
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds.synthetic import Setting

RATE_HZ = 100.0


class Commands:
    """Runs command lines in this process, and tells what they say."""

    def __init__(self, capsys):
        self._capsys = capsys

    def run(self, *words):
        """Both streams of one that succeeds."""
        return self._call(words, 0)

    def json(self, *words, status=0):
        """The object that it prints with `--json`, alone on standard output."""
        return json.loads(self._call([*words, "--json"], status).out)

    def refuse(self, *words, status=2, shows=False):
        """The one line that a failure costs; before it, some show what they read."""
        said = self._call(words, status)
        lines = said.err.splitlines()
        assert shows or said.out == ""
        assert sum(line.startswith("truepath: ") for line in lines) == 1
        return lines[-1].removeprefix("truepath: ")

    def list_problems(self, *words):
        """The lines of a failure that has several reasons."""
        lines = self._call(words, 2).err.splitlines()
        mark = "problem: "
        return [x.removeprefix(mark) for x in lines if x.startswith(mark)]

    def _call(self, words, status):
        self._capsys.readouterr()
        found = run([str(word) for word in words])
        said = self._capsys.readouterr()
        assert found == status, said.err
        return said


@pytest.fixture
def command(capsys):
    return Commands(capsys)


@pytest.fixture(scope="session")
def record(record):
    """Record as every room does, with a fifth of the samples."""

    def make(*words, setting=None, **more):
        setting = replace(setting or Setting(), rate_hz=RATE_HZ)
        return record(*words, setting=setting, **more)

    return make


@pytest.fixture(scope="session")
def recorded(record, make_once):
    """A good measurement bundle; not to be changed."""

    def make(folder):
        write_bundle(record(1, rows=24)[0], folder / "bundle")

    return make_once("cli-recorded", make) / "bundle"


@pytest.fixture(scope="session")
def analysed(recorded, make_once):
    """The files of its result; not to be changed."""

    def make(folder):
        assert run(["analyse", str(recorded), "-o", str(folder)]) == 0

    return make_once("cli-analysed", make)


@pytest.fixture
def bundle(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "bundle")


@pytest.fixture
def result(analysed):
    return json.loads((analysed / "result.json").read_text())


@pytest.fixture
def keep(tmp_path):
    def write(content, name="result.json"):
        file = tmp_path / name
        file.write_text(json.dumps(content))
        return file

    return write


@pytest.fixture
def measure_again(keep):
    """Return the file of a result as of another measurement with that source."""

    def measure(result, **source):
        again = copy.deepcopy(result)
        again["provenance"]["input_sha256"] = "a" * 64
        for one in again["runs"]:
            one["input_sha256"] = "b" * 64
            one["source"].update(source)
        return keep(again, "left.json")

    return measure


@pytest.fixture
def points(tmp_path):
    file = tmp_path / "points.csv"
    file.write_text("x_mm,y_mm,z_mm\n0,0,0\n250,200,150\n500,400,300\n")
    return file


@pytest.fixture(scope="session")
def machine_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("machine") / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    return file


@pytest.fixture(scope="module")
def few_places():
    """State what files leave from few places, where no test asks for its digits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(residual_error, "CLOSE", 128)
        patch.setattr(volumetric_error, "_DRAWS", 8)
        yield


@pytest.fixture(scope="module")
def little_search():
    """Plan in little time: how well is held in tests/planning."""

    def choose(shares, *, seed, effort):
        return plan_in_turn(shares, seed=seed, effort=SearchEffort(24, rounds=0))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "plan_in_turn", choose)
        patch.setattr(forecast, "_CURVE", 4)
        patch.setattr(volumetric_map, "_NODES", 6)
        yield
