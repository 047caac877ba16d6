"""Machines, Runs and bundles that the measurement tests start from."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path as FilePath

import numpy as np
import pytest

from app.kinematics.machine import LinearAxis, Machine, Target, TrackerNoise
from app.measurement.bundle import write_bundle
from app.measurement.run import DirectMeasurement, Run
from drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture(autouse=True)
def no_thread_is_left_over() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    left = [t.name for t in threading.enumerate() if t not in before and not t.daemon]
    assert not left


@pytest.fixture
def mill() -> Machine:
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
    rows = [(10, 10, -10), (110, 10, -10), (110, 60, -10), (10, 60, -40)]
    n = len(rows)
    return Path(
        ("X", "Y", "Z"),
        np.array(rows, float),
        np.full(n, 6000.0),
        np.array([0.1, 0.2, 0.1, 0.3]),
    )


@pytest.fixture
def stream(rng: np.random.Generator) -> TrackerSamples:
    n = 400
    time_s = 1234.5 + np.arange(n) * 0.002
    status = np.zeros(n, np.int64)
    status[50:55] = 3
    position = rng.normal(0.0, 500.0, (n, 3))
    position[50:53] = np.nan
    return TrackerSamples(np.arange(n, dtype=np.int64), time_s, position, status)


@pytest.fixture
def run(mill: Machine, square: Path, stream: TrackerSamples) -> Run:
    return Run(
        "monday",
        mill,
        square,
        stream,
        temperature=TemperatureSamples(
            ("X", "air"),
            np.array([1234.5, 1235.0]),
            np.array([[20.1, 21.0], [20.2, 21.1]]),
        ),
        reference=(
            DirectMeasurement(
                "EXX", "+", "um", np.array([0.0, 100.0]), np.array([0.0, 1.5])
            ),
            DirectMeasurement("EAX", "-", "urad", np.array([50.0]), np.array([2.25])),
        ),
    )


@pytest.fixture
def bundle(run: Run, tmp_path: FilePath) -> FilePath:
    folder = tmp_path / "bundle"
    write_bundle(run, folder)
    return folder
