"""A driver of somebody else: installed, found, conforming, measured with."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from truepath.alignment.align import align
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.measurement.messages import (
    CellConfig,
    FaultReported,
    MeasurementOrder,
    RunClosed,
)
from truepath.measurement.process.cell import Cell
from truepath.measurement.run_file.run_reading import open_run
from truepath.measurement.time_limits import StreamTimeouts
from truepath.plugins import find_plugins, load
from truepath.settings import load_settings
from truepath_drivers.conformance import device
from truepath_drivers.conformance.checking import on_terms
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.errors import Refused
from truepath_drivers.interfaces.records import Path as MotionPath
from truepath_simulators.bench.rig import Rig, running_rig
from truepath_simulators.errors import SimulatorError
from truepath_simulators.replay.recorded_run import read_recorded_run
from truepath_simulators.scenario import load_machine

HERE = Path(__file__).parent
NAME = "othermake-lt50"
CALM = StreamTimeouts(silent_s=10.0, dead_s=30.0, beam_s=10.0)
CORNERS = MotionPath(
    ("X", "Y", "Z"),
    np.array(
        [[20, 20, 20], [480, 380, 20], [20, 380, 280], [480, 20, 280], [20, 20, 20]],
        float,
    ),
    np.full(5, 12_000.0),
    np.full(5, 1.0),
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which the distribution is installed, as anybody installs it."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(HERE / "third_party", folder / "source")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
    command += ["--no-index", "--no-build-isolation", "--target", str(folder / "site")]
    subprocess.run([*command, str(source)], check=True, capture_output=True)
    return folder / "site"


@pytest.fixture(autouse=True)
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(site)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with running_rig({"seed": 6, "speed": 10.0}) as started:
        yield started


@pytest.fixture(scope="module")
def imitate(rig: Rig) -> Iterator[Callable[[float], dict[str, str | int]]]:
    """Start an instrument that looks at the rig's machine; return where it listens."""
    started: list[subprocess.Popen[str]] = []

    def start(share: float) -> dict[str, str | int]:
        script, control = str(HERE / "imitate_othermake.py"), str(rig.control)
        process = subprocess.Popen(
            [sys.executable, script, control, str(share)],
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        return {"host": "127.0.0.1", "port": int(process.stdout.readline())}

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def options(imitate: Callable[[float], dict[str, str | int]]) -> dict[str, str | int]:
    return imitate(0.0)


@pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
def test_it_conforms(
    options: dict[str, str | int],
    check: Callable[..., None],
) -> None:
    make = load("truepath.trackers", NAME)
    with on_terms(rate_hz=50.0):
        check(lambda: make(**options))


def test_it_says_when_it_is_not_there(free_port: int) -> None:
    make = load("truepath.trackers", NAME)
    device.a_device_that_is_not_there_is_a_device_error(
        lambda: make("127.0.0.1", free_port)
    )


def test_a_rate_that_it_has_not_tells_where_to_give_another(
    options: dict[str, str | int],
) -> None:
    with (
        load("truepath.trackers", NAME)(**options) as tracker,
        pytest.raises(Refused, match="rate_hz in machine"),
    ):
        tracker.start(500.0)


def test_damaged_lines_are_counted_and_never_samples(
    imitate: Callable[[float], dict[str, str | int]],
) -> None:
    with load("truepath.trackers", NAME)(**imitate(0.2)) as tracker:
        tracker.start(50.0)
        numbers, places = [], []
        while len(numbers) < 300:
            block = tracker.read(2.0)
            numbers += block.sequence.tolist()
            places += block.position_mm.tolist()
        tracker.stop()
        rest = len(tracker.read(0.0))
        health = tracker.health
    assert health.crc_errors > 20
    assert health.lost_samples >= numbers[-1] + 1 - len(numbers) - rest
    assert np.ptp(places, axis=0).max() < 0.1


def test_a_driver_that_is_not_installed_is_named() -> None:
    with pytest.raises(BadInput, match=NAME):  # among those that are
        load("truepath.trackers", "nobody")
    assert NAME in find_plugins("truepath.trackers")


def test_it_measures_by_the_settings_alone(
    rig: Rig, options: dict[str, str | int], tmp_path: Path
) -> None:
    file = tmp_path / "truepath.toml"
    file.write_text(
        f'tracker_driver = "{NAME}"\n'
        "[tracker_options]\n"
        f'host = "{options["host"]}"\n'
        f"port = {options['port']}\n"
        "reply_timeout_s = 2.0\n"
        "[motion_options]\n"
        f'host = "{rig.motion_options["host"]}"\n'
        f"port = {rig.motion_options['port']}\n"
    )
    run_file = tmp_path / "run.sqlite"
    closed = measure(file, run_file)
    run = open_run(run_file)
    assert closed.lost_samples == 0
    assert "Othermake LT-50 4711" in run.provenance["tracker"]
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert np.median(np.diff(run.tracker.device_time_s)) == pytest.approx(0.02)
    # Right-handed, in mm and s: the lines are found, and each is as long as it was.
    passes = align(run).passes
    assert [p.row for p in passes] == [1, 2, 3, 4]
    with pytest.raises(SimulatorError, match="GST/1"):  # it is another protocol
        read_recorded_run(run_file)


def measure(settings_file: Path, run_file: Path) -> RunClosed:
    settings, content = load_settings(settings_file), load_machine("demo")
    content["tracker"]["rate_hz"] = 50.0
    machine = machine_from_json(content)
    config = CellConfig(
        settings.tracker_driver,
        settings.tracker_options,
        settings.motion_driver,
        settings.motion_options,
        CALM,
    )
    cell = Cell(config)
    cell.start()
    try:
        cell.connect()
        rate_hz = machine.tracker.rate_hz
        cell.begin(
            MeasurementOrder("theirs", str(run_file), machine, CORNERS, rate_hz=rate_hz)
        )
        deadline_s = time.monotonic() + 50.0
        while time.monotonic() < deadline_s:
            for event in cell.poll(0.1):
                assert not isinstance(event, FaultReported), event
                if isinstance(event, RunClosed):
                    return event
        raise AssertionError("the Run was not closed")
    finally:
        cell.close()
