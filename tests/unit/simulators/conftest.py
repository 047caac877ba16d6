"""Machines for the tests of the simulators."""

import pytest

from truepath_simulators import machine_file


@pytest.fixture
def demo():
    return machine_file.load_machine("demo")


@pytest.fixture
def machine(demo):
    return machine_file.parse_machine(demo)
