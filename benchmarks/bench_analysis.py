"""A Run of 500 000 samples: ours against the dense pseudo-inverse of the 2023 paper.

Both start from the same reduced points; ours is timed with reading, alignment and
report as well. Left is the error that compensation with the tables would leave.
"""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path

import numpy as np
import paper_method
from measure import measure, ratio

from truepath.alignment.align import align
from truepath.files.bundle.bundle import read_bundle
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.analysis import analyse
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import write_bundle_files

SEED, ROWS, FEED = 5, 72, 2500.0
SPACING_MM = 22.0


def ours(folder: Path) -> tuple[int, np.ndarray]:
    """Read, align, estimate and report; return samples and the predicted map, mm."""
    run = read_bundle(folder / "bundle")
    estimate = analyse(run).estimate
    at = make_standstill(run.machine, _points(run.machine))
    return len(run.tracker), build_volumetric_map(estimate.model).error_mm(
        at, estimate.theta
    )


def paper(folder: Path) -> tuple[int, np.ndarray]:
    """Solve the reduced points; return their number and the predicted map, mm."""
    seen = pickle.loads((folder / "reduced.pickle").read_bytes())
    tables = paper_method.solve(seen, SPACING_MM)
    machine = seen.at.machine
    at = make_standstill(machine, _points(machine))
    return len(seen), paper_method.error_mm(tables, at)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = _record(folder)
        mine, theirs = measure(ours, folder), measure(paper, folder)
        samples, points = mine.value[0], theirs.value[0]
        print(f"{samples} samples, {points} reduced points")
        for label, cost in (("ours, all of it", mine), ("paper, solve only", theirs)):
            left = _compute_share_left(truth, cost.value[1], folder)
            print(f"{label:18s} {cost}   left {left:6.2%} of the error")
        print(f"ours is {ratio(mine, theirs)}")


def _record(folder: Path) -> np.ndarray:
    content = load_machine("demo")
    content["axes"] = {
        a: {"type": "linear", "min_mm": 0.0, "max_mm": high}
        for a, high in (("X", 800.0), ("Y", 600.0), ("Z", 500.0))
    }
    program = paths.chord_path(parse_machine(content), SEED, ROWS, FEED)
    recording = synthetic.record(content, program, SEED, "otf")
    write_bundle_files(folder / "bundle", recording)
    run = read_bundle(folder / "bundle")
    (folder / "reduced.pickle").write_bytes(pickle.dumps(align(run)))
    return recording.truth.deviation_mm(_points(run.machine))


def _points(machine: Machine) -> np.ndarray:
    low = np.array([a.low + 15.0 for a in machine.linear_axes])
    high = np.array([a.high - 15.0 for a in machine.linear_axes])
    return np.random.default_rng(1).uniform(low, high, (500, 3))


def _compute_share_left(
    truth: np.ndarray, predicted: np.ndarray, folder: Path
) -> float:
    at = _points(read_bundle(folder / "bundle").machine)
    before = _rigid_free(at, truth)
    left = before - _rigid_free(at, predicted)
    mean_before, mean_left = (np.linalg.norm(v, axis=1).mean() for v in (before, left))
    return float(mean_left / mean_before)


def _rigid_free(position: np.ndarray, error: np.ndarray) -> np.ndarray:
    turns = [np.cross(axis, position) for axis in np.eye(3)]
    shifts = [np.tile(axis, (len(position), 1)) for axis in np.eye(3)]
    columns = np.stack([*shifts, *turns], axis=2).reshape(-1, 6)
    fit = np.linalg.lstsq(columns, error.reshape(-1), rcond=None)[0]
    return error - (columns @ fit).reshape(-1, 3)


if __name__ == "__main__":
    main()
