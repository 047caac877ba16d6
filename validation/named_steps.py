"""What a step of the set-up is called: another place, a tilt, another range offset.

Machines, paths or points, air and trackers within their specification are drawn by
seed; one thing happens at a time that is drawn as well, or the beam is lost and found
with an offset that the specification allows. Right is the one name at its time, or none
where nothing is to be named.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from document import table, write_section
from draws import keep_rows, make_parser, read_rows
from judging import map_mm, true_map_mm, volume
from random_machines import FEED_MM_MIN
from recordings import plan_program, random_air, random_content, run_of
from stream_disturbances import Disturb, lock_again, shift, turn

from truepath.alignment.align import align_all
from truepath.estimation.checks.robust_estimate import CheckedEstimate, estimate_checked
from truepath.files.bundle.run import Run
from truepath.kinematics.coarse_model import build_run_models
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.recording import Recording
from truepath_simulators.worlds.synthetic import Defects, Setting, record

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "verdict.md"
KEPT = ROOT / "var" / "named-steps.jsonl"
WORLDS, LINES, POINTS, RATE_HZ = 20, 20, 50, 100
_SMALLER = 0.5  # machines of 125 to 450 mm: solved in little time
_FIRST_SEED = 4001
_LEAST_MM = 1e-4
_BROKEN_S, _NEAR_S = 0.4, 4.0
_BREAKS_S = 20.0, 60.0  # when the beam is lost and nothing is to be named


def draw_place(rng: np.random.Generator) -> Disturb:
    """Return a shift of the tracker by 20 to 80 µm."""
    return shift(rng.uniform(20.0, 80.0))


def draw_tilt(rng: np.random.Generator) -> Disturb:
    """Return a turn of the tracker by 20 to 80 µrad."""
    return turn(rng.uniform(20.0, 80.0))


def draw_offset(rng: np.random.Generator) -> Disturb:
    """Return a range offset of 40 to 120 µm, either way, with the beam lost or not."""
    broken_s = float(rng.choice([0.0, _BROKEN_S]))
    return lock_again(rng.choice([-1.0, 1.0]) * rng.uniform(40.0, 120.0), broken_s)


LOST = "beam lost, offset as specified"
ROWS: dict[str, tuple[Callable[[np.random.Generator], Disturb] | None, str]] = {
    "place of the tracker": (draw_place, "place"),
    "tilt of the tracker": (draw_tilt, "tilt"),
    "range offset": (draw_offset, "range"),
    LOST: (None, ""),
}


@dataclass(frozen=True)
class Outcome:
    """What became of one world.

    said : kinds that were named; late_s : of the first, by how much
    left_um, stated_um : error of the map left and stated; covered : in 95 % intervals
    """

    row: str
    seed: int
    said: tuple[str, ...]
    late_s: float
    left_um: float
    stated_um: float
    covered: float

    @classmethod
    def from_row(cls, kept: dict[str, Any]) -> Self:
        return cls(**{**kept, "said": tuple(kept["said"])})

    @property
    def is_right(self) -> bool:
        """Whether it has the one name, at its time."""
        name = ROWS[self.row][1]
        is_near = not name or abs(self.late_s) < _NEAR_S
        return self.said == ((name,) if name else ()) and is_near


def draw_world(row: str, seed: int) -> Recording:
    """Record lines, or points in every second world; the beam is lost by the row."""
    content = random_content(seed)
    for axis in content["axes"].values():
        axis["max_mm"] *= _SMALLER
    content["tracker"]["rate_hz"] = RATE_HZ
    begin_s = np.random.default_rng([seed, 43]).uniform(*_BREAKS_S)
    breaks = ((float(begin_s), _BROKEN_S),) if row == LOST else ()
    setting = Setting(air=random_air(seed), defects=Defects(beam_breaks=breaks))
    if seed % 2:
        program = plan_program(content, FEED_MM_MIN, LINES)
        return record(content, program, seed, "otf", setting)
    machine = parse_machine(content)
    program = paths.standstill_points(machine, seed, POINTS, dwell_s=0.5)
    return record(content, program, seed, "standstill", setting)


def estimate_run(run: Run) -> CheckedEstimate:
    """Return the checked estimate of one Run."""
    seen = align_all([run], [run.name])
    models = build_run_models(run.machine, [each.at for each in seen])
    return estimate_checked(models, seen)


def play(row: str, seed: int) -> Outcome:
    """Draw a world, let it happen, and return what is said of it."""
    made = draw_world(row, seed)
    run = run_of(made)
    draw, _ = ROWS[row]
    moved, at_s = run.tracker, 0.0
    if draw is not None:
        disturb = draw(np.random.default_rng([seed, 41]))
        moved = disturb(run.tracker, np.random.default_rng([seed, 42]))
        changed = np.abs(moved.position_mm - run.tracker.position_mm).max(axis=1)
        at_s = run.tracker.device_time_s[np.argmax(changed > _LEAST_MM)]
    found = estimate_run(replace(run, tracker=moved))
    within, estimate = volume(run.machine), found.estimate
    error, sigma = map_mm(within, estimate.model, estimate.theta, estimate.covariance)
    left = true_map_mm(within, made.truth) - error
    return Outcome(
        row,
        seed,
        tuple(knock.kind for knock in found.setup_shifts),
        float(found.setup_shifts[0].time_s - at_s) if found.setup_shifts else 0.0,
        1e3 * within.rms_length(left),
        1e3 * within.rms_length(sigma),
        within.share(np.abs(left) < 1.96 * sigma),
    )


def summarise(outcomes: Sequence[Outcome]) -> str:
    rows: list[list[str]] = []
    for name in ROWS:
        seen = [one for one in outcomes if one.row == name]
        if not seen:
            continue
        left, stated = (
            float(np.sqrt(np.mean([getattr(one, key) ** 2 for one in seen])))
            for key in ("left_um", "stated_um")
        )
        rows.append(
            [
                name,
                f"**{sum(one.is_right for one in seen)} of {len(seen)}**",
                f"{left:.2f}",
                f"{stated:.2f}",
                f"{np.mean([one.covered for one in seen]):.1%}",
            ]
        )
    head = ["what happened", "named right", "left µm", "stated µm", "in 95 %"]
    return table(head, rows)


def main() -> None:
    parser = make_parser(__doc__, KEPT)
    parser.add_argument("--only", default="", help="rows with this in their name")
    options = parser.parse_args()
    first = 1 if options.improve else _FIRST_SEED
    worlds = max(1, round(options.share * WORLDS))
    seeds = range(first, first + worlds)
    tasks = [(row, seed) for seed in seeds for row in ROWS if options.only in row]
    kept = map(Outcome.from_row, read_rows(options.kept))
    done = {(one.row, one.seed): one for one in kept}
    missing = [task for task in tasks if task not in done]
    rows = (asdict(play(*task)) for task in missing[: options.most])
    for one in map(Outcome.from_row, keep_rows(options.kept, rows)):
        done[one.row, one.seed] = one
        print(one, file=sys.stderr, flush=True)
    text = summarise([done[task] for task in tasks if task in done])
    if options.improve:
        print(text)
    else:
        write_section("named-steps", text, DOCUMENT)


if __name__ == "__main__":
    main()
