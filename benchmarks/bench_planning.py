"""Planned measurements against corner paths and random points; the plain search too.

Paths are driven by random simulated machines, whose recordings are then estimated as
any measurement is; what is stated and what compensation would leave follow from that.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

from document import table, write_section
from judging import study
from recordings import random_air, random_content

from truepath.estimation.problem.observability import typical_precision_matrix
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import Machine, MotionLimits
from truepath.kinematics.machine.symbols import SQUARENESS
from truepath.kinematics.splines import natural_spline
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.motion_times import Drive, Stops, row_times_s
from truepath.motion.paths.default_points import corner_path
from truepath.motion.workspace import Workspace
from truepath.numerics.design_criteria import IntegratedVariance, find_best_position
from truepath.planning.design_state import DesignState, inverse
from truepath.planning.initial_design import choose_station, start_design
from truepath.planning.next_configuration import (
    PointDesignState,
    next_configuration,
    search_space,
)
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.planner import LegChoice, SearchEffort, SearchRegion
from truepath_drivers.interfaces.records import Path as MachinePath
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic


# What one would write first: no closed forms, no roots, no rank-one shortcuts. The
# covariance after each candidate is computed in full, and the best trace taken.
def best_of_grid(
    covariance: np.ndarray, gram: np.ndarray, rows: np.ndarray, variance: float
) -> tuple[int, float]:
    """Return the best of candidates' rows (n, r, p) and the J that it leaves."""
    identity = np.eye(rows.shape[1])
    left = np.empty(len(rows))
    for k, H in enumerate(rows):
        gain = (
            covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + variance * identity)
        )
        posterior = covariance - gain @ H @ covariance
        left[k] = np.trace(gram @ posterior)
    best = int(np.argmin(left))
    return best, float(left[best])


def dense_search(
    covariance: np.ndarray, gram: np.ndarray, rows: np.ndarray, variance: float
) -> float:
    """Return the largest fall of J among many rows (n, p), all at once."""
    moved = rows @ covariance
    gained = np.einsum("np,np->n", moved @ gram, moved)
    return float((gained / (variance + np.einsum("np,np->n", moved, rows))).max())


DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "planning.md"
FEED, DWELL_S = 6000.0, 0.4
DENSE, RANDOM = 100_000, 200
VARIANCE = 1e-6  # mm², of a coordinate at a standstill


@dataclass(frozen=True)
class Measured:
    """A path as driven: stated rms and mean error left, in mm."""

    stated: float
    left: float


def machine_of(seed: int) -> Machine:
    return machine_from_json(random_content(seed), file="machine.json")


def driven(seed: int, path: MachinePath, *, perpendicular_only: bool) -> Measured:
    """Record a path on the machine of a seed and estimate it."""
    program = Program(path.position, path.feed_mm_min / 60.0, path.dwell_s)
    setting = synthetic.Setting(air=random_air(seed))
    recording = synthetic.record(random_content(seed), program, seed, "otf", setting)
    found = study(recording, perpendicular_only=perpendicular_only)
    return Measured(
        found.within.rms_length(found.sigma_mm), found.within.mean_length(found.left_mm)
    )


def lines(seed: int) -> dict[str, Measured]:
    """Drive the corner path and plans of its time and of half of it."""
    machine = machine_of(seed)
    corners = corner_path(machine, FEED, DWELL_S)
    took_min = float(row_times_s(corners).sum()) / 60.0
    found = {"corners": driven(seed, corners, perpendicular_only=True)}
    for name, minutes, across in (
        ("same time", took_min, True),
        ("half the time", took_min / 2.0, False),
    ):
        request = PlanRequirements(
            minutes=minutes, feeds_mm_min=(FEED,), perpendicular_only=across
        )
        plan = make_plan(machine, request).commanded
        assert isinstance(plan, MachinePath)
        found[name] = driven(seed, plan, perpendicular_only=across)
    return found


def points_needed(seed: int, *, volumetric: bool) -> int:
    """Return how many chosen points reach the J of 200 random ones.

    volumetric : J of the volumetric error; else that of eq. 36, the error motions'
        integrated variances, turns at half the diagonal of the travel
    """
    machine = machine_of(seed)
    # As good as no time to move: points count, not seconds.
    drive = Drive.of(machine.axis_names, 1.0, MotionLimits(acceleration_mm_s2=1e7))
    station_mm = choose_station(machine, Workspace())
    design = start_design(PointDesignState, machine, station_mm, drive, target="")
    if not volumetric:
        design = replace(design, gram=gram_of_motions(design))
    rng = np.random.default_rng(seed)
    low, high = np.array([[axis.low, axis.high] for axis in machine.axes]).T
    goal = np.median(
        [compute_left(design, rng.uniform(low, high, (RANDOM + 1, 3))) for _ in "abcde"]
    )
    region = SearchRegion(low, high, lambda legs: (legs.step != 0.0).any(axis=1))
    choice = LegChoice(design, region, (6e6,), rng, SearchEffort(rounds=0))
    stops = choice.stops(low, RANDOM * 1.01)
    counts = range(1, len(stops))
    return next(
        n for n in counts if compute_left(design, stops.position[: n + 1]) <= goal
    )


def gram_of_motions(design: DesignState) -> np.ndarray:
    """Return G of eq. 36 over all error motions and squarenesses, in mm²."""
    machine, model = design.model.machine, design.model
    reach = 0.5 * np.linalg.norm([axis.high - axis.low for axis in machine.axes])
    gram = np.zeros((model.size, model.size))
    for effect in model.effects:
        part = model.slices[effect.name]
        weight = reach**2 if effect.parameters[0].unit == "rad" else 1.0
        if isinstance(effect, ErrorMotion):
            form = effect.gauge.T @ effect.spline.gram() @ effect.gauge
            gram[part, part] = weight * form / (effect.axis.high - effect.axis.low)
        elif effect.name in SQUARENESS:
            gram[part, part] = weight
    return gram


def compute_left(design: DesignState, position: np.ndarray) -> float:
    """Return J after standstills at all positions but the first."""
    told = design.information(Stops(position, np.full(len(position), FEED)).legs)
    return design.add(told).integrated_variance


def one_axis(seed: int) -> tuple[float, float, float]:
    """Return seconds of the exact optimum, of the dense search, and their J apart."""
    rng = np.random.default_rng(seed)
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, 6))])
    spline = natural_spline(knots)
    known = IntegratedVariance(
        np.diag(rng.uniform(0.5, 2.0, spline.size)), spline.gram()
    )
    for row in spline.basis(rng.uniform(0.0, knots[-1], int(rng.integers(0, 8)))):
        known = known.update(row, 1e-2)
    exact_s, best = measure_time(
        lambda: find_best_position(known, spline.basis, knots, 1e-2), 5
    )
    at = np.linspace(0.0, knots[-1], DENSE)

    def search() -> float:
        return dense_search(known.covariance, known.gram, spline.basis(at), 1e-2)

    dense_s, drop = measure_time(search, 3)
    return exact_s, dense_s, (best.drop - drop) / known.integrated_variance


def next_point(machine: Machine, intervals: int, grid: int) -> tuple[float, ...]:
    """Return parameters, seconds of ours and of the grid, and the fall of J, ours/grid.

    All three coordinates of the target are measured; ten points are known already.
    """
    offsets = np.array([target.offset_mm for target in machine.targets])
    model, _ = build_identifiable_model(machine, offsets, intervals=intervals)
    known = IntegratedVariance(
        inverse(typical_precision_matrix(model)), compute_volumetric_gram(model)
    )
    axes = search_space(model)

    def rows(position: np.ndarray) -> np.ndarray:
        return model.jacobian(make_standstill(machine, position))

    for row in rows(axes.draw(10, seed=1)):
        known = known.update(row, VARIANCE)
    ours_s, best = measure_time(
        lambda: next_configuration(known, rows, axes, VARIANCE), 3
    )
    ticks = [np.linspace(axis.low, axis.high, grid) for axis in machine.axes]
    places = np.stack([g.ravel() for g in np.meshgrid(*ticks)], axis=1)

    def search() -> float:
        _, after = best_of_grid(known.covariance, known.gram, rows(places), VARIANCE)
        return known.integrated_variance - after

    grid_s, drop = measure_time(search, 1)
    return model.size, ours_s, grid_s, best.drop / drop


def ten_minutes(seed: int) -> float:
    machine = machine_of(seed)
    seconds, _ = measure_time(
        lambda: make_plan(machine, PlanRequirements(minutes=10.0)), 1
    )
    return seconds


def measure_time(function: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Return the least time of some calls, and what the last returned."""
    times, value = [], None
    for _ in range(repeats):
        begin = time.perf_counter()
        value = function()
        times.append(time.perf_counter() - begin)
    return min(times), value


def lines_table(machines: int) -> str:
    found = [lines(seed) for seed in range(1, machines + 1)]
    rows = []
    for name, said in (
        ("corner path, across only", "corners"),
        ("planned, across only, same time", "same time"),
        ("planned, with the direction of travel, half the time", "half the time"),
    ):
        stated = [one[said].stated for one in found]
        error = [one[said].left for one in found]
        ratios = [
            np.median([one[said].stated / one["corners"].stated for one in found]),
            np.median([one[said].left / one["corners"].left for one in found]),
        ]
        values = [1e3 * np.median(stated), 1e3 * np.median(error), *ratios]
        rows.append([name, *(f"{v:.2f}" for v in values)])
    head = [
        f"{machines} machines, medians",
        "stated u, µm",
        "error left, µm",
        "stated, of the corner path's",
        "left, of the corner path's",
    ]
    return table(head, rows)


def search_table(machines: int) -> str:
    axis = np.array([one_axis(seed) for seed in range(20)])
    five = machine_from_json(load_machine("trunnion"), file="machine.json")
    rows = [
        [
            "best place on one axis",
            7,
            f"{1e3 * np.median(axis[:, 0]):.2f} ms",
            f"{1e3 * np.median(axis[:, 1]):.1f} ms, {DENSE:,} places",
            f"{np.median(axis[:, 1] / axis[:, 0]):.0f} x faster; J apart by "
            f"{np.abs(axis[:, 2]).max():.0e} at most",
        ]
    ]
    for name, machine, intervals, grid in (
        ("next configuration, 3 axes", machine_of(1), 16, 15),
        ("next configuration, 5 axes", five, 7, 5),
    ):
        size, ours_s, grid_s, gain = next_point(machine, intervals, grid)
        places = grid ** len(machine.axes)
        rows.append(
            [
                name,
                size,
                f"{1e3 * ours_s:.0f} ms",
                f"{grid_s:.1f} s, {places:,} places",
                f"{grid_s / ours_s:.0f} x faster; J falls {gain:.3f} x as far",
            ]
        )
    plans_s = [ten_minutes(seed) for seed in range(1, 4)]
    rows.append(["a 10-minute path", "", f"{max(plans_s):.0f} s", "", "slowest of 3"])
    for name, volumetric in (("eq. 36", False), ("of the volume", True)):
        needed = [
            points_needed(seed, volumetric=volumetric)
            for seed in range(1, machines + 1)
        ]
        rows.append(
            [
                f"standstills that reach the J ({name}) of random ones",
                "",
                f"{np.median(needed):.0f}",
                RANDOM,
                f"median of {machines} machines, {min(needed)} to {max(needed)}",
            ]
        )
    return table(["", "parameters", "ours", "plain", ""], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--write", action="store_true", help=f"into {DOCUMENT.name}")
    options = parser.parse_args()
    for name, make in (("search", search_table), ("lines", lines_table)):
        text = make(options.machines)
        if options.write:
            write_section(name, text, DOCUMENT)
        else:
            print(f"\n{text}\n", flush=True)


if __name__ == "__main__":
    main()
