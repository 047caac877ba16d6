"""Machines for the tests of the simulators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from truepath_simulators.machine_file import MachineFile, parse_machine
from truepath_simulators.scenario import load_machine


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20_240_607)


@pytest.fixture
def demo() -> dict[str, Any]:
    return load_machine("demo")


@pytest.fixture
def machine(demo: dict[str, Any]) -> MachineFile:
    return parse_machine(demo)


@pytest.fixture(scope="module")
def two_target_content() -> dict[str, Any]:
    """Return the demonstration machine with two targets, 150 mm apart."""
    content = load_machine("demo")
    offset_mm = content.pop("tool_offset_mm")
    beside_mm = [offset_mm[0] + 150.0, *offset_mm[1:]]
    content["targets"] = {
        "T1": {"on": "tool", "offset_mm": offset_mm},
        "T2": {"on": "tool", "offset_mm": beside_mm},
    }
    return content
