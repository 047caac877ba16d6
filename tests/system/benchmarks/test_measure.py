"""The yardstick of the benchmarks: a process each, its own memory, its own errors."""

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[3] / "benchmarks"


@pytest.fixture(scope="module")
def measure_module():
    sys.path.insert(0, str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("measure", BENCHMARKS / "measure.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["measure"] = module
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(BENCHMARKS))
    del sys.modules["measure"]


def test_each_call_has_a_process_of_its_own(measure_module):
    first = measure_module.measure(os.getpid)
    second = measure_module.measure(os.getpid)
    assert len({first.value, second.value, os.getpid()}) == 3


def test_peak_memory_is_that_of_the_call_and_not_of_the_parent(measure_module):
    ballast = np.ones(40_000_000)  # 305 MiB in this process
    small = measure_module.measure(np.ones, 10)
    large = measure_module.measure(np.ones, 30_000_000)
    assert ballast.nbytes / 2**20 > small.peak_mib
    assert 200 < large.peak_mib - small.peak_mib < 500


def test_an_error_comes_back_and_a_process_that_dies_is_reported(measure_module):
    with pytest.raises(FileNotFoundError):
        measure_module.measure(os.listdir, "/no/such/folder")
    with pytest.raises(RuntimeError, match="_exit ended with 3"):
        measure_module.measure(os._exit, 3)


def test_the_ratio_is_of_the_baseline_to_the_candidate(measure_module):
    fast = measure_module.Measurement(1.0, 1.0, 100.0, None)
    slow = measure_module.Measurement(8.0, 8.0, 250.0, None)
    assert measure_module.ratio(fast, slow) == "8.0 x faster, 2.5 x less memory"
