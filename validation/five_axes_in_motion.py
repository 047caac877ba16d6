"""Five-axis machines in motion: the tip kept, planned, live, and what hides in them.

Machines are those of `target_seats`, every target off its place by itself.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from document import table, write_section
from recordings import run_of
from target_seats import (
    FEED_MM_MIN,
    ON_THE_FLY,
    STANDSTILL,
    SUMMARY,
    Outcome,
    draw_machine,
    drive_usually,
    follow,
    judge_map,
    record_seated,
    summarize,
)

from truepath.discovery.discover import discover
from truepath.estimation.live.live import LiveEstimator
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.motion.configurations import split_by_target
from truepath.motion.motion_times import travel_time_s
from truepath.motion.workspace import moving_targets
from truepath.planning.default_path import default_path
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath.results.analysis import analyse
from truepath_drivers.interfaces.records import Path, TrackerSamples
from truepath_simulators.hidden.drives import GearCyclic, SwivelSag, TurningBacklash
from truepath_simulators.hidden.effect import HiddenEffect, Occasion
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds.recording import Recording

_TURN_DEG, _LEAST_TURN_DEG, _TRIES = 25.0, 10.0, 40
_SLOWEST_DEG_MIN, _MARGIN = 1800.0, 2.0
_DWELL_S, _CHANGE_S = 0.4, 5.0


def keep_tip(machine: Machine, begin: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """Return the position with other angles at which the tip stands where it did."""

    def find_tip(position: np.ndarray) -> np.ndarray:
        return make_standstill(machine, position[None]).point_mm[0]

    place, position = find_tip(begin), begin.copy()
    position[3:] = angles_deg
    for _ in range(4):
        here = find_tip(position)
        moved = [find_tip(position + one) - here for one in np.eye(len(begin))[:3]]
        position[:3] -= np.linalg.solve(np.array(moved).T, here - place)
    return position


@dataclass
class _Rows:
    """Rows of a path, one after another."""

    feed_mm_min: float
    position: list[np.ndarray]
    target: list[str]
    dwell_s: list[float]
    feed: list[float] = field(default_factory=list[float])

    def go(self, place: np.ndarray, name: str, dwell_s: float = _DWELL_S) -> None:
        """Add a line at the feed that the rotary axes keep up with."""
        step = np.abs(place - self.position[-1])
        way_mm = float(np.linalg.norm(step[:3]))
        slow = way_mm / max(float(step[3:].max()) / _SLOWEST_DEG_MIN, 1e-9)
        self.position.append(np.round(place, 4))
        self.target.append(name)
        self.dwell_s.append(dwell_s)
        self.feed.append(min(self.feed_mm_min, slow) if way_mm else _SLOWEST_DEG_MIN)


def add_kept_tips(machine: Machine, path: Path, lines: int, seed: int) -> Path:
    """Return the path and, for each target, lines on which the tip keeps its place."""
    rng = np.random.default_rng([seed, 8])
    low, high = np.array([(a.low, a.high) for a in machine.axes]).T
    rows = _Rows(
        float(path.feed_mm_min.max()),
        list(path.position),
        list(path.target),
        list(path.dwell_s),
        list(path.feed_mm_min),
    )
    for target in moving_targets(machine):
        rows.go(rows.position[-1], target.name, _CHANGE_S)
        kept = 0
        while kept < lines:
            rows.go(rng.uniform(low + _MARGIN, high - _MARGIN), target.name)
            for _ in range(_TRIES):
                begin = rows.position[-1]
                turn = rng.uniform(-_TURN_DEG, _TURN_DEG, len(low) - 3)
                place = keep_tip(machine, begin, begin[3:] + turn)
                inside = ((place > low) & (place < high)).all()
                if inside and np.abs(turn).max() > _LEAST_TURN_DEG and kept < lines:
                    rows.go(place, target.name)
                    kept += 1
    return Path(
        path.axes,
        np.array(rows.position),
        np.array(rows.feed),
        np.array(rows.dwell_s),
        tuple(rows.target),
    )


FIRST_SEED, MACHINES, PLANS, WORLDS = 1001, 10, 8, 8
OFF_MM, FAR_MM = 0.02, 3.0  # that a target sits off its place
LINES, KEPT_TIPS = 48, 8  # of the default path, and beside it of each target
SIZES_UM = (2.0, 5.0)  # of what is hidden: how far it moves the point about its mean
_BLOCK, _GRID = 1000, 300
HIDDEN: tuple[type[HiddenEffect] | None, ...] = (
    None,
    TurningBacklash,
    GearCyclic,
    SwivelSag,
)


def stand(seed: int) -> list[Recording]:
    """Return random standstills, every target in turn in one Run."""
    return [
        record_seated(seed, OFF_MM, drive_usually(seed, STANDSTILL), mode=STANDSTILL)
    ]


def drive(seed: int) -> list[Recording]:
    """Return the default path, every target in turn in one Run."""
    return [record_seated(seed, OFF_MM, drive_usually(seed, ON_THE_FLY))]


def keep_tips(seed: int) -> list[Recording]:
    """Return a shorter path, and beside it lines on which the tip keeps its place."""
    machine = machine_from_json(draw_machine(seed))
    path = default_path(machine, FEED_MM_MIN, lines=LINES, seed=seed)
    path = add_kept_tips(machine, path, KEPT_TIPS, seed)
    return [record_seated(seed, OFF_MM, follow(path))]


def seat_anew(seed: int, off_mm: float = OFF_MM) -> list[Recording]:
    """Return two Runs, every target seated and the tracker put up anew for each."""
    machine = machine_from_json(draw_machine(seed))
    made: list[Recording] = []
    for sitting in range(2):
        path = default_path(machine, FEED_MM_MIN, lines=LINES, seed=seed + sitting)
        made.append(record_seated(seed, off_mm, follow(path), sitting=sitting))
    return made


def seat_anew_far_off(seed: int) -> list[Recording]:
    """Return two such Runs whose targets are off by millimetres."""
    return seat_anew(seed, FAR_MM)


def give_each_a_run(seed: int) -> list[Recording]:
    """Return a Run for each target, as many lines as the default path has of it."""
    machine = machine_from_json(draw_machine(seed))
    path = default_path(machine, FEED_MM_MIN, seed=seed)
    return [
        record_seated(seed, OFF_MM, follow(part), sitting=sitting)
        for sitting, part in enumerate(split_by_target(path))
        if isinstance(part, Path)
    ]


MEASURED = {
    "standstills, all targets in one Run": stand,
    "on the fly, all targets in one Run": drive,
    "on the fly, a tip kept on some lines": keep_tips,
    "on the fly, a Run for each target": give_each_a_run,
    "on the fly, two Runs, targets seated anew": seat_anew,
    "the same, 3 mm off": seat_anew_far_off,
}


def judge_measured(seed: int, made: Sequence[Recording]) -> tuple[Outcome, str]:
    """Return what Runs of a machine leave, and the verdict on them."""
    found = analyse(*map(run_of, made))
    outcome, said = judge_map(seed, made[0], found.estimate), found.verdict.state
    print(seed, made[0].content["kinematic_chain"], outcome, said, flush=True)
    return outcome, said


def tabulate_measured(seeds: Sequence[int]) -> str:
    rows: list[list[str]] = []
    for name, measure in MEASURED.items():
        each = [judge_measured(seed, measure(seed)) for seed in seeds]
        usable = sum(said == "usable" for _, said in each)
        rows.append(
            [name, *summarize([o for o, _ in each]), f"{usable} of {len(each)}"]
        )
    return table(["measured", *SUMMARY, "usable"], rows)


def judge_plan(seed: int) -> list[str]:
    """Return a row on a plan against the default path of the same time."""
    machine = machine_from_json(draw_machine(seed))
    usual = default_path(machine, FEED_MM_MIN, seed=seed)
    time_s = travel_time_s(usual, machine.motion)
    planned = make_plan(machine, PlanRequirements(minutes=time_s / 60.0, seed=seed))
    one, other = (
        judge_measured(seed, [record_seated(seed, OFF_MM, follow(path))])[0]
        for path in (usual, planned.commanded)
    )
    lines = Counter(planned.commanded.target)
    return [
        f"{seed}, {machine.chain}",
        f"{time_s:.0f}",
        f"{one.left:.2f}",
        f"{other.left:.2f}",
        f"{other.left / one.left:.2f}",
        f"{planned.uncertainty_um:.2f}",
        f"{other.inside:.1%}",
        ", ".join(f"{name} {count}" for name, count in lines.items()),
    ]


def assess_live(seed: int, off_mm: float) -> list[str]:
    """Return a row on the last live estimate against that of the closed Run."""
    machine = machine_from_json(draw_machine(seed))
    path = default_path(machine, FEED_MM_MIN, lines=LINES, seed=seed)
    made = record_seated(seed, off_mm, follow(path))
    run = run_of(made)
    live = LiveEstimator(run.machine, run.commanded)
    for block in _cut(run.tracker):
        live.add_block(block)
    live.finish()
    last, batch = live.estimate(), analyse(run).estimate
    if last is None:
        raise RuntimeError(f"machine {seed}: no live estimate")
    low, high = np.array([(a.low, a.high) for a in machine.axes]).T
    q = np.random.default_rng([seed, 7]).uniform(low, high, (_GRID, len(low)))
    still = make_standstill(machine, q)

    def tell(found: EstimatedModel) -> tuple[np.ndarray, np.ndarray]:
        maps = build_volumetric_map(found.model)
        sigma_mm = maps.sigma_mm(still, found.covariance)
        return maps.error_mm(still, found.theta), sigma_mm

    (one, own), (other, sigma) = tell(last), tell(batch)
    off = (one - other) / sigma
    return [
        f"{seed}, {machine.chain}, {1e3 * off_mm:g} µm",
        f"{judge_map(seed, made, last).left:.2f}",
        f"{judge_map(seed, made, batch).left:.2f}",
        f"{np.abs(off).max():.2f}",
        f"{np.sqrt(np.mean(off**2)):.2f}",
        f"{np.median(own / sigma):.2f}",
    ]


def _cut(samples: TrackerSamples) -> Iterator[TrackerSamples]:
    for begin in range(0, len(samples), _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        yield TrackerSamples(
            samples.sequence[rows],
            samples.device_time_s[rows],
            samples.position_mm[rows],
            samples.status[rows],
        )


def hide(seed: int, kind: type[HiddenEffect] | None) -> Recording:
    """Return the default path on a machine with something hidden."""
    hidden: list[HiddenEffect] = []
    if kind is not None:
        rng = np.random.default_rng([seed, 9])
        occasion = Occasion.usual(
            parse_machine(draw_machine(seed)), float(rng.uniform(*SIZES_UM))
        )
        hidden.append(kind.draw(rng, occasion))
    return record_seated(seed, OFF_MM, drive_usually(seed, ON_THE_FLY), hidden=hidden)


def assess_discovery(
    kind: type[HiddenEffect] | None, seeds: Sequence[int]
) -> list[str | int]:
    """Return a row on what discovery says of worlds of one kind."""
    named = other = silent = 0
    for seed in seeds:
        made = hide(seed, kind)
        wanted = [" ".join([e.name, *e.keys.values()]) for e in made.hidden]
        found = discover([run_of(made)])
        said = [finding.candidate.label for finding in found.findings]
        print(seed, made.content["kinematic_chain"], wanted, "said", said, flush=True)
        named += said == wanted
        other += bool(set(said) - set(wanted))
        silent += bool(wanted) and not said
    name = kind.name if kind else "nothing"
    return [name, len(seeds), named, other, silent]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="measured,plans,live,discovery")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--plans", type=int, default=PLANS)
    parser.add_argument("--worlds", type=int, default=WORLDS)
    options, _ = parser.parse_known_args()
    first = options.first_seed
    seeds = range(first, first + options.machines)
    if "measured" in options.only:
        write_section("five-axes-measured", tabulate_measured(seeds))
    if "plans" in options.only:
        head = ["machine", "time s", "default left µm", "planned left µm", "ratio"]
        head += ["forecast µm", "inside 2u", "rows a target"]
        rows = [judge_plan(seed) for seed in range(first, first + options.plans)]
        write_section("five-axes-plans", table(head, rows))
    if "live" in options.only:
        head = ["machine, targets off by", "live left µm", "batch left µm"]
        head += ["largest difference / u", "rms", "u live / u batch"]
        off_mm = [(OFF_MM, FAR_MM)[seed % 2] for seed in seeds]
        rows = [assess_live(*each) for each in zip(seeds, off_mm, strict=True)]
        write_section("five-axes-live", table(head, rows))
    if "discovery" in options.only:
        head = ["hidden", "worlds", "named alone", "something else said", "silent"]
        worlds = range(first, first + options.worlds)
        found = [assess_discovery(kind, worlds) for kind in HIDDEN]
        write_section("five-axes-discovery", table(head, found))


if __name__ == "__main__":
    main()
