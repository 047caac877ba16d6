"""Measurements that are disturbed: what is left, and what the verdict says.

Valid samples in the wrong place, a tracker that freezes, a set-up that is knocked; a
machine drawn anew for each row. No row may be wrong and call itself usable: wrong is a
mean error left above 6 % of what there was, or fewer than 85 % inside 2 u.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from document import table, write_section
from judging import map_mm, true_map_mm, volume
from recordings import planned_program, random_content, run_of

from app.errors import TruepathError
from app.files.run import Run
from app.results.analysis import analyse
from simulators.synthetic import Setting, record

SEED, FEED_MM_MIN, LINES = 7001, 5000.0, 40
_MOST_LEFT, _FEWEST_INSIDE = 0.06, 0.85
Stream = tuple[np.ndarray, np.ndarray, np.random.Generator]
Disturb = Callable[[Stream], np.ndarray]


def burst(size_mm: float, samples: int, times: int = 1) -> Disturb:
    """Set samples aside, anywhere: on lines, ramps, at stops, across corners."""

    def disturb(stream: Stream) -> np.ndarray:
        _, position_mm, rng = stream
        moved = position_mm.copy()
        for _ in range(times):
            first = int(rng.integers(2000, len(moved) - samples - 2000))
            aside = rng.normal(size=3)
            moved[first : first + samples] += size_mm * aside / np.linalg.norm(aside)
        return moved

    return disturb


def flip(samples: int) -> Disturb:
    """Lose the sign of one coordinate for a while."""

    def disturb(stream: Stream) -> np.ndarray:
        _, position_mm, rng = stream
        moved = position_mm.copy()
        first = int(rng.integers(2000, len(moved) - samples - 2000))
        moved[first : first + samples, int(rng.integers(3))] *= -1.0
        return moved

    return disturb


def freeze(duration_s: float) -> Disturb:
    """Repeat one value for a while."""

    def disturb(stream: Stream) -> np.ndarray:
        _, position_mm, rng = stream
        moved, samples = position_mm.copy(), int(500 * duration_s)
        first = int(rng.integers(2000, len(moved) - samples - 2000))
        moved[first : first + samples] = moved[first]
        return moved

    return disturb


def knock(*size_um: float, drift_um: float = 0.0) -> Disturb:
    """Shift the tracker at even distances of time, and let it drift beside."""

    def disturb(stream: Stream) -> np.ndarray:
        time_s, position_mm, rng = stream
        share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
        moved = position_mm + 1e-3 * drift_um * share[:, None] * np.ones(3) / 3**0.5
        for number, size in enumerate(size_um, start=1):
            aside = rng.normal(size=3)
            shift = 1e-3 * size * aside / np.linalg.norm(aside)
            moved[share > number / (len(size_um) + 1.0) + 0.013] += shift
        return moved

    return disturb


CASES: dict[str, Disturb | None] = {
    "nothing": None,
    "sign lost, 100 samples": flip(100),
    "sign lost, 1 500 samples": flip(1500),
    **{
        f"{1e3 * size:.0f} µm aside, {samples} samples": burst(size, samples)
        for size in (5.0, 0.1, 0.04)
        for samples in (20, 50, 200, 700, 2000)
    },
    "100 µm aside, 10 times 100 samples": burst(0.1, 100, 10),
    "5 mm aside, 10 times 100 samples": burst(5.0, 100, 10),
    "frozen for 0.5 s": freeze(0.5),
    "frozen for 5 s": freeze(5.0),
    **{f"knock of {size} µm": knock(size) for size in (5, 10, 20, 50, 200, 500)},
    "knocks of 50 and 80 µm": knock(50, 80),
    "drift of 30 µm": knock(drift_um=30.0),
    "knock of 50 µm, drift of 30 µm": knock(50, drift_um=30.0),
}


def judge(name: str, seed: int) -> list[str]:
    """Return one row: error left, inside 2 u, verdict, whether that is right."""
    content = random_content(seed)
    recording = record(
        content, planned_program(content, FEED_MM_MIN, LINES), seed, setting=Setting()
    )
    run: Run = run_of(recording)
    disturb = CASES[name]
    if disturb is not None:
        stream = run.tracker.device_time_s, run.tracker.position_mm
        moved = disturb((*stream, np.random.default_rng([seed, 5])))
        run = replace(run, tracker=replace(run.tracker, position_mm=moved))
    try:
        found = analyse(run)
    except TruepathError as error:
        return [name, "", "", f"refused: {str(error)[:60]}", "yes"]
    within = volume(run.machine)
    truth = true_map_mm(within, recording.truth)
    told = found.estimate
    map_, sigma = map_mm(within, told.model, told.theta, told.covariance)
    left = truth - within.rigid_free(map_)
    share = within.mean_length(left) / within.mean_length(truth)
    inside = within.share(np.abs(left) < 2.0 * sigma)
    wrong = share > _MOST_LEFT or inside < _FEWEST_INSIDE
    right = not (wrong and found.verdict.state == "usable")
    kinds = sorted({reason.kind for reason in found.verdict.reasons})
    said = f"{found.verdict.state}: {', '.join(kinds)}".removesuffix(": ")
    row = [name, f"{share:.1%}", f"{inside:.0%}", said, "yes" if right else "**no**"]
    print(seed, *row, sep=" | ", file=sys.stderr, flush=True)
    return row


def main() -> None:
    """Write the table."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    rows = [judge(name, SEED + k) for k, name in enumerate(CASES)]
    head = ["disturbance", "error left", "inside 2 u", "verdict", "right or said"]
    write_section("disturbed", table(head, rows))


if __name__ == "__main__":
    main()
