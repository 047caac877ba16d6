"""Machines for the tests of the simulators."""

import pytest

from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine


@pytest.fixture
def demo():
    return load_machine("demo")


@pytest.fixture
def machine(demo):
    return parse_machine(demo)
