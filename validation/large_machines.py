"""Large machines: the error left against the information bound, and coverage.

Gantries up to 30 m, random lines through the whole volume at 24 m/min, and some whose
rack of pieces steps by 8 µm at each metre. Chains, tools, tracker places and the
correlated share of the noise are drawn.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from document import table, write_section
from information_bound import ideal
from judging import Volume
from recordings import CHAINS, machine_content, random_air
from study import study

from app.estimation.knots import join_cells
from simulators import paths, synthetic
from simulators.machine_file import parse_machine
from simulators.truth_machine import join_rack, random_machine

FEED_MM_MIN, STEP_MM = 24_000.0, 0.008


@dataclass(frozen=True)
class World:
    """Machines of one size; step_mm : of the rack at each metre of X, 0 for none."""

    name: str
    travel_mm: tuple[float, float, float]
    lines: int
    machines: int
    step_mm: float = 0.0


WORLDS = (
    World("3 × 1.5 × 1 m", (3000.0, 1500.0, 1000.0), 120, 7),
    World("6 × 2.5 × 1.2 m", (6000.0, 2500.0, 1200.0), 140, 7),
    World("30 × 6 × 4 m", (30_000.0, 6000.0, 4000.0), 110, 1),
    World("6 m, rack joints", (6000.0, 2500.0, 1200.0), 140, 1, STEP_MM),
)


@dataclass(frozen=True)
class Outcome:
    """One machine; root mean square lengths over the volume, in mm.

    bound : what the ideal estimator would leave on average; covered : share of the
        volume inside 2 u; solve_s : alignment and estimate
    """

    before: float
    left: float
    bound: float
    stated: float
    covered: float
    samples: int
    parameters: int
    solve_s: float


def outcome(world: World, seed: int) -> Outcome:
    """Record, estimate and judge one machine."""
    content, air = _content(world, seed), random_air(seed)
    machine = parse_machine(content)
    truth = random_machine(machine, seed)
    if world.step_mm:
        truth = join_rack(truth, "X", seed, world.step_mm)
    program = paths.chord_path(machine, seed, world.lines, FEED_MM_MIN)
    setting = synthetic.Setting(air=air, truth=truth, sensors=False)
    recording = synthetic.record(content, program, seed, "otf", setting)
    begin = time.perf_counter()
    done = study(recording)
    solve_s = time.perf_counter() - begin
    (cells,) = join_cells([done.seen], done.found.model)
    best = ideal(done.within, cells, done.found, recording, air)
    rms = done.within.rms_length
    return Outcome(
        rms(done.truth_mm),
        rms(done.left_mm),
        best.bound_mm,
        rms(done.sigma_mm),
        _inside(done.within, done.left_mm, done.sigma_mm),
        len(recording),
        done.found.model.size,
        solve_s,
    )


def _inside(within: Volume, left_mm: np.ndarray, sigma_mm: np.ndarray) -> float:
    return within.share(np.abs(left_mm) < 2.0 * sigma_mm)


def _content(world: World, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 3])
    tool = (*np.round(rng.uniform(-60.0, 60.0, 2), 1), -round(rng.uniform(80, 250), 1))
    return machine_content(
        CHAINS[rng.integers(len(CHAINS))], world.travel_mm, tuple(tool)
    )


def main() -> None:
    """Judge the machines of every world and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=None)
    parser.add_argument("--world", type=int, default=None)
    options, _ = parser.parse_known_args()
    worlds = WORLDS if options.world is None else [WORLDS[options.world]]
    rows = [_row(world, options.machines or world.machines) for world in worlds]
    head = [
        "machines",
        "samples",
        "before µm",
        "left µm",
        "bound µm",
        "stated µm",
        "left / bound",
        "inside 2u",
    ]
    if options.world is None:
        write_section("large-machines", table(head, rows))


def _row(world: World, machines: int) -> list[str]:
    found: list[Outcome] = []
    for seed in range(1, machines + 1):
        found.append(outcome(world, seed))
        print(world.name, seed, found[-1], flush=True)
    before, left, bound, stated = (
        float(np.sqrt(np.mean([getattr(o, key) ** 2 for o in found])))
        for key in ("before", "left", "bound", "stated")
    )
    row = [
        f"{machines} × {world.name}",
        f"{np.mean([o.samples for o in found]):.0f}",
        f"{1e3 * before:.1f}",
        f"{1e3 * left:.2f}",
        f"{1e3 * bound:.2f}",
        f"{1e3 * stated:.2f}",
        f"{left / bound:.2f}",
        f"{np.mean([o.covered for o in found]):.1%}",
    ]
    print(row, flush=True)
    return row


if __name__ == "__main__":
    main()
