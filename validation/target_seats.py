"""Twenty five-axis machines whose targets do not sit where they are stated.

Chains, travels, places of axes and targets are drawn; each target is off in all three
directions by itself. Judged is the error of the first target on the tool, as it sits.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from document import table, write_section

from app.alignment.align import align
from app.estimation.batch import estimate
from app.files.machine_file import machine_from_json
from app.files.run import Run
from app.kinematics.coarse_model import build_run_models
from app.kinematics.conditions import make_standstill
from app.kinematics.volumetric_map import build_volumetric_map
from app.motion.configurations import Configurations
from app.numerics.rigid import cross_matrix
from drivers.interfaces.records import TrackerSamples
from simulators import synthetic, turning_paths
from simulators.machine_file import parse_machine
from simulators.truth_machine import perfect

MACHINES, POINTS, GRID = 20, 200, 300
OFF_MM = (0.005, 0.02, 0.1, 3.0)
CHAINS = ("w-C-A-b-Y-X-Z-t", "w-C-b-X-Y-Z-B-t", "w-b-X-Y-Z-C-B-t", "w-B-b-X-Y-Z-A-t")


@dataclass(frozen=True)
class Outcome:
    """Mean lengths over the volume in µm, and the share of components inside 2u."""

    off_mm: float
    chain: str
    before: float
    left: float
    inside: float


def draw_machine(seed: int) -> dict[str, Any]:
    """Return the content of machine.json: chain, travels, axes and targets drawn."""
    rng = np.random.default_rng([seed, 5])
    chain = CHAINS[seed % len(CHAINS)]
    travel = np.round(rng.uniform(350.0, 700.0, 3), 1)
    centre = np.array([*travel[:2] / 2.0, -200.0]) + rng.uniform(-30.0, 30.0, 3)
    axes: dict[str, Any] = {
        name: {"type": "linear", "min_mm": 0.0, "max_mm": float(length)}
        for name, length in zip("XYZ", travel, strict=True)
    }
    table_side, tool_side = chain.split("-b-")
    for name in "ABC":
        if name in chain:
            low, high = (0.0, 360.0) if name == "C" else (-100.0, 40.0)
            on_table = name in table_side
            origin = centre if on_table else rng.uniform(-20.0, 20.0, 3)
            axes[name] = {
                "type": "rotary",
                "min_deg": low,
                "max_deg": high,
                "origin_mm": np.round(origin, 2).tolist(),
            }
    tool = np.array([0.0, 0.0, -rng.uniform(150.0, 250.0)])
    targets: dict[str, Any] = {"T1": {"on": "tool", "offset_mm": tool.tolist()}}
    if set(tool_side) & set("ABC"):
        for k, step in enumerate(((70.0, 0.0, 60.0), (0.0, 70.0, 30.0))):
            place = tool + step + rng.uniform(-10.0, 10.0, 3)
            targets[f"T{k + 2}"] = {"on": "tool", "offset_mm": place.tolist()}
    if set(table_side) & set("ABC"):
        for k, turn in enumerate(rng.uniform(-0.4, 0.4, 3)):
            angle, reach = turn + 2.1 * k, rng.uniform(90.0, 160.0)
            step = (reach * np.cos(angle), reach * np.sin(angle), 40.0 + 60.0 * k)
            place = (centre + step).tolist()
            targets[f"W{k + 1}"] = {"on": "workpiece", "offset_mm": place}
    return {
        "schema": "machine/1",
        "name": f"drawn {seed}",
        "kinematic_chain": chain,
        "axes": axes,
        "targets": targets,
        "tracker": {"stands_on": "base"},
    }


def judge(seed: int, off_mm: float) -> Outcome:
    """Measure a machine with its targets off, estimate, and compare with the truth."""
    stated = draw_machine(seed)
    rng = np.random.default_rng([seed, 6])
    seated = copy.deepcopy(stated)
    for target in seated["targets"].values():
        shift = off_mm * rng.uniform(-1.0, 1.0, 3)
        target["offset_mm"] = (np.array(target["offset_mm"]) + shift).tolist()
    program = turning_paths.turning_points(
        parse_machine(stated), seed, POINTS, dwell_s=0.6
    )
    made = synthetic.record(seated, program, seed, "standstill")
    machine = machine_from_json(stated)
    samples = TrackerSamples(
        np.arange(len(made)), made.time_s, made.position_mm, made.status
    )
    points = Configurations(
        machine.axis_names, program.position, program.dwell_s, program.target
    )
    seen = align(Run("seats", machine, points, samples))
    found = estimate(build_run_models(machine, [seen.at.offset_mm]), [seen])
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    q = np.random.default_rng([seed, 7]).uniform(low, high, (GRID, len(low)))
    nominal = perfect(parse_machine(stated))
    first = nominal.machine.reflector("T1")
    place = nominal.nominal_point_mm(q, first)
    actual = made.truth.point_mm(q, made.truth.machine.reflector("T1"))
    still, maps = make_standstill(machine, q), build_volumetric_map(found.model)
    before = remove_rigid_motion(place, actual - place)
    told = maps.error_mm(still, found.theta)
    left = remove_rigid_motion(place, before - told)
    inside = np.abs(left) < 2.0 * maps.sigma_mm(still, found.covariance)
    mean = [1e3 * float(np.linalg.norm(v, axis=1).mean()) for v in (before, left)]
    return Outcome(off_mm, machine.chain, *mean, float(inside.mean()))


def remove_rigid_motion(place: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the error without the rigid motion of the whole volume."""
    turns = cross_matrix(place - place.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    motions = np.concatenate([shifts, turns], axis=2).reshape(-1, 6)
    fit, *_ = np.linalg.lstsq(motions, error.ravel(), rcond=None)
    return error - (motions @ fit).reshape(error.shape)


def main() -> None:
    """Judge the machines and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    options, _ = parser.parse_known_args()
    rows: list[list[str]] = []
    for off_mm in OFF_MM:
        outcomes = [judge(seed, off_mm) for seed in range(1, options.machines + 1)]
        left = np.array([o.left for o in outcomes])
        inside = np.array([o.inside for o in outcomes])
        rows.append(
            [
                f"{1e3 * off_mm:g} µm",
                f"{np.mean([o.before for o in outcomes]):.1f}",
                f"{left.mean():.2f}",
                f"{left.max():.2f}",
                f"{inside.mean():.1%}",
                f"{inside.min():.1%}",
            ]
        )
        print(rows[-1], flush=True)
    head = [
        "each target off by up to",
        "before µm",
        "left µm",
        "worst machine µm",
        "inside 2u",
        "worst machine",
    ]
    write_section("target-seats", table(head, rows))


if __name__ == "__main__":
    main()
