"""Recordings of simulated machines as the product receives them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.tracker_noise import TrackerSpecification
from truepath.motion.configurations import Configurations
from truepath.planning.default_path import default_path
from truepath_drivers.interfaces.records import Path, TemperatureSamples, TrackerSamples
from truepath_simulators.machine.tracker_head import Air
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.recording import Recording

CHAINS = ("w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-Y-b-X-Z-t", "w-X-Y-b-Z-t", "w-Z-b-Y-X-t")


TYPICAL = asdict(TrackerSpecification())
PERFECT: dict[str, float] = {}  # as the papers simulate their tracker


def draw_specification(seed: int) -> dict[str, float]:
    """Draw a specification of half to twice what is typical, each key by itself."""
    rng = np.random.default_rng([seed, 3])
    return {key: size * 2.0 ** rng.uniform(-1.0, 1.0) for key, size in TYPICAL.items()}


def machine_content(
    chain: str,
    travel_mm: tuple[float, float, float],
    tool_mm: tuple[float, ...],
    specification: Mapping[str, float] = TYPICAL,
) -> dict[str, Any]:
    """Return the content of machine.json; travels begin at 0.

    specification : what the tracker may be off by, and is
    """
    axes = {
        name: {"type": "linear", "min_mm": 0.0, "max_mm": float(length)}
        for name, length in zip("XYZ", travel_mm, strict=True)
    }
    return {
        "schema": "machine/1",
        "name": "validation",
        "kinematic_chain": chain,
        "axes": axes,
        "tool_offset_mm": list(tool_mm),
        "tracker": {
            "range_sigma_um": 1.0,
            "range_ppm": 0.3,
            "angle_sigma_urad": 3.0,
            "transverse_sigma_um": 4.0,
            "rate_hz": 500,
            "specification": dict(specification),
        },
    }


def random_content(seed: int) -> dict[str, Any]:
    """Draw chain, travels (250 to 900 mm), tool of a machine and its tracker."""
    rng = np.random.default_rng([seed, 1])
    x, y, z = np.round(rng.uniform(250.0, 900.0, 3), 0)
    tool = (*np.round(rng.uniform(-60.0, 60.0, 2), 1), -round(rng.uniform(80, 250), 1))
    chain = CHAINS[rng.integers(len(CHAINS))]
    return machine_content(chain, (x, y, z), tool, draw_specification(seed))


def random_air(seed: int) -> Air:
    """Draw how much of the noise is correlated in time, and for how long."""
    rng = np.random.default_rng([seed, 2])
    return Air(float(rng.uniform(0.1, 0.3)), float(rng.uniform(0.5, 2.0)))


def plan_program(content: dict[str, Any], feed_mm_min: float, lines: int) -> Program:
    """Return the product's own path for a machine, as the controller is told."""
    machine = machine_from_json(dict(content), file="machine.json")
    path = default_path(machine, feed_mm_min, lines=lines)
    return Program(path.position, path.feed_mm_min / 60.0, path.dwell_s)


def run_of(recording: Recording) -> Run:
    machine = machine_from_json(dict(recording.content), file="machine.json")
    samples = TrackerSamples(
        np.arange(len(recording)),
        recording.time_s,
        recording.position_mm,
        recording.status,
    )
    told = recording.temperatures
    celsius = None
    if told is not None:
        celsius = TemperatureSamples(told.names, told.time_s, told.celsius)
    commanded = _read_commanded(recording, machine)
    return Run("validation", machine, commanded, samples, celsius)


def duration_s(recording: Recording) -> float:
    """Return how long the machine was under way, dwells included."""
    return float(recording.time_s[-1] - recording.time_s[0])


def _read_commanded(recording: Recording, machine: Machine) -> Path | Configurations:
    program = recording.program
    if recording.mode == "standstill":
        return Configurations(
            machine.axis_names, program.position, program.dwell_s, program.target
        )
    return Path(
        machine.axis_names,
        program.position,
        program.feed_mm_s * 60.0,
        program.dwell_s,
        program.target,
    )


def papers_program(content: dict[str, Any], feed_mm_min: float) -> Program:
    """Return a path as that of sanders-2023.

    Edges, face and space diagonals of the travel, and straight lines through its
    middle: nearly all of them corner to corner.
    """
    machine = parse_machine(content)
    corners = paths.corner_path(machine, feed_mm_min)
    low, high = corners.position.min(axis=0), corners.position.max(axis=0)
    unit = np.array([[0, 0.5, 0.5], [1, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 1, 0.5]])
    unit = np.vstack([unit, [[0.5, 0.5, 0], [0.5, 0.5, 1]]])
    position = np.vstack([corners.position, np.round(low + unit * (high - low), 4)])
    n = len(position)
    return Program(
        position, np.full(n, feed_mm_min / 60.0), np.full(n, corners.dwell_s[0])
    )
