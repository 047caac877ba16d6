"""What the live estimate notices while the machine moves, how soon, and by which name.

Machines, paths, air and tails of the noise are drawn by seed; something happens during
the Run, or nothing. The stream is played block by block; a notice comes when the block
that shows it is there and the processor has looked at it. Outcomes are kept as lines of
JSON, one a world, so that a draw continues where it stopped.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from document import table, write_section
from draws import keep_rows, make_parser, read_rows
from hidden_worlds import draw_program
from recordings import random_air, random_content, run_of

from truepath.estimation.live.live import LiveEstimator
from truepath.files.bundle.run import Run
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.motion import Motion
from truepath_simulators.hidden.setup import SetupStep, TableDrift
from truepath_simulators.hidden.structure import ThermalGrowth
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.recording import Recording
from truepath_simulators.worlds.synthetic import Setting

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "live.md"
KEPT = ROOT / "var" / "live-notices.jsonl"
REPORTED = 2000  # seeds from here on are those that nothing was improved on
_BLOCK = 50  # samples
_TAIL_SHARE, _TAIL_MM = 0.02, 0.01  # of the samples; size of what is added to them
LINES = (24, 40)
NAMES = {
    "knock": "set-up-moved",
    "drift": "set-up-drifts",
    "growth": "axes-grow",
    "play": "lost-motion-changed",
}
# What happens, how large in µm, between which shares of the Run; worlds of each.
ROWS: dict[str, tuple[str, float, float, float, int]] = {
    "nothing, on the fly": ("clean", 0.0, 0.0, 1.0, 250),
    "nothing, at standstill": ("clean-points", 0.0, 0.0, 1.0, 50),
    "knock of 10 µm, first quarter": ("knock", 10.0, 0.05, 0.25, 20),
    "knock of 10 µm, second quarter": ("knock", 10.0, 0.25, 0.5, 20),
    "knock of 10 µm, third quarter": ("knock", 10.0, 0.5, 0.75, 25),
    "knock of 10 µm, last quarter": ("knock", 10.0, 0.75, 0.95, 25),
    "knock of 5 µm, second half": ("knock", 5.0, 0.5, 0.95, 20),
    "knock of 50 µm, second half": ("knock", 50.0, 0.5, 0.95, 20),
    "drift of 15 µm": ("drift", 15.0, 0.0, 1.0, 20),
    "axis grows by 15 µm": ("growth", 15.0, 0.0, 1.0, 20),
    "lost motion of an axis from 0 to 10 µm": ("play", 10.0, 0.3, 0.7, 20),
}


@dataclass(frozen=True, slots=True)
class LaterPlay(Backlash):
    """Play that an axis has from one moment on: a nut that comes loose."""

    time_s: float = 0.0

    def added_error_motions(
        self, motion: Motion, time_s: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return that of the play, after the moment."""
        there = Backlash.added_error_motions(self, motion, time_s)
        later = (time_s >= self.time_s)[:, None]
        return {key: value * later for key, value in there.items()}


@dataclass(frozen=True)
class Outcome:
    """What became of one world.

    begin_share : when it happened, of the duration of the Run
    own_s, next_s : from the end of the line on which it happened, and of the next one,
        to the first notice
    lines : that were finished since it happened, when it was noticed
    said, grade : of the notice at the end of the Run; false : notices before, or of
        what is not there
    size_um, sigma_um : as told at the end
    """

    row: str
    seed: int
    begin_share: float
    own_s: float | None = None
    next_s: float | None = None
    lines: int | None = None
    said: tuple[str, ...] = ()
    grade: tuple[str, ...] = ()
    false: int = 0
    size_um: float | None = None
    sigma_um: float | None = None
    look_s: float = 0.0

    @classmethod
    def from_row(cls, kept: dict[str, Any]) -> Self:
        return cls(
            **{**kept, "said": tuple(kept["said"]), "grade": tuple(kept["grade"])}
        )


def draw_world(row: str, seed: int) -> tuple[Recording, float]:
    """Draw a recording, and when something happens in it, by the machine's clock."""
    what, size_um, low, high, _ = ROWS[row]
    rng = np.random.default_rng([seed, 31, *map(ord, what)])
    content, setting = random_content(seed), Setting(air=random_air(seed))
    if what == "clean-points":
        machine = parse_machine(content)
        points = paths.standstill_points(machine, seed, 80, dwell_s=0.8)
        recording = synthetic.record(content, points, seed, "standstill", setting)
        return add_tails(recording, rng), np.inf
    program = draw_program(content, rng, LINES)
    motion = make_program_timeline(
        program, program.position[0], setting.lead_in_s, setting.limits
    )
    at_s = float(rng.uniform(low, high)) * motion.end_s
    x, y, z = draw_direction(rng) * size_um
    axis = parse_machine(content).linear_axes[int(rng.integers(3))]
    hidden: dict[str, tuple[HiddenEffect, ...]] = {
        "knock": (SetupStep(at_s, (x, y, z)),),
        "drift": (TableDrift((x / motion.end_s, y / motion.end_s, z / motion.end_s)),),
        "growth": (
            ThermalGrowth(
                axis.name,
                1e3 * size_um / (axis.high - axis.low) / -np.expm1(-2.0),
                float(rng.choice([-1.0, 1.0])),
                0.5 * motion.end_s,
                has_sensor=False,
            ),
        ),
        "play": (LaterPlay(axis.name, size_um, at_s),),
    }
    setting = replace(setting, hidden=hidden.get(what, ()), sensors=False)
    recording = synthetic.record(content, program, seed, "otf", setting)
    begin_s = np.inf if what == "clean" else at_s if what in ("knock", "play") else 0.0
    return add_tails(recording, rng), begin_s


def draw_direction(rng: np.random.Generator) -> np.ndarray:
    """Draw a direction of any kind."""
    aside = rng.normal(size=3)
    return aside / np.linalg.norm(aside)


def add_tails(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return a recording some of whose samples are off by more than noise."""
    off = rng.standard_t(3.0, recording.position_mm.shape) * _TAIL_MM
    off *= rng.uniform(size=(len(off), 1)) < _TAIL_SHARE
    return replace(recording, position_mm=recording.position_mm + off)


def play(row: str, seed: int) -> Outcome:
    """Play a world to the live estimate and judge what it notices."""
    recording, at_s = draw_world(row, seed)
    run = run_of(recording)
    what, begin_s, end_s = (
        ROWS[row][0],
        run.tracker.device_time_s[0],
        recording.time_s[-1],
    )
    at_s = float(recording.clock.device_s(at_s)) if np.isfinite(at_s) else at_s
    share = (at_s - begin_s) / (end_s - begin_s)
    outcome = Outcome(row, seed, float(share) if np.isfinite(share) else 0.0)
    ends = find_ends(recording)
    later = ends[ends > at_s]
    notices: tuple = ()
    told = 0
    took = 0.0
    for block_s, notices, look_s in follow_live(run):
        took += look_s
        if len(notices) > told:
            told = len(notices)
            if block_s < at_s:
                outcome = replace(outcome, false=outcome.false + 1)
            elif outcome.lines is None:
                now_s = block_s + look_s
                outcome = replace(
                    outcome,
                    own_s=round(now_s - float(later[0]), 2) if len(later) else None,
                    next_s=round(now_s - float(later[1]), 2)
                    if len(later) > 1
                    else None,
                    lines=int((later <= block_s).sum()),
                )
    last = [each for each in notices if not each.is_over]
    right = next((each for each in last if each.kind == NAMES.get(what)), None)
    return replace(
        outcome,
        said=tuple(each.kind for each in last),
        grade=tuple(each.grade for each in last),
        size_um=None if right is None else round(1e3 * right.size_mm, 3),
        sigma_um=None if right is None else round(1e3 * right.sigma_mm, 3),
        look_s=round(took, 3),
    )


def follow_live(run: Run) -> Iterator[tuple[float, tuple, float]]:
    """Yield time, notices and how long it took to look, after each line."""
    live = LiveEstimator(run.machine, run.commanded)
    for first in range(0, len(run.tracker), _BLOCK):
        block = run.tracker.select(slice(first, first + _BLOCK))
        begun = time.process_time()
        if live.add_block(block) and live.estimate() is not None:
            notices = live.list_notices()
            took_s = time.process_time() - begun
            yield float(block.device_time_s[-1]), notices, took_s


def find_ends(recording: Recording) -> np.ndarray:
    """Return when each line ends, or each point is left, on the tracker's clock."""
    moves = np.linalg.norm(np.diff(recording.commanded_mm, axis=0), axis=1) > 1e-6
    if recording.mode == "standstill":
        moves = ~moves
    return recording.time_s[1:][np.flatnonzero(np.diff(moves.astype(int)) < 0)]


def summarise(found: Sequence[Outcome]) -> str:
    head = [
        "what happens",
        "worlds",
        "told before, or of nothing",
        "noticed",
        "lines until then, median",
        "within 5 s of the line's end",
        "or of the next line's end",
        "right name at the end",
        "certain",
        "no name",
        "wrong name",
        "told size µm",
    ]
    rows: list[list[str]] = []
    for row, (what, *_) in ROWS.items():
        own = [one for one in found if one.row == row]
        if own:
            rows.append([row, str(len(own)), *_describe(own, what)])
    return table(head, rows)


def _describe(own: Sequence[Outcome], what: str) -> list[str]:
    false = sum(one.false > 0 for one in own)
    if what not in NAMES:
        return [str(false), *[""] * 9]
    seen = [one for one in own if one.lines is not None]
    soon = sum(one.own_s is not None and one.own_s <= 5.0 for one in seen)
    next_ = sum(
        (one.own_s is not None and one.own_s <= 5.0)
        or (one.next_s is not None and one.next_s <= 5.0)
        for one in seen
    )
    names: Counter[str] = Counter()
    for one in own:
        named = [name for name in one.said if name != "something-changed"]
        is_right = NAMES[what] in named
        names["right"] += is_right
        names["certain"] += is_right and "certain" in one.grade
        names["wrong"] += any(name != NAMES[what] for name in named)
        names["none"] += not named and bool(one.said)
    lines = [one.lines for one in seen if one.lines is not None]
    sizes = [one.size_um for one in own if one.size_um is not None]
    timed = what in ("knock", "play")
    return [
        str(false),
        f"{len(seen)}",
        f"{np.median(lines):.0f}" if lines else "",
        str(soon) if timed else "",
        str(next_) if timed else "",
        *(str(names[each]) for each in ("right", "certain", "none", "wrong")),
        f"{np.median(sizes):.1f}" if sizes else "",
    ]


def main() -> None:
    parser = make_parser(__doc__, KEPT)
    parser.add_argument("--only", default="", help="rows with this in their name")
    options = parser.parse_args()
    first = 0 if options.improve else REPORTED
    tasks = [
        (k / (options.share * count), row, first + k)
        for row, (*_, count) in ROWS.items()
        for k in range(max(1, round(options.share * count)))
        if options.only in row
    ]
    kept = map(Outcome.from_row, read_rows(options.kept))
    done = {(one.row, one.seed): one for one in kept}
    missing = [(row, seed) for _, row, seed in sorted(tasks) if (row, seed) not in done]
    rows = (asdict(play(*task)) for task in missing[: options.most])
    for one in map(Outcome.from_row, keep_rows(options.kept, rows)):
        done[one.row, one.seed] = one
        print(one, file=sys.stderr, flush=True)
    wanted = {(row, seed) for _, row, seed in tasks}
    text = summarise([one for key, one in done.items() if key in wanted])
    if options.improve:
        print(text)
    else:
        write_section("live-notices", text, DOCUMENT)


if __name__ == "__main__":
    main()
