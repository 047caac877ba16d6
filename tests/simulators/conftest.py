"""Machines for the tests of the simulators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from simulators.machine_file import MachineFile, parse_machine
from simulators.scenario import load_machine


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20_240_607)


@pytest.fixture
def demo() -> dict[str, Any]:
    return load_machine("demo")


@pytest.fixture
def machine(demo: dict[str, Any]) -> MachineFile:
    return parse_machine(demo)
