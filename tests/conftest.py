"""Recordings with known truth, for every room that judges an estimate."""

from __future__ import annotations

import fcntl
import importlib
import json
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path as FilePath
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import structlog

from truepath.catalogue.run_reader import RunReader
from truepath.catalogue.store.database import Database
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import LinearAxis, Machine, RotaryAxis, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.motion.configurations import Configurations
from truepath_drivers import host_clock
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators import scenario
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

sys.path.append(str(FilePath(__file__).parent / "helpers"))
from postgres_server import PostgresServer


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let the rooms of jobs and API be tested on either database."""
    parser.addoption(
        "--database",
        choices=("sqlite", "postgresql"),
        default="sqlite",
        help="what the catalogues of tests/jobs and tests/api stand on",
    )
    parser.addoption(
        "--measured",
        type=FilePath,
        help="JSON file that takes what tests of faults have measured",
    )


_PERFECT = tempfile.TemporaryDirectory()


def use_perfect_trackers(folder: FilePath) -> None:
    """Let bundled machines have none of the errors that a tracker's maker specifies.

    Their one draw would decide other claims. Services in processes of their own, and
    tests that state a specification, have them.
    """
    for name in scenario.list_machines():
        content = load_machine(name)
        content["tracker"]["specification"] = {}
        (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    scenario.BUNDLED = folder


def pytest_configure(config: pytest.Config) -> None:
    """Collect what tests measure where a file for it is named."""
    use_perfect_trackers(FilePath(_PERFECT.name))
    file = config.getoption("--measured")
    if file is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Measured(file))


@dataclass(frozen=True)
class Truth:
    """What the recording was made from."""

    recording: synthetic.Recording

    def deviation_mm(self, position_mm: np.ndarray) -> np.ndarray:
        """Volumetric error of the truth machine, exact transforms."""
        return self.recording.truth.deviation_mm(position_mm)


MEASURED = "measured"


class Measured:
    """Keeps what passed tests have measured; those that did not run keep theirs."""

    def __init__(self, file: FilePath) -> None:
        self._file = file
        self._texts: dict[str, dict[str, list[str]]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take what a test that has passed noted."""
        if report.when != "call" or not report.passed:
            return
        for name, value in report.user_properties:
            if name == MEASURED:
                row, text = value
                tests = self._texts.setdefault(str(row), {})
                tests.setdefault(report.nodeid, []).append(text)

    def pytest_sessionfinish(self) -> None:
        """Write it beside what the file has of other tests."""
        content = {}
        if self._file.is_file():
            content = json.loads(self._file.read_text(encoding="utf-8"))
        for row, tests in self._texts.items():
            content[row] = dict(sorted({**content.get(row, {}), **tests}.items()))
        ordered = {row: content[row] for row in sorted(content, key=int)}
        text = json.dumps(ordered, indent=1, ensure_ascii=False) + "\n"
        self._file.write_text(text, encoding="utf-8")


Recorded = tuple[Run, Truth]
Record = Callable[..., Recorded]


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Note what a test of a fault has measured, for the table of docs/reliability.md.

    It is told under every row that the test proves.
    """
    rows = [mark.args[0] for mark in request.node.iter_markers("fault_row")]
    notes: list[tuple[str, object]] = request.node.user_properties

    def note(text: str) -> None:
        notes.extend((MEASURED, [row, text]) for row in rows)

    return note


class HandClock:
    """The computer's clock, standing until the test moves it."""

    def __init__(self) -> None:
        self.time_s = 0.0


@pytest.fixture
def hand_clock(monkeypatch: pytest.MonkeyPatch) -> HandClock:
    """Let a test say what time it is."""
    clock = HandClock()
    monkeypatch.setattr(host_clock, "now_s", lambda: clock.time_s)
    return clock


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded randomness."""
    return np.random.default_rng(20230307)


MakeOnce = Callable[[str, Callable[[FilePath], None]], FilePath]


@pytest.fixture(scope="session")
def make_once(tmp_path_factory: pytest.TempPathFactory) -> MakeOnce:
    """Make a folder once for all workers: make_once(name, make) gives it filled.

    `make` fills the folder that it is given. What is in it is not to be changed.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base

    def once(name: str, make: Callable[[FilePath], None]) -> FilePath:
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
def run_reader() -> Iterator[RunReader]:
    """Read uploaded bundles in a process that starts with the first of them."""
    reader = RunReader()
    yield reader
    reader.close()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    """Start a server of PostgreSQL, gone at the end."""
    try:
        server = PostgresServer()
    except FileNotFoundError:
        pytest.skip("PostgreSQL is not installed")
    yield server
    server.close()


@pytest.fixture(scope="session")
def empty_postgres(postgres_server: PostgresServer) -> str:
    """Name a migrated database to copy: migrating takes longer than most tests."""
    name = postgres_server.make_database()
    database = Database(postgres_server.url(name))
    database.migrate()
    database.close()
    return name


@pytest.fixture(scope="session")
def empty_catalogue(tmp_path_factory: pytest.TempPathFactory) -> FilePath:
    """A migrated file to copy: migrating takes longer than most tests."""
    file = tmp_path_factory.mktemp("catalogue") / "catalogue.sqlite"
    database = Database(f"sqlite:///{file}")
    database.migrate()
    database.close()
    return file


@pytest.fixture
def make_catalogue_url(
    request: pytest.FixtureRequest, tmp_path: FilePath
) -> Iterator[Callable[[str], str]]:
    """Make an empty catalogue of the newest schema; give its address."""
    made: list[str] = []

    def make(kind: str) -> str:
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
def database_kind(request: pytest.FixtureRequest) -> str:
    """Say what catalogues stand on; overridden by tests of one of both."""
    return str(request.config.getoption("--database"))


@pytest.fixture
def catalogue_url(make_catalogue_url: Callable[[str], str], database_kind: str) -> str:
    """Give the address of an empty catalogue."""
    return make_catalogue_url(database_kind)


@pytest.fixture(scope="session")
def mill() -> Machine:
    """Three linear axes, Z downwards."""
    return Machine(
        "small mill",
        ("X",),
        ("Y", "Z"),
        (
            LinearAxis("X", 0.0, 500.0),
            LinearAxis("Y", 0.0, 400.0),
            LinearAxis("Z", -300.0, 0.0),
        ),
        (Target("", "tool", (20.0, 30.0, -150.0)),),
        TrackerNoise(),
    )


@pytest.fixture
def square() -> Path:
    """A path of three lines in the travel of the mill."""
    rows = [(10, 10, -10), (110, 10, -10), (110, 60, -10), (10, 60, -40)]
    n = len(rows)
    return Path(
        ("X", "Y", "Z"),
        np.array(rows, float),
        np.full(n, 6000.0),
        np.array([0.1, 0.2, 0.1, 0.3]),
    )


@pytest.fixture(scope="session")
def record() -> Record:
    """Make a recording: record(seed, mode, rows=…, feed=…, chain=…, setting=…).

    The fewer mm its axes travel, the fewer parameters an estimate has.
    """
    made: dict[Any, Recorded] = {}

    def make(
        seed: int = 1,
        mode: str = "otf",
        *,
        rows: int = 24,
        feed: float = 10_000.0,
        chain: str = "w-b-X-Y-Z-t",
        corners: bool = False,
        program: Program | None = None,
        setting: synthetic.Setting | None = None,
        travel_mm: float | None = None,
    ) -> Recorded:
        how = (feed, chain, corners, travel_mm, repr(program), repr(setting))
        key = (seed, mode, rows, how)
        if key not in made:
            content = {**load_machine("demo"), "kinematic_chain": chain}
            for axis in content["axes"].values() if travel_mm else ():
                axis["max_mm"] = axis["min_mm"] + travel_mm
            machine = parse_machine(content)
            drive = program
            if drive is None and mode == "standstill":
                drive = paths.standstill_points(machine, seed, rows, dwell_s=0.8)
            elif drive is None and corners:
                drive = paths.corner_path(machine, feed)
            elif drive is None:
                drive = paths.chord_path(machine, seed, rows, feed)
            recording = synthetic.record(content, drive, seed, mode, setting)
            made[key] = (_run(recording), Truth(recording))
        return made[key]

    return make


@pytest.fixture(scope="session")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> FilePath:
    """A zipped standstill Run of a machine so small that its trials take a second."""
    content = load_machine("demo")
    for axis in content["axes"].values():
        axis["min_mm"], axis["max_mm"] = 0.0, 120.0
    program = paths.standstill_points(parse_machine(content), 3, 30, dwell_s=0.8)
    recording = synthetic.record(content, program, 3, "standstill")
    file = tmp_path_factory.mktemp("small") / "run.zip"
    file.write_bytes(zip_bundle(_run(recording)))
    return file


def _run(recording: synthetic.Recording) -> Run:
    machine = machine_from_json(dict(recording.content), file="machine.json")
    program, n = recording.program, len(recording)
    axes = machine.axis_names
    if recording.mode == "standstill":
        commanded: Path | Configurations = Configurations(
            axes, program.position, program.dwell_s, program.target
        )
    else:
        feed_mm_min = program.feed_mm_s * 60.0
        commanded = Path(
            axes, program.position, feed_mm_min, program.dwell_s, program.target
        )
    samples = TrackerSamples(
        np.arange(n), recording.time_s, recording.position_mm, recording.status
    )
    return Run("synthetic", machine, commanded, samples)


@pytest.fixture(scope="session")
def run_of() -> Callable[[synthetic.Recording], Run]:
    """Make a Run of a recording."""
    return _run


def without_rigid_motion(position_mm: np.ndarray, error_mm: np.ndarray) -> np.ndarray:
    """Remove the rigid motion of the whole volume from errors at positions."""
    columns = np.zeros((len(position_mm), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        columns[:, :, 3 + k] = np.cross(axis, position_mm)
    flat = columns.reshape(-1, 6)
    fit = np.linalg.lstsq(flat, error_mm.reshape(-1), rcond=None)[0]
    return error_mm - (flat @ fit).reshape(-1, 3)


@pytest.fixture(scope="session")
def rigid_free() -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Give tests the map without its gauge."""
    return without_rigid_motion


@pytest.fixture(scope="session")
def volume() -> Callable[[Machine], np.ndarray]:
    """Give random positions inside the travel of a machine."""

    def points(machine: Machine, n: int = 300) -> np.ndarray:
        axes = machine.linear_axes
        low = np.array([a.low + 15.0 for a in axes])
        high = np.array([a.high - 15.0 for a in axes])
        return np.random.default_rng(7).uniform(low, high, (n, len(axes)))

    return points


@pytest.fixture(scope="session")
def at_rest() -> Callable[[Machine, np.ndarray], Any]:
    """Give the conditions of a machine at rest."""
    return make_standstill


@pytest.fixture(autouse=True)
def no_log_of_another_test() -> Iterator[None]:
    """Take away what a command has set up to write its log with."""
    yield
    root = logging.getLogger()
    for handler in root.handlers[:]:
        if type(handler) is logging.StreamHandler:
            root.removeHandler(handler)


@pytest.fixture(scope="module")
def plain_log() -> Iterator[None]:
    """Log with short traces."""
    before = structlog.get_config()
    plain = structlog.dev.ConsoleRenderer(
        colors=False, exception_formatter=structlog.dev.plain_traceback
    )
    structlog.configure(
        processors=[structlog.contextvars.merge_contextvars, plain],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )
    yield
    structlog.configure(**before)


@pytest.fixture(scope="session")
def trunnion(mill: Machine) -> Machine:
    """A tilting table under a mill, and a target on each side."""
    return Machine(
        "trunnion mill",
        ("C", "A"),
        ("X", "Y", "Z"),
        (
            *mill.axes,
            RotaryAxis("A", -110, 30, (0.0, 20.0, 10.0), (1.0, 0.0, 0.0)),
            RotaryAxis("C", 0, 360, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ),
        (Target("T", "tool", (0, 0, -80)), Target("W", "workpiece", (90, 0, 0))),
        TrackerNoise(stands_on="base"),
    )


@pytest.fixture(scope="module")
def import_code(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[[str, str], ModuleType]]:
    """Import code by a name under which child processes can import it as well."""
    folder = tmp_path_factory.mktemp("modules")
    sys.path.insert(0, str(folder))

    def load(name: str, code: str) -> ModuleType:
        (folder / f"{name}.py").write_text(code)
        return importlib.import_module(name)

    yield load
    sys.path.remove(str(folder))
