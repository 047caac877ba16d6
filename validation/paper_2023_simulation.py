"""sanders-2023, section 2.1: errors of 103 µm on a grid, found again from the path.

The nine steps of the paper: its kind of path, a random machine, the stream of a tracker
anywhere beside it, alignment, error tables, then prediction on the path and on a grid.
The truth composes exact transforms and shares no code with the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from judging import Study, Volume, map_mm, study, volume
from recordings import PERFECT, machine_content, papers_program

from truepath.files.bundle.machine_file import machine_from_json
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.worlds import synthetic

CONTENT = machine_content(
    "w-X-b-Y-Z-t", (600.0, 500.0, 460.0), (20.0, 30.0, -150.0), PERFECT
)
SEEDS = (2023, 2024, 2025)
FEED_MM_MIN = 2500.0
GRID_UM = 103.0  # mean volumetric error of the paper's simulated machine
PAPER = ["sanders-2023, noise-free", "117", "0.95", "0.81%", "103", "0.87", "0.84%"]


@dataclass(frozen=True)
class OnPath:
    """Deviations across the travel at the cells of the path, mean lengths in mm."""

    place: Volume
    before: np.ndarray
    left: np.ndarray


def record_machine(seed: int, noise_scale: float) -> synthetic.Recording:
    """Record a machine whose volumetric error has the size of the paper's."""
    within = volume(machine_from_json(dict(CONTENT), file="machine.json"))
    truth = random_machine(parse_machine(CONTENT), seed)
    unit = within.mean_length(within.rigid_free(truth.deviation_mm(within.position_mm)))
    return _recording(seed, 1e-3 * GRID_UM / unit, noise_scale)


def on_path(of: Study) -> OnPath:
    """Judge on the path, as the paper's self-test."""
    seen = of.seen
    count = len(seen)
    place = Volume(of.within.machine, seen.at.position_mm, np.full(count, 1 / count))
    before = place.rigid_free(of.recording.truth.deviation_mm(place.position_mm))
    found, _ = map_mm(place, of.found.model, of.found.theta, of.found.covariance)
    left = before - place.rigid_free(found)
    return OnPath(place, _across(before, seen.direction), _across(left, seen.direction))


def main() -> None:
    rows = [PAPER]
    for noise_scale, name in ((0.0, "noise-free"), (1.0, "tracker noise")):
        for seed in SEEDS:
            for across in (False, True):
                done = study(
                    record_machine(seed, noise_scale), perpendicular_only=across
                )
                label = f"machine {seed}, {name}"
                label += ", across the path only" if across else ""
                rows.append([label, *_numbers(done)])
                if seed == SEEDS[0] and noise_scale and not across:
                    _figure_4(done)
    head = ["", "path µm", "left µm", "share", "grid µm", "left µm", "share"]
    write_section("simulation-2023", table(head, rows))


def _recording(
    seed: int, error_scale: float, noise_scale: float
) -> synthetic.Recording:
    setting = synthetic.Setting(error_scale=error_scale, noise_scale=noise_scale)
    program = papers_program(CONTENT, FEED_MM_MIN)
    return synthetic.record(CONTENT, program, seed, "otf", setting)


def _numbers(done: Study) -> list[str]:
    path = on_path(done)
    before, left = (path.place.mean_length(v) for v in (path.before, path.left))
    grid, grid_left = (
        done.within.mean_length(v) for v in (done.truth_mm, done.left_mm)
    )
    return [
        f"{1e3 * before:.0f}",
        f"{1e3 * left:.2f}",
        f"{left / before:.2%}",
        f"{1e3 * grid:.0f}",
        f"{1e3 * grid_left:.2f}",
        f"{grid_left / grid:.2%}",
    ]


def _across(error: np.ndarray, direction: np.ndarray) -> np.ndarray:
    along = np.einsum("ni,ni->n", error, direction)
    return error - along[:, None] * direction


def _figure_4(done: Study) -> None:
    path = on_path(done)
    figure = plt.figure(figsize=(9.0, 3.8))
    pairs = (
        (path.place.position_mm[::2], path.left[::2], "on the path, across it"),
        (done.within.position_mm, done.left_mm, "on the grid"),
    )
    for number, (position, left, name) in enumerate(pairs, 1):
        panel = figure.add_subplot(1, 2, number, projection="3d")
        length = 1e3 * np.linalg.norm(left, axis=1)
        points = panel.scatter(*position.T, c=length, s=3, cmap="viridis", vmin=0.0)
        panel.set_title(f"left {name}, µm", fontsize=9)
        panel.tick_params(labelsize=7)
        figure.colorbar(points, ax=panel, shrink=0.6, pad=0.1)
    figures.save(figure, "2023-figure-4.png")


if __name__ == "__main__":
    main()
