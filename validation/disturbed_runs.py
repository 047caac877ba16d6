"""Measurements that are disturbed: what is left, and what the verdict says.

Valid samples in the wrong place, a tracker that freezes, stamps that stall, a set-up
that is knocked; on the fly, at standstill, and of machines with rotary axes. A machine
is drawn anew for each row. No row may be wrong and call itself usable: wrong is a mean
error left above 6 % of what there was, or fewer than 85 % inside 2 u. And machines that
nothing disturbs: their verdict is to be usable, whatever their size, path and air.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from document import table, write_section
from recordings import (
    CHAINS,
    machine_content,
    plan_program,
    random_air,
    random_content,
    run_of,
)
from stream_disturbances import (
    Disturb,
    burst,
    flip,
    freeze,
    jump_clock,
    knock,
    stall,
    turn,
)
from target_seats import draw_machine, remove_rigid_motion

from truepath.errors import TruepathError
from truepath.files.bundle.run import Run
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.analysis import analyse
from truepath.results.result_summary import Findings
from truepath_simulators.machine.truth_machine import perfect
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.recording import Recording
from truepath_simulators.worlds.synthetic import Setting, record

SEED, CLEAN, _CLEAN_FROM = 9801, 120, 1000
_GRID = 300
_MOST_LEFT, _FEWEST_INSIDE = 0.06, 0.85
World = Callable[[int], Recording]


def record_lines(seed: int, lines: int = 40, feed_mm_min: float = 5000.0) -> Recording:
    """Record the product's own path on a machine of 250 to 900 mm."""
    content = random_content(seed)
    program = plan_program(content, feed_mm_min, lines)
    return record(content, program, seed, setting=Setting())


def record_points(seed: int, points: int = 90, dwell_s: float = 0.8) -> Recording:
    """Record standstills on such a machine."""
    content = random_content(seed)
    program = paths.standstill_points(
        parse_machine(content), seed, points, dwell_s=dwell_s
    )
    return record(content, program, seed, "standstill", Setting())


def record_turns(seed: int, points: int = 200) -> Recording:
    """Record standstills on a machine with rotary axes."""
    content = draw_machine(seed)
    machine = parse_machine(content)
    program = paths.turning_points(machine, seed, points, dwell_s=0.6)
    return record(content, program, seed, "standstill", Setting())


def record_small(seed: int) -> Recording:
    """Record a small machine: size, chain, path, feed, rate and air are drawn."""
    rng = np.random.default_rng([seed, 8])
    travel = tuple(np.round(rng.uniform(120.0, 450.0, 3), 0))
    tool = (*np.round(rng.uniform(-60.0, 60.0, 2), 1), -round(rng.uniform(60, 200), 1))
    content = machine_content(CHAINS[rng.integers(len(CHAINS))], travel, tool)
    content["tracker"]["rate_hz"] = int(rng.choice([250, 500, 1000]))
    machine, feed = parse_machine(content), float(rng.uniform(3000.0, 15_000.0))
    kind, lines = int(rng.integers(4)), int(rng.choice([12, 18, 30, 45]))
    setting = Setting(air=random_air(seed))
    if kind == 0:
        points = paths.standstill_points(machine, seed, 2 * lines, dwell_s=0.6)
        return record(content, points, seed, "standstill", setting)
    if kind == 1:
        return record(content, paths.corner_path(machine, feed), seed, "otf", setting)
    if kind == 2:
        chords = paths.chord_path(machine, seed, lines, feed)
        return record(content, chords, seed, "otf", setting)
    return record(content, plan_program(content, feed, lines), seed, "otf", setting)


LINES: dict[str, Disturb] = {
    "nothing": lambda stream, _: stream,
    "sign lost for 0.2 s": flip(0.2),
    "sign lost for 3 s": flip(3.0),
    **{
        f"{1e3 * size:.0f} µm aside for {duration} s": burst(size, duration)
        for size, duration in product((5.0, 0.1, 0.04), (0.04, 0.1, 0.4, 1.4, 4.0))
    },
    "100 µm aside, 10 times 0.2 s": burst(0.1, 0.2, 10),
    "5 mm aside, 10 times 0.2 s": burst(5.0, 0.2, 10),
    "frozen for 0.5 s": freeze(0.5),
    "frozen for 5 s": freeze(5.0),
    "stamps stall for 0.1 s": stall(0.1),
    "stamps stall for 1 s": stall(1.0),
    "clock jumps by 50 ms": jump_clock(0.05),
    "clock jumps by 5 s": jump_clock(5.0),
    **{f"knock of {size} µm": knock(size) for size in (5, 10, 20, 50, 200, 500)},
    "turn by 40 µrad": turn(40.0),
    "knocks of 50 and 80 µm": knock(50, 80),
    "knocks of 30, 20 and 40 µm": knock(30, 20, 40),
    "drift of 30 µm": knock(drift_um=30.0),
    "knock of 50 µm, drift of 30 µm": knock(50, drift_um=30.0),
}
POINTS: dict[str, Disturb] = {
    "nothing": LINES["nothing"],
    "5 mm aside for 0.4 s": burst(5.0, 0.4),
    "100 µm aside for 0.4 s": burst(0.1, 0.4),
    "40 µm aside for 4 s": burst(0.04, 4.0),
    "sign lost for 3 s": flip(3.0),
    "frozen for 5 s": freeze(5.0),
    "stamps stall for 1 s": stall(1.0),
    "knock of 10 µm": knock(10),
    "knock of 50 µm": knock(50),
    "knocks of 50 and 80 µm": knock(50, 80),
    "drift of 30 µm": knock(drift_um=30.0),
}
TURNS = {name: POINTS[name] for name in list(POINTS)[1::2]} | {
    "nothing": LINES["nothing"]
}
KINDS: tuple[tuple[str, World, dict[str, Disturb]], ...] = (
    ("lines", record_lines, LINES),
    ("points", record_points, POINTS),
    ("rotary", record_turns, TURNS),
)


@dataclass(frozen=True)
class Outcome:
    """What came of one measurement.

    share : of the mean error, left; inside : share of the components inside 2 u
    said : state of the verdict and kinds of its reasons, or why it was refused
    """

    share: float
    inside: float
    said: str

    @property
    def is_right(self) -> bool:
        """Whether it is right, or says that it is not."""
        wrong = self.share > _MOST_LEFT or self.inside < _FEWEST_INSIDE
        return not (wrong and self.said.startswith("usable"))


def measure(recording: Recording, disturb: Disturb, seed: int) -> Outcome:
    """Analyse a recording that is disturbed, and judge it by the exact truth."""
    run: Run = run_of(recording)
    moved = disturb(run.tracker, np.random.default_rng([seed, 5]))
    try:
        found = analyse(replace(run, tracker=moved))
    except TruepathError as error:
        return Outcome(np.nan, np.nan, f"refused: {str(error)[:60]}")
    share, inside = judge(found, recording, seed)
    kinds = sorted({reason.kind for reason in found.verdict.reasons})
    said = f"{found.verdict.state}: {', '.join(kinds)}".removesuffix(": ")
    return Outcome(share, inside, said)


def judge(found: Findings, recording: Recording, seed: int) -> tuple[float, float]:
    """Return the share of the mean error that is left, and the share inside 2 u."""
    machine, truth = found.estimate.model.machine, recording.truth
    low, high = np.array([(axis.low, axis.high) for axis in machine.axes]).T
    q = np.random.default_rng([seed, 7]).uniform(low, high, (_GRID, len(low)))
    nominal, first = perfect(truth.machine), truth.machine.reflectors[0]
    place = nominal.nominal_point_mm(q, first)
    before = remove_rigid_motion(place, truth.point_mm(q, first) - place)
    maps = build_volumetric_map(found.estimate.model)
    still = make_standstill(machine, q)
    told = maps.error_mm(still, found.estimate.theta)
    left = remove_rigid_motion(place, before - told)
    inside = np.abs(left) < 2.0 * maps.sigma_mm(still, found.estimate.covariance)
    mean_before, mean_left = (
        float(np.linalg.norm(each, axis=1).mean()) for each in (before, left)
    )
    return mean_left / mean_before, float(inside.mean())


def judge_disturbed(
    world: World, disturbances: dict[str, Disturb], seed: int
) -> list[list[str]]:
    rows: list[list[str]] = []
    for each, (name, disturb) in enumerate(disturbances.items(), start=seed):
        found = measure(world(each), disturb, each)
        error = "" if np.isnan(found.share) else f"{found.share:.1%}"
        inside = "" if np.isnan(found.inside) else f"{found.inside:.0%}"
        right = "yes" if found.is_right else "**no**"
        rows.append([name, error, inside, found.said, right])
        print(each, *rows[-1], sep=" | ", file=sys.stderr, flush=True)
    return rows


def judge_clean(seed: int, worlds: int) -> list[list[str]]:
    """Return what becomes of small machines that nothing disturbs."""
    said: Counter[str] = Counter()
    inside: list[float] = []
    for each in range(seed, seed + worlds):
        recording = record_small(each)
        found = measure(recording, LINES["nothing"], each)
        said[found.said] += 1
        inside.append(found.inside)
        print(each, recording.mode, len(recording), found, file=sys.stderr, flush=True)
    print(f"inside 2 u: {np.nanmean(inside):.1%}", file=sys.stderr)
    return [[name, str(count)] for name, count in said.most_common()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--kinds", default="clean,lines,points,rotary")
    parser.add_argument("--clean", type=int, default=CLEAN, help="machines")
    parser.add_argument("--dry", action="store_true", help="write no document")
    options, _ = parser.parse_known_args()
    write = print if options.dry else partial(write_section)
    kinds = options.kinds.split(",")
    if "clean" in kinds:
        clean = judge_clean(options.seed + _CLEAN_FROM, options.clean)
        write("undisturbed", table(["verdict", "machines"], clean))
    head = ["disturbance", "error left", "inside 2 u", "verdict", "right or said"]
    for number, (kind, world, disturbances) in enumerate(KINDS):
        if kind in kinds:
            rows = judge_disturbed(world, disturbances, options.seed + 100 * number)
            write(f"disturbed-{kind}", table(head, rows))


if __name__ == "__main__":
    main()
