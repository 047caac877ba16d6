"""sanders-2023, section 2.2: four feeds and the standstill method, 200 points to judge.

One machine of small errors (the paper's residuals are microns) is calibrated at every
feed and at 226 standstills; all predict the same 200 random points. Judged twice: by
the exact truth, and as the paper could, by a measurement of these points at standstill.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from judging import Study, study
from recordings import (
    PERFECT,
    duration_s,
    machine_content,
    papers_program,
    plan_program,
    run_of,
)

from truepath.alignment.align import align
from truepath.alignment.stream.sequence import fit_rigid
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

CONTENT = machine_content(
    "w-X-b-Y-Z-t", (600.0, 500.0, 460.0), (20.0, 30.0, -150.0), PERFECT
)
MACHINE = machine_from_json(dict(CONTENT), file="machine.json")
SEED, ERROR_SCALE, PLANNED_LINES = 630, 0.5, 31
FEEDS_MM_MIN = (2500.0, 5000.0, 10_000.0, 15_000.0)
PAPER_MINUTES = {2500.0: "24", 5000.0: "10", 10_000.0: "5.5", 15_000.0: "4"}


@dataclass(frozen=True)
class Reference:
    """The 200 points: where they were measured, and the exact truth there."""

    position_mm: np.ndarray
    measured_mm: np.ndarray
    truth_mm: np.ndarray


def main() -> None:
    reference = measure_reference()
    rows, bars = [], []
    uncompensated = measure_left(reference, None)
    rows.append(["uncompensated", "", "", *_um(uncompensated), ""])
    bars.append(("uncompensated", uncompensated[1]))
    for name, paper, program, across in _procedures():
        mode = "standstill" if "standstill" in name else "otf"
        recording = synthetic.record(CONTENT, program, SEED, mode, _setting())
        done = study(recording, perpendicular_only=across)
        judged = measure_left(reference, done)
        minutes = f"{duration_s(recording) / 60.0:.1f}"
        rows.append([name, paper, minutes, *_um(judged), f"{done.covered:.1%}"])
        bars.append((name, judged[1]))
    head = [
        "",
        "paper min",
        "min",
        "left by truth µm",
        "left as measured µm",
        "in 95 %",
    ]
    write_section("feeds-2023", table(head, rows))
    _figure_5(bars)


def measure_reference() -> Reference:
    """Measure 200 random points at standstill, from another place of the tracker."""
    machine = parse_machine(CONTENT)
    points = paths.standstill_points(machine, SEED + 1, 192)
    recording = synthetic.record(CONTENT, points, SEED, "standstill", _setting())
    seen = align(run_of(recording))
    rows = np.unique(seen.row)
    total = np.array(
        [seen.count[seen.row == r] @ seen.tracker_mm[seen.row == r] for r in rows]
    )
    count = np.array([seen.count[seen.row == r].sum() for r in rows])
    position = points.position[rows]
    truth = recording.truth.deviation_mm(position)
    return Reference(position, total / count[:, None], truth)


def measure_left(reference: Reference, done: Study | None) -> tuple[float, float]:
    """Return the mean length left at the points, by truth and as measured, in mm."""
    at = make_standstill(MACHINE, reference.position_mm)
    predicted = np.zeros((len(at), 3))
    if done is not None:
        predicted = build_volumetric_map(done.found.model).error_mm(
            at, done.found.theta
        )
    expected = at.point_mm + predicted
    true = at.point_mm + reference.truth_mm
    return _apart(expected, true), _apart(expected, reference.measured_mm)


def _procedures() -> list[tuple[str, str, Program, bool]]:
    machine = parse_machine(CONTENT)
    found: list[tuple[str, str, Program, bool]] = []
    for feed in FEEDS_MM_MIN:
        path, minutes = papers_program(CONTENT, feed), PAPER_MINUTES[feed]
        found.append((f"paper's path, across only, {feed:.0f}", minutes, path, True))
        found.append((f"paper's path, {feed:.0f}", minutes, path, False))
        planned = plan_program(CONTENT, feed, PLANNED_LINES)
        found.append((f"our path, {feed:.0f}", "", planned, False))
    points = paths.standstill_points(machine, SEED, 218)
    found.append(("standstill, 226 points", "18", points, False))
    return found


def _setting() -> synthetic.Setting:
    return synthetic.Setting(error_scale=ERROR_SCALE)


def _apart(expected_mm: np.ndarray, there_mm: np.ndarray) -> float:
    """Return the mean distance after the best rigid fit."""
    moved = fit_rigid(expected_mm, there_mm).apply(expected_mm)
    return float(np.linalg.norm(moved - there_mm, axis=1).mean())


def _um(judged: tuple[float, float]) -> list[str]:
    return [f"{1e3 * value:.2f}" for value in judged]


def _figure_5(bars: list[tuple[str, float]]) -> None:
    figure, panel = plt.subplots(figsize=(8.0, 3.6))
    names = [name for name, _ in bars]
    colors = [
        figures.PAPER if "across" in n or n == names[0] else figures.OURS for n in names
    ]
    panel.barh(names, [1e3 * value for _, value in bars], color=colors)
    for row, (_, value) in enumerate(bars):
        panel.text(1e3 * value, row, f" {1e3 * value:.2f}", va="center", fontsize=8)
    panel.invert_yaxis()
    panel.set_xlabel("mean distance to 200 points measured at standstill, µm")
    figure.tight_layout()
    figures.save(figure, "2023-figure-5.svg")


if __name__ == "__main__":
    main()
