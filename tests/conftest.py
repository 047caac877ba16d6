"""Recordings with known truth, for every room that judges an estimate."""

import fcntl
import importlib
import json
import logging
import os
import shutil
import socket
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path as FilePath
from types import SimpleNamespace

import numpy as np
import pytest
import structlog

from truepath.catalogue.database import Database
from truepath.catalogue.run_reader import RunReader
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.machine import LinearAxis, Machine, RotaryAxis, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators import machine_file
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic

sys.path.append(str(FilePath(__file__).parent / "helpers"))
from paths_by_hand import path_of
from postgres_server import PostgresServer


def pytest_addoption(parser):
    kinds, stood_on = ("sqlite", "postgresql"), "what the catalogues of tests stand on"
    parser.addoption("--database", choices=kinds, default="sqlite", help=stood_on)
    taken = "JSON file that takes what tests of faults have measured"
    parser.addoption("--measured", type=FilePath, help=taken)


_PERFECT = tempfile.TemporaryDirectory()


def use_perfect_trackers(folder):
    """Let bundled machines have none of the errors that a tracker's maker specifies.

    Their one draw would decide other claims. Services in processes of their own, and
    tests that state a specification, have them.
    """
    for name in machine_file.list_machines():
        content = load_machine(name)
        content["tracker"]["specification"] = {}
        (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    machine_file.BUNDLED = folder


def pytest_configure(config):
    use_perfect_trackers(FilePath(_PERFECT.name))
    file = config.getoption("--measured")
    if file is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Measured(file))


@dataclass(frozen=True)
class Truth:
    recording: synthetic.Recording

    def deviation_mm(self, position_mm):
        """Volumetric error of the truth machine, exact transforms."""
        return self.recording.truth.deviation_mm(position_mm)


MEASURED = "measured"


class Measured:
    """Keeps what passed tests have measured; those that did not run keep theirs."""

    def __init__(self, file):
        self._file = file
        self._texts = {}

    def pytest_runtest_logreport(self, report):
        if report.when != "call" or not report.passed:
            return
        for name, value in report.user_properties:
            if name == MEASURED:
                row, text = value
                tests = self._texts.setdefault(str(row), {})
                tests.setdefault(report.nodeid, []).append(text)

    def pytest_sessionfinish(self):
        content = {}
        if self._file.is_file():
            content = json.loads(self._file.read_text(encoding="utf-8"))
        for row, tests in self._texts.items():
            content[row] = dict(sorted({**content.get(row, {}), **tests}.items()))
        ordered = {row: content[row] for row in sorted(content, key=int)}
        text = json.dumps(ordered, indent=1, ensure_ascii=False) + "\n"
        self._file.write_text(text, encoding="utf-8")


@pytest.fixture
def measured(request):
    """Note what a test of a fault has measured, for the table of docs/reliability.md.

    It is told under every row that the test proves.
    """
    rows = [mark.args[0] for mark in request.node.iter_markers("fault_row")]
    notes = request.node.user_properties

    def note(text):
        notes.extend((MEASURED, [row, text]) for row in rows)

    return note


@pytest.fixture
def hand_clock(monkeypatch):
    """The computer's clock, standing until the test moves it."""
    clock = SimpleNamespace(time_s=0.0)
    monkeypatch.setattr(host_clock, "now_s", lambda: clock.time_s)
    return clock


@pytest.fixture
def rng():
    return np.random.default_rng(20230307)


@pytest.fixture(scope="session")
def make_once(tmp_path_factory):
    """Make a folder once for all workers: make_once(name, make) gives it filled.

    `make` fills the folder that it is given. What is in it is not to be changed.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base

    def once(name, make):
        folder = shared / "made-once" / name
        folder.mkdir(parents=True, exist_ok=True)
        done = folder.with_name(f"{name}.done")
        with folder.with_name(f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                make(folder)
                done.touch()
        return folder

    return once


@pytest.fixture(scope="session")
def run_reader():
    """Read uploaded bundles in a process that starts with the first of them."""
    reader = RunReader()
    yield reader
    reader.close()


@pytest.fixture(scope="session")
def postgres_server():
    try:
        server = PostgresServer()
    except FileNotFoundError:
        pytest.skip("PostgreSQL is not installed")
    yield server
    server.close()


def migrate(url):
    database = Database(url)
    database.migrate()
    database.close()


@pytest.fixture(scope="session")
def empty_postgres(postgres_server):
    """Name a migrated database to copy: migrating takes longer than most tests."""
    name = postgres_server.make_database()
    migrate(postgres_server.url(name))
    return name


@pytest.fixture(scope="session")
def empty_catalogue(tmp_path_factory):
    """A migrated file to copy: migrating takes longer than most tests."""
    file = tmp_path_factory.mktemp("catalogue") / "catalogue.sqlite"
    migrate(f"sqlite:///{file}")
    return file


@pytest.fixture
def make_catalogue_url(request, tmp_path):
    """Make an empty catalogue of the newest schema; give its address."""
    made = []

    def make(kind):
        if kind == "sqlite":
            file = tmp_path / "catalogue.sqlite"
            shutil.copyfile(request.getfixturevalue("empty_catalogue"), file)
            return f"sqlite:///{file}"
        server = request.getfixturevalue("postgres_server")
        made.append(server.make_database(request.getfixturevalue("empty_postgres")))
        return server.url(made[-1])

    yield make
    for name in made:
        request.getfixturevalue("postgres_server").drop_database(name)


@pytest.fixture
def database_kind(request):
    return str(request.config.getoption("--database"))


@pytest.fixture
def catalogue_url(make_catalogue_url, database_kind):
    return make_catalogue_url(database_kind)


@pytest.fixture(scope="session")
def mill():
    """Three linear axes, Z downwards."""
    travels = (("X", 0.0, 500.0), ("Y", 0.0, 400.0), ("Z", -300.0, 0.0))
    axes = tuple(LinearAxis(*travel) for travel in travels)
    targets = (Target("", "tool", (20.0, 30.0, -150.0)),)
    return Machine("small mill", ("X",), ("Y", "Z"), axes, targets, TrackerNoise())


@pytest.fixture
def square():
    rows = [(10, 10, -10), (110, 10, -10), (110, 60, -10), (10, 60, -40)]
    return path_of(*rows, dwell_s=(0.1, 0.2, 0.1, 0.3))


def choose_program(content, seed, mode, rows, feed, corners=False, dwell_s=0.8):
    """Return random lines, those between corners, or standstills at random places."""
    machine = machine_file.parse_machine(content)
    if mode == "standstill":
        return paths.standstill_points(machine, seed, rows, dwell_s=dwell_s)
    if corners:
        return paths.corner_path(machine, feed)
    return paths.chord_path(machine, seed, rows, feed)


@pytest.fixture(scope="session")
def record():
    """Make a recording: record(seed, mode, rows=…, feed=…, chain=…, setting=…).

    The fewer mm its axes travel, the fewer parameters an estimate has.
    """
    made = {}

    def make(
        seed=1,
        mode="otf",
        *,
        rows=24,
        feed=10_000.0,
        chain="w-b-X-Y-Z-t",
        corners=False,
        program=None,
        setting=None,
        travel_mm=None,
    ):
        how = (feed, chain, corners, travel_mm, repr(program), repr(setting))
        key = (seed, mode, rows, how)
        if key not in made:
            content = {**load_machine("demo"), "kinematic_chain": chain}
            for axis in content["axes"].values() if travel_mm else ():
                axis["max_mm"] = axis["min_mm"] + travel_mm
            drive = program or choose_program(content, seed, mode, rows, feed, corners)
            recording = synthetic.record(content, drive, seed, mode, setting)
            made[key] = (_run(recording), Truth(recording))
        return made[key]

    return make


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """A zipped standstill Run of a machine so small that its trials take a second."""
    content = load_machine("demo")
    for axis in content["axes"].values():
        axis["min_mm"], axis["max_mm"] = 0.0, 120.0
    program = choose_program(content, 3, "standstill", 30, 0.0)
    recording = synthetic.record(content, program, 3, "standstill")
    file = tmp_path_factory.mktemp("small") / "run.zip"
    file.write_bytes(zip_bundle(_run(recording)))
    return file


def _run(recording):
    machine = machine_from_json(dict(recording.content), file="machine.json")
    program, number = recording.program, np.arange(len(recording))
    where = machine.axis_names, program.position
    waits = program.dwell_s, program.target
    if recording.mode == "standstill":
        commanded = Configurations(*where, *waits)
    else:
        commanded = Path(*where, program.feed_mm_s * 60.0, *waits)
    measured = recording.time_s, recording.position_mm, recording.status
    samples = TrackerSamples(number, *measured)
    return Run("synthetic", machine, commanded, samples)


@pytest.fixture(scope="session")
def run_of():
    return _run


def without_rigid_motion(position_mm, error_mm):
    """Remove the rigid motion of the whole volume from errors at positions."""
    columns = np.zeros((len(position_mm), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, position_mm)
    flat = columns.reshape(-1, 6)
    fit = np.linalg.lstsq(flat, error_mm.reshape(-1), rcond=None)[0]
    return error_mm - (flat @ fit).reshape(-1, 3)


@pytest.fixture(scope="session")
def rigid_free():
    return without_rigid_motion


@pytest.fixture(scope="session")
def volume():
    def points(machine, n=300):
        axes = machine.linear_axes
        low = np.array([a.low + 15.0 for a in axes])
        high = np.array([a.high - 15.0 for a in axes])
        return np.random.default_rng(7).uniform(low, high, (n, len(axes)))

    return points


@pytest.fixture
def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


@pytest.fixture(autouse=True)
def no_log_of_another_test():
    """Take away what a command has set up to write its log with."""
    yield
    root = logging.getLogger()
    root.handlers = [h for h in root.handlers if type(h) is not logging.StreamHandler]


@pytest.fixture(scope="module")
def plain_log():
    before, trace = structlog.get_config(), structlog.dev.plain_traceback
    plain = structlog.dev.ConsoleRenderer(colors=False, exception_formatter=trace)
    structlog.configure(
        processors=[structlog.contextvars.merge_contextvars, plain],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )
    yield
    structlog.configure(**before)


@pytest.fixture(scope="session")
def trunnion(mill):
    """A tilting table under a mill, and a target on each side."""
    a = RotaryAxis("A", -110, 30, (0.0, 20.0, 10.0), (1.0, 0.0, 0.0))
    c = RotaryAxis("C", 0, 360, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    targets = Target("T", "tool", (0, 0, -80)), Target("W", "workpiece", (90, 0, 0))
    sides, tracker = (("C", "A"), ("X", "Y", "Z")), TrackerNoise(stands_on="base")
    return Machine("trunnion mill", *sides, (*mill.axes, a, c), targets, tracker)


@pytest.fixture(scope="module")
def import_code(tmp_path_factory):
    """Import code by a name under which child processes can import it as well."""
    folder = tmp_path_factory.mktemp("modules")
    sys.path.insert(0, str(folder))

    def load(name, code):
        (folder / f"{name}.py").write_text(code)
        return importlib.import_module(name)

    yield load
    sys.path.remove(str(folder))
