"""What plans foretell against what is reached: twenty machines of random motion.

Chain, travels, tool, highest feed, acceleration, jerk, noise and the tracker's place
are drawn; each machine is planned for two and a half minutes, driven once, estimated
and held against its exact truth.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from document import table, write_section
from judging import study
from recordings import random_air, random_content

from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.workspace import Workspace
from truepath.planning.plan import Plan, make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath_drivers.interfaces.records import Path
from truepath_simulators.machine.tracker_head import random_pose
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

# Machines of lower seeds were looked at while the method was made.
FIRST_SEED = 1001
MACHINES, MINUTES = 20, 2.5


@dataclass(frozen=True)
class Outcome:
    """One machine; root mean square lengths over the volume, in mm."""

    seed: int
    chain: str
    highest_feed_mm_min: float
    feeds_mm_min: tuple[float, ...]
    foretold: float
    stated: float
    left: float


def outcome(seed: int) -> Outcome:
    rng = np.random.default_rng([seed, 7])
    motion = {
        "max_feed_mm_min": float(rng.choice([6e3, 10e3, 16e3, 30e3])),
        "acceleration_mm_s2": float(rng.choice([800.0, 1500.0, 3000.0])),
        "jerk_mm_s3": float(rng.choice([3e4, 1e5])),
    }
    content = random_content(seed) | {"motion": motion}
    pose = random_pose(parse_machine(content), seed)
    x, y, z = pose.position_mm.tolist()
    workspace = Workspace(tracker_mm=(x, y, z))
    order = PlanRequirements(minutes=MINUTES, workspace=workspace)
    plan = make_plan(machine_from_json(content), order)
    limits = Limits(motion["acceleration_mm_s2"], motion["jerk_mm_s3"])
    setting = synthetic.Setting(air=random_air(seed), limits=limits, pose=pose)
    program = program_of(plan)
    done = study(synthetic.record(content, program, seed, "otf", setting))
    rms = done.within.rms_length
    return Outcome(
        seed,
        content["kinematic_chain"],
        motion["max_feed_mm_min"],
        tuple(sorted(set(60.0 * program.feed_mm_s[1:]))),
        plan.forecast.volumetric_sigma_mm,
        rms(done.sigma_mm),
        rms(done.left_mm),
    )


def program_of(plan: Plan) -> Program:
    """Return the path of a plan, as the controller is told."""
    path = plan.commanded
    assert isinstance(path, Path)  # noqa: S101 (lines make a path)
    return Program(path.position, path.feed_mm_min / 60.0, path.dwell_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    options, _ = parser.parse_known_args()
    seeds = range(options.first, options.first + options.machines)
    outcomes = [outcome(seed) for seed in seeds]
    write_section("forecasts", _table(outcomes))


def _table(outcomes: list[Outcome]) -> str:
    rows = [
        [
            f"{o.seed}: {o.chain}",
            f"{o.highest_feed_mm_min:.0f}",
            f"{min(o.feeds_mm_min):.0f} to {max(o.feeds_mm_min):.0f}",
            f"{1e3 * o.foretold:.2f}",
            f"{1e3 * o.stated:.2f}",
            f"{1e3 * o.left:.2f}",
            f"{o.foretold / o.left:.2f}",
        ]
        for o in outcomes
    ]
    ratio = float(np.median([o.foretold / o.left for o in outcomes]))
    rows.append(["**median**", *[""] * 5, f"**{ratio:.2f}**"])
    head = [
        "machine",
        "highest feed, mm/min",
        "feeds of the plan",
        "foretold µm",
        "stated µm",
        "left µm",
        "foretold / left",
    ]
    return table(head, rows)


if __name__ == "__main__":
    main()
