"""Estimates constructed from known numbers, and what is found in them."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from truepath.estimation.problem.noise import NoiseModel
from truepath.estimation.solve import batch
from truepath.estimation.solve.extrapolation import full_travel
from truepath.files.bundle.run import RunSummary
from truepath.files.earlier.result_file import CalibrationResult, result_from_json
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise
from truepath.numerics.rigid import RigidTransform
from truepath.results.analysis import analyse
from truepath.results.result_json import result_json
from truepath.results.result_summary import Provenance, state_findings
from truepath_simulators.machine_file import load_machine

AXES = (
    LinearAxis("X", -200.0, 300.0),  # zero inside the travel
    LinearAxis("Y", 10.0, 400.0),  # zero outside: the lowest position stands in
    LinearAxis("Z", 0.0, 310.0),
)
TRAVEL = np.array([(axis.low, axis.high) for axis in AXES]).T
ONE_TARGET = (Target("", "tool", (20.0, 30.0, -150.0)),)
THREE_TARGETS = (
    Target("short", "tool", (20.0, 30.0, -150.0)),
    Target("long", "tool", (20.0, 30.0, -250.0)),
    Target("aside", "tool", (120.0, -40.0, -150.0)),
)
LINES, CELLS = 12, 240
TRAVEL_MM = 200.0  # of recordings: the shorter, the fewer parameters has a result


def build_model_of(targets):
    machine = Machine("bench mill", ("X",), ("Y", "Z"), AXES, targets, TrackerNoise())
    offsets = np.array([t.offset_mm for t in targets])
    model, merged = build_identifiable_model(machine, offsets, knot_spacing_mm=90.0)
    # Millimetres and radians differ in size as they do in a machine.
    size = np.array([1e-2 if p.unit == "mm" else 4e-5 for p in model.parameters])
    return model, tuple(map(str, merged)), size


@pytest.fixture(scope="session")
def construct():
    def made(targets=ONE_TARGET, seed=5):
        rng = np.random.default_rng(seed)
        model, merged, size = build_model_of(targets)
        spread = rng.standard_normal((model.size, model.size + 5)) * size[:, None]
        residual = 1e-3 * rng.standard_normal((CELLS, 3))
        across = np.linalg.norm(residual[:, 1:], axis=1)
        line = np.repeat(np.arange(1, LINES + 1), CELLS // LINES)
        place = rng.uniform(*TRAVEL, (CELLS, 3))
        rms = float(np.sqrt(np.mean(residual**2)))
        residuals = batch.Residuals(residual, across, line, place, rms, 1e-3)
        theta = size * rng.standard_normal(model.size)
        told = batch.Observability(model.size + 20, model.size, merged), "none", False
        known = model, theta, 1e-4 * spread @ spread.T, {"EXX": 2.5}
        noise = NoiseModel((1.1, 0.9), (0.2, 0.3, 0.3), 1.5, 2e-4)
        pose = RigidTransform(np.eye(3), np.array([900.0, 100.0, -200.0]))
        about = 1e-6 * np.eye(6), np.array([50.0, 200.0, 0.0]), TrackerNoise(), 1_100.0
        samples, rows = (CELLS, 9_000, 10_000), frozenset(range(1, LINES + 1))
        run = batch.RunEstimate(noise, pose, *about, residuals, *samples, rows)
        return batch.Estimate(*known, *told, (run,), full_travel(model.machine))

    return made


def change_run(estimate, **changed):
    return replace(estimate, runs=(replace(estimate.runs[0], **changed),))


@pytest.fixture(scope="session")
def estimate(construct):
    return construct()


@pytest.fixture(scope="session")
def provenance():
    feeds, warm = (2500.0, 10_000.0), {"X": (19.9, 20.1)}
    told = LINES, feeds, 300.0, 10_000, warm, {"source": "monday.zip"}
    run = RunSummary("monday", "otf", "0" * 64, *told)
    return Provenance((run,), "9.9", datetime(2026, 3, 7, 8, 30, tzinfo=UTC))


@pytest.fixture(scope="session")
def found(estimate, provenance):
    return state_findings(estimate, provenance)


@pytest.fixture(scope="session")
def loaded(estimate):
    return as_loaded(estimate)


def as_loaded(estimate):
    return CalibrationResult(estimate.model, estimate.theta, estimate.covariance)


@pytest.fixture
def travel_points(rng):
    return rng.uniform(*TRAVEL, (60, 3))


@pytest.fixture(scope="session")
def across_only(construct):
    plain = replace(construct(), perpendicular_only=True)
    return change_run(plain, noise=replace(plain.runs[0].noise, along_sigma_mm=np.inf))


def load_small():
    content = load_machine("demo")
    for axis in content["axes"].values():
        axis["max_mm"] = TRAVEL_MM
    return content


def shorten(content):
    """Let straight axes travel a third, in the middle of what they could."""
    for axis in content["axes"].values():
        if "min_mm" in axis:
            third = round((axis["max_mm"] - axis["min_mm"]) / 3.0, 1)
            axis["min_mm"] += third
            axis["max_mm"] -= third
    return content


@pytest.fixture(scope="session")
def calibrated(record):
    run, _ = record(1, rows=24, travel_mm=TRAVEL_MM)
    return result_from_json(json.loads(json.dumps(result_json(analyse(run)))))
