"""What the data along the travel are worth on corner-to-corner paths.

Twenty random machines drive edges, face and space diagonals; the same recording is
solved across the path only, as sanders-2023 does, and with the direction of travel.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from judging import study
from recordings import random_air, random_content

from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic

MACHINES, FEED_MM_MIN = 20, 10_000.0


@dataclass(frozen=True)
class Outcome:
    """Mean length of the error left on one machine, in mm, either way."""

    seed: int
    before: float
    across_only: float
    with_along: float

    @property
    def ratio(self) -> float:
        """Left with the direction of travel over left without."""
        return self.with_along / self.across_only


def outcome(seed: int) -> Outcome:
    content = random_content(seed)
    program = paths.corner_path(parse_machine(content), FEED_MM_MIN)
    setting = synthetic.Setting(air=random_air(seed))
    recording = synthetic.record(content, program, seed, "otf", setting)
    both = study(recording)
    across = study(recording, perpendicular_only=True, seen=both.seen)
    mean = both.within.mean_length
    return Outcome(seed, mean(both.truth_mm), mean(across.left_mm), mean(both.left_mm))


def outcomes(machines: int = MACHINES) -> list[Outcome]:
    return [outcome(seed) for seed in range(1, machines + 1)]


def summary(found: list[Outcome]) -> str:
    columns = {
        "before µm": [1e3 * o.before for o in found],
        "left, across only µm": [1e3 * o.across_only for o in found],
        "left, with the direction of travel µm": [1e3 * o.with_along for o in found],
        "ratio": [o.ratio for o in found],
    }
    rows = [
        [name, *(f"{float(f(values)):.2f}" for f in (np.median, np.min, np.max))]
        for name, values in columns.items()
    ]
    return table([f"{len(found)} machines", "median", "least", "most"], rows)


def main() -> None:
    found = outcomes()
    write_section("along-the-path", summary(found))
    figure, panel = plt.subplots(figsize=(4.2, 3.6))
    across = np.array([1e3 * o.across_only for o in found])
    panel.plot(across, [1e3 * o.with_along for o in found], "o", color=figures.OURS)
    top = 1.05 * across.max()
    panel.plot([0.0, top], [0.0, top], color="black", lw=0.6)
    panel.plot([0.0, top], [0.0, top / 2], "--", color="black", lw=0.6)
    panel.set_xlabel("left across the path only, µm")
    panel.set_ylabel("left with the direction of travel, µm")
    figures.save(figure, "along-the-path.svg")


if __name__ == "__main__":
    main()
