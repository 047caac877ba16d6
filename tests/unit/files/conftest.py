"""A Run and its bundle, for the tests of the border."""

import numpy as np
import pytest

from truepath.files.bundle.bundle import write_bundle
from truepath.files.bundle.run import DirectMeasurement, Run
from truepath_drivers.interfaces.records import TemperatureSamples, TrackerSamples


@pytest.fixture
def stream(rng):
    n = 400
    time_s = 1234.5 + np.arange(n) * 0.002
    status = np.zeros(n, np.int64)
    status[50:55] = 3
    position = rng.normal(0.0, 500.0, (n, 3))
    position[50:53] = np.nan
    return TrackerSamples(np.arange(n, dtype=np.int64), time_s, position, status)


@pytest.fixture
def run(mill, square, stream):
    time_s, celsius = np.array([1234.5, 1235.0]), np.array([[20.1, 21.0], [20.2, 21.1]])
    warm = TemperatureSamples(("X", "air"), time_s, celsius)
    scale = np.array([0.0, 100.0]), np.array([0.0, 1.5])
    roll = np.array([50.0]), np.array([2.25])
    straight = DirectMeasurement("EXX", "+", "um", *scale)
    measured = (straight, DirectMeasurement("EAX", "-", "urad", *roll))
    return Run("monday", mill, square, stream, temperature=warm, reference=measured)


@pytest.fixture
def bundle(run, tmp_path):
    folder = tmp_path / "bundle"
    write_bundle(run, folder)
    return folder
