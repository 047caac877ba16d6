"""Axes that warm while they are measured: with their thermometers, and without.

    python validation/thermometers.py --worlds 4 --first-seed 1000 --write

Half of the worlds warm once, half warm and cool again. Each world is recorded once; the
second time its temperatures are left out. What is judged is the map of the machine as
cold as it began, against the exact truth.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from document import table, write_section
from recordings import plan_program, run_of

from truepath.answers.discovery import discover_runs
from truepath.compensation.residual_error import remove_rigid_motion
from truepath.files.bundle.run import Run
from truepath.files.earlier.result_file import result_from_json
from truepath.results.prediction import predict
from truepath_simulators.hidden.structure import ThermalGrowth
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds.synthetic import Setting, record

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "environment.md"
_FEED_MM_MIN, _LINES, _POINTS = 6000.0, 30, 400
_COURSES = {"warms": False, "warms and cools": True}


@dataclass(frozen=True)
class Judged:
    """What is left of the volumetric error, µm, and what is held within 2u."""

    before_um: float
    left_um: float
    covered: float
    is_named: bool


def judge_world(seed: int, *, cools: bool) -> dict[str, Judged]:
    """Return what comes of a world with its thermometers and without."""
    rng = np.random.default_rng(seed)
    content = load_machine("demo")
    program = plan_program(content, _FEED_MM_MIN, _LINES)
    warming = draw_warming(rng, cools=cools)
    recording = record(content, program, seed, setting=Setting(hidden=warming))
    run = run_of(recording)
    points = rng.uniform(*_travel(run), (_POINTS, 3))
    truth_um = 1e3 * recording.truth.deviation_mm(points)
    bare = replace(run, temperature=None)
    cases = {"with thermometers": run, "without": bare}
    axis = warming[0].axis
    return {name: _assess(one, points, truth_um, axis) for name, one in cases.items()}


def draw_warming(rng: np.random.Generator, *, cools: bool) -> tuple[ThermalGrowth, ...]:
    """Return an axis that warms, as by its own work, and cools, as by coolant."""
    axis = str(rng.choice(["X", "Y", "Z"]))
    rise_k = float(rng.uniform(2.0, 5.0) * rng.choice([-1.0, 1.0]))
    coefficient, lag_s = float(rng.uniform(8.0, 14.0)), float(rng.uniform(0.5, 2.0))
    fast_s = float(rng.uniform(30.0, 60.0))
    warm = ThermalGrowth(axis, coefficient, rise_k, fast_s, lag_s)
    if not cools:
        return (warm,)
    slow_s = fast_s * float(rng.uniform(2.0, 4.0))
    return warm, ThermalGrowth(axis, coefficient, -1.2 * rise_k, slow_s, lag_s)


def _assess(run: Run, points: np.ndarray, truth_um: np.ndarray, axis: str) -> Judged:
    found = discover_runs([run])
    told = predict(result_from_json(found.model.content), points)
    before = remove_rigid_motion(points, truth_um)
    left = before - remove_rigid_motion(points, told.error_um)
    named = {(e["name"], e.get("axis")) for e in found.content["effects"]}
    return Judged(
        float(np.linalg.norm(before, axis=1).mean()),
        float(np.linalg.norm(left, axis=1).mean()),
        float((np.abs(left) <= 2.0 * told.uncertainty_um).mean()),
        ("thermal-growth", axis) in named,
    )


def _travel(run: Run) -> tuple[np.ndarray, np.ndarray]:
    axes = run.machine.linear_axes
    return np.array([a.low for a in axes]), np.array([a.high for a in axes])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=12)
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    found: dict[str, list[Judged]] = {}
    for seed in range(given.first_seed, given.first_seed + given.worlds):
        for course, cools in _COURSES.items():
            for name, one in judge_world(seed, cools=cools).items():
                found.setdefault(f"{course}, {name}", []).append(one)
                print(seed, course, name, one, flush=True)
    head = ["", "left of the error (mean, µm)", "worst world, µm", "within 2u", "named"]
    rows = [
        (
            name,
            f"{np.mean([one.left_um for one in each]):.2f}",
            f"{max(one.left_um for one in each):.2f}",
            f"{100 * np.mean([one.covered for one in each]):.0f} %",
            f"{sum(one.is_named for one in each)} of {len(each)}",
        )
        for name, each in found.items()
    ]
    text = table(head, rows)
    print(text)
    if given.write:
        write_section("thermometers", text, DOCUMENT)


if __name__ == "__main__":
    main()
