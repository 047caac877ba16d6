"""Fast machines: lines planned at three feeds, ramps in use, carriages that lean.

Machines are drawn by seed, as are their noise and the tracker's place; none of them was
looked at while the method was made.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from document import table, write_section
from forecasts import FIRST_SEED, program_of
from judging import Study, study
from recordings import random_air, random_content

from truepath.files.bundle.machine_file import machine_from_json
from truepath.motion.workspace import Workspace
from truepath.planning.plan import Plan, make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath_simulators.hidden.drives import InertialBend
from truepath_simulators.machine.tracker_head import random_pose
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.paths import chord_path
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

MACHINES, FAST_MACHINES = 5, 5
FEEDS_MM_MIN = (6000.0, 10_000.0, 16_000.0)
LIMITS = Limits(1500.0, 3e4)
_FASTEST_MM_MIN, _FAST = 40_000.0, Limits(3000.0, 1e5)
_LINES = 80
_BEND_UM, _SWING_HZ = 8.0, 18.0
_ARM_M = 0.3


@dataclass(frozen=True)
class Bench:
    """A machine, and how it is recorded."""

    content: dict[str, Any]
    seed: int
    setting: synthetic.Setting

    @classmethod
    def draw(cls, seed: int, highest_mm_min: float, limits: Limits) -> Bench:
        motion = {
            "max_feed_mm_min": highest_mm_min,
            "acceleration_mm_s2": limits.acceleration_mm_s2,
            "jerk_mm_s3": limits.jerk_mm_s3,
        }
        content = random_content(seed) | {"motion": motion}
        pose = random_pose(parse_machine(content), seed)
        setting = synthetic.Setting(air=random_air(seed), limits=limits, pose=pose)
        return cls(content, seed, setting)

    def plan(self, **order: Any) -> Plan:
        pose = self.setting.pose
        assert pose is not None  # noqa: S101 (it is drawn)
        x, y, z = pose.position_mm.tolist()
        workspace = Workspace(tracker_mm=(x, y, z))
        machine = machine_from_json(self.content)
        return make_plan(machine, PlanRequirements(workspace=workspace, **order))

    def drive(self, program: Program) -> synthetic.Recording:
        return synthetic.record(self.content, program, self.seed, "otf", self.setting)

    def bend(self, frequency_hz: float) -> Bench:
        """Return one whose carriages lean in all directions as they accelerate."""
        rng = np.random.default_rng([self.seed, 8])
        peak_m_s2 = 1e-3 * self.setting.limits.acceleration_mm_s2
        hidden = [
            InertialBend(
                f"E{kind}{axis}",
                _BEND_UM / peak_m_s2 / arm_m * float(rng.uniform(-1.0, 1.0)),
                frequency_hz,
            )
            for axis in "XYZ"
            for kind, arm_m in zip("XYZABC", [1.0] * 3 + [_ARM_M] * 3, strict=True)
        ]
        return replace(self, setting=replace(self.setting, hidden=tuple(hidden)))


def compare_feeds(seed: int) -> list[list[tuple[float, float]]]:
    """Return error left and stated, µm: corner path, planned at it, feeds free."""
    rows: list[list[tuple[float, float]]] = []
    for feed in FEEDS_MM_MIN:
        bench = Bench.draw(seed, feed, LIMITS)
        corners = bench.plan(corner_path=True, feeds_mm_min=(feed,))
        minutes = corners.duration_s / 60.0
        plans = [
            corners,
            bench.plan(minutes=minutes, feeds_mm_min=(feed,)),
            bench.plan(minutes=minutes),
        ]
        done = [study(bench.drive(program_of(plan))) for plan in plans]
        rows.append(
            [(_compute_left_um(each), _compute_stated_um(each)) for each in done]
        )
        print(seed, feed, rows[-1], file=sys.stderr, flush=True)
    return rows


def compare_ramps(seed: int) -> list[list[float]]:
    """Return, for each world, error left, its share, inside 2 u; without ramps too."""
    sound = Bench.draw(seed, _FASTEST_MM_MIN, _FAST)
    machine = parse_machine(sound.content)
    program = chord_path(machine, seed, _LINES, _FASTEST_MM_MIN)
    rows: list[list[float]] = []
    for bench in (sound, sound.bend(0.0), sound.bend(_SWING_HZ)):
        used = study(bench.drive(program))
        without = study(used.recording, seen=used.seen.exclude_ramps())
        row = [used.seen.count[used.seen.is_ramp].sum() / used.seen.used]
        for each in (used, without):
            inside = each.within.share(np.abs(each.left_mm) < 2.0 * each.sigma_mm)
            row += [_compute_left_um(each), each.share_left, inside]
        rows.append([float(value) for value in row])
        print(seed, rows[-1], file=sys.stderr, flush=True)
    return rows


def _compute_left_um(done: Study) -> float:
    return 1e3 * done.within.rms_length(done.left_mm)


def _compute_stated_um(done: Study) -> float:
    return 1e3 * done.within.rms_length(done.sigma_mm)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--only", choices=["feeds", "ramps"])
    options, _ = parser.parse_known_args()
    if options.only != "ramps":
        seeds = range(options.first, options.first + MACHINES)
        write_section("fast-feeds", tabulate_feeds([compare_feeds(s) for s in seeds]))
    if options.only != "feeds":
        seeds = range(options.first + 100, options.first + 100 + FAST_MACHINES)
        write_section("fast-ramps", tabulate_ramps([compare_ramps(s) for s in seeds]))


def tabulate_feeds(found: Sequence[list[list[tuple[float, float]]]]) -> str:
    """Return medians over machines, and of ratios machine by machine."""
    left = np.array(found)
    ratio = np.median(left / left[:, :, :1], axis=0)
    rows = [
        [
            f"{feed:.0f}",
            *(f"{np.median(left[:, k, plan, 0]):.2f}" for plan in range(3)),
            *(f"{ratio[k, plan, 0]:.2f} ({ratio[k, plan, 1]:.2f})" for plan in (1, 2)),
        ]
        for k, feed in enumerate(FEEDS_MM_MIN)
    ]
    head = [
        "highest feed, mm/min",
        "corner path, µm",
        "planned at that feed, µm",
        "feeds chosen, µm",
        "planned / corner (stated)",
        "chosen / corner (stated)",
    ]
    return table(head, rows)


def tabulate_ramps(found: Sequence[list[list[float]]]) -> str:
    """Return means over machines for each world."""
    values = np.mean(np.array(found), axis=0)
    worlds = ["sound", "leans under acceleration", "swings after each jerk"]
    rows = [
        [
            world,
            f"{ramp:.0%}",
            f"{left:.2f}",
            f"{share:.1%}",
            f"{inside:.0%}",
            f"{left_without:.2f}",
            f"{inside_without:.0%}",
        ]
        for world, (ramp, left, share, inside, left_without, _, inside_without) in zip(
            worlds, values, strict=True
        )
    ]
    head = [
        "machine",
        "samples on ramps",
        "left, µm",
        "of before",
        "inside 2 u",
        "without ramps, µm",
        "inside 2 u",
    ]
    return table(head, rows)


if __name__ == "__main__":
    main()
