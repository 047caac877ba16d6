"""A knock of the tracker just while it turns from one target to the next.

Machines with rotary axes are measured by the product's own points and path, which come
back to the first target at the end, and by the same without their last block. Where
nothing from before is measured again, seats and locations of axes follow the knock.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from itertools import product

import numpy as np
from disturbed_runs import Outcome, measure
from document import table, write_section
from stream_disturbances import draw_shift_mm, move
from target_seats import (
    FEED_MM_MIN,
    ON_THE_FLY,
    STANDSTILL,
    draw_machine,
    follow,
    record_seated,
)

from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.paths.default_points import default_points
from truepath.planning.default_path import default_path
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.paths import turning_points
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.recording import Recording

FIRST_SEED, MACHINES = 8401, 6
SIZES_UM = (0.0, 20.0, 100.0)
WAYS = {True: "first target again at the end", False: "each target once"}


def plan_usually(seed: int, mode: str) -> Program:
    """Return the product's path, or points with its order of targets."""
    content = draw_machine(seed)
    machine = machine_from_json(content)
    if mode == ON_THE_FLY:
        return follow(default_path(machine, FEED_MM_MIN, seed=seed))
    target = default_points(machine).target
    points = turning_points(parse_machine(content), seed, len(target), dwell_s=0.6)
    position = np.vstack([points.position[:-4], points.position[:4]])
    return replace(points, position=position, target=target)


def find_changes(program: Program) -> list[int]:
    """Return the rows that begin with another target."""
    pairs = zip(program.target, program.target[1:], strict=False)
    return [row for row, (one, next_) in enumerate(pairs, start=1) if one != next_]


def leave_last_block(program: Program) -> Program:
    """Return the program without what comes after the last change."""
    kept = slice(find_changes(program)[-1])
    return Program(
        program.position[kept],
        program.feed_mm_s[kept],
        program.dwell_s[kept],
        program.target[kept],
    )


def knock_between(made: Recording, size_um: float, seed: int) -> Outcome:
    """Analyse a Run whose tracker was knocked while it turned to another target."""
    rng = np.random.default_rng([seed, 9])
    row = int(rng.choice(find_changes(made.program)))

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        late = (made.row >= row)[:, None]
        return move(
            stream, stream.position_mm + late * draw_shift_mm(1e-3 * size_um, rng)
        )

    return measure(made, disturb, seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=FIRST_SEED)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--modes", default="standstill,otf")
    parser.add_argument("--dry", action="store_true", help="write no document")
    options = parser.parse_args()
    modes = {"standstill": STANDSTILL, "otf": ON_THE_FLY}
    rows: list[list[str]] = []
    for name, (comes_back, way) in product(options.modes.split(","), WAYS.items()):
        found: dict[float, list[Outcome]] = {size: [] for size in SIZES_UM}
        for seed in range(options.seed, options.seed + options.machines):
            program = plan_usually(seed, modes[name])
            if not comes_back:
                program = leave_last_block(program)
            made = record_seated(seed, 0.0, program, mode=modes[name])
            for size_um, outcomes in found.items():
                outcomes.append(knock_between(made, size_um, seed))
                print(name, way, seed, size_um, outcomes[-1], file=sys.stderr)
        rows += [[name, way, *summarize(size, each)] for size, each in found.items()]
    head = ["", "plan", "knock", "error left, worst", "inside 2 u", "usable", "right"]
    write = print if options.dry else write_section
    write("knocks-between-targets", table(head, rows))


def summarize(size_um: float, outcomes: list[Outcome]) -> list[str]:
    """Return what became of a knock of one size, over all machines."""
    usable = sum(one.said.startswith("usable") for one in outcomes)
    right = sum(one.is_right for one in outcomes)
    return [
        f"{size_um:.0f} µm",
        f"{np.nanmax([one.share for one in outcomes]):.1%}",
        f"{np.nanmean([one.inside for one in outcomes]):.0%}",
        f"{usable} of {len(outcomes)}",
        f"{right} of {len(outcomes)}",
    ]


if __name__ == "__main__":
    main()
