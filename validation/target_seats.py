"""Five-axis machines whose targets do not sit where they are stated.

Chains, travels, places of axes and targets are drawn; each target is off in all three
directions by itself. Judged is the error of the first target on the tool, as it sits.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from document import table, write_section
from recordings import draw_specification, run_of

from truepath.alignment.align import align_all
from truepath.estimation.solve.batch import estimate
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.numerics.rigid import cross_matrix
from truepath.planning.default_path import default_path
from truepath_drivers.interfaces.records import Path
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import Recording

MACHINES, FIRST_SEED, POINTS, GRID = 20, 1, 200, 300
OFF_MM = (0.005, 0.02, 0.1, 3.0)
FEED_MM_MIN = 6000.0
STANDSTILL, ON_THE_FLY = "standstill", "on the fly"
CHAINS = ("w-C-A-b-Y-X-Z-t", "w-C-b-X-Y-Z-B-t", "w-b-X-Y-Z-C-B-t", "w-B-b-X-Y-Z-A-t")
SUMMARY = ("before µm", "left µm", "worst machine µm", "inside 2u", "worst machine")


@dataclass(frozen=True)
class Outcome:
    """Mean lengths over the volume in µm, and the share of components inside 2u."""

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
        "tracker": {"stands_on": "base", "specification": draw_specification(seed)},
    }


def judge(seed: int, off_mm: float) -> Outcome:
    program = drive_usually(seed, STANDSTILL)
    made = record_seated(seed, off_mm, program, STANDSTILL)
    run = run_of(made)
    (seen,) = align_all([run], [run.name])
    found = estimate(build_run_models(run.machine, [seen.at]), [seen])
    return judge_map(seed, made, found)


def drive_usually(seed: int, mode: str) -> Program:
    content = draw_machine(seed)
    if mode == STANDSTILL:
        machine = parse_machine(content)
        return paths.turning_points(machine, seed, POINTS, dwell_s=0.6)
    machine = machine_from_json(content)
    return follow(default_path(machine, FEED_MM_MIN, seed=seed))


def follow(path: Path) -> Program:
    feed_mm_s = path.feed_mm_min / 60.0
    return Program(path.position, feed_mm_s, path.dwell_s, path.target)


def record_seated(
    seed: int,
    off_mm: float,
    program: Program,
    mode: str = ON_THE_FLY,
    hidden: Sequence[HiddenEffect] = (),
    sitting: int = 0,
) -> Recording:
    """Return a recording of a machine whose targets are off.

    sitting : how often the targets were seated and the tracker put up before
    """
    stated = draw_machine(seed)
    rng = np.random.default_rng([seed, 6, sitting])
    seated = copy.deepcopy(stated)
    for target in seated["targets"].values():
        shift = off_mm * rng.uniform(-1.0, 1.0, 3)
        target["offset_mm"] = (np.array(target["offset_mm"]) + shift).tolist()
    setting = synthetic.Setting(seed, hidden=tuple(hidden), sensors=False)
    short = "standstill" if mode == STANDSTILL else "otf"
    made = synthetic.record(seated, program, seed + 10_000 * sitting, short, setting)
    return replace(made, content=stated)


def judge_map(seed: int, made: Recording, found: EstimatedModel) -> Outcome:
    """Compare the error of the first target as it sits with what was found."""
    truth, stated = made.truth, parse_machine(made.content)
    q = np.random.default_rng([seed, 7]).uniform(
        stated.low, stated.high, (GRID, len(stated.low))
    )
    place = perfect(stated).nominal_point_mm(q, stated.reflector("T1"))
    actual = truth.point_mm(q, truth.machine.reflector("T1"))
    still = make_standstill(machine_from_json(dict(made.content)), q)
    maps = build_volumetric_map(found.model)
    before = remove_rigid_motion(place, actual - place)
    left = remove_rigid_motion(place, before - maps.error_mm(still, found.theta))
    inside = np.abs(left) < 2.0 * maps.sigma_mm(still, found.covariance)
    mean = [1e3 * float(np.linalg.norm(v, axis=1).mean()) for v in (before, left)]
    return Outcome(*mean, float(inside.mean()))


def remove_rigid_motion(place: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the error without the rigid motion of the whole volume."""
    turns = cross_matrix(place - place.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    motions = np.concatenate([shifts, turns], axis=2).reshape(-1, 6)
    fit, *_ = np.linalg.lstsq(motions, error.ravel(), rcond=None)
    return error - (motions @ fit).reshape(error.shape)


def summarize(outcomes: Sequence[Outcome]) -> list[str]:
    """Return cells: what was there and what is left, and the shares inside 2u."""
    left = [o.left for o in outcomes]
    inside = [o.inside for o in outcomes]
    return [
        f"{np.mean([o.before for o in outcomes]):.1f}",
        f"{np.mean(left):.2f}",
        f"{np.max(left):.2f}",
        f"{np.mean(inside):.1%}",
        f"{np.min(inside):.1%}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    options, _ = parser.parse_known_args()
    seeds = range(options.first_seed, options.first_seed + options.machines)
    rows: list[list[str]] = []
    for off_mm in OFF_MM:
        outcomes = [judge(seed, off_mm) for seed in seeds]
        rows.append([f"{1e3 * off_mm:g} µm", *summarize(outcomes)])
        print(rows[-1], flush=True)
    write_section("target-seats", table(["each target off by up to", *SUMMARY], rows))


if __name__ == "__main__":
    main()
