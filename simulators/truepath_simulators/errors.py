"""Errors of the simulators' input."""

from __future__ import annotations


class SimulatorError(ValueError):
    """A machine, scenario or fault that cannot be simulated; the text says why."""
