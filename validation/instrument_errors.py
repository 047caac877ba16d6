"""Trackers within their specification: what is left, and whether it is stated.

Machines are those of `random_machines`. Each tracker has axes that neither meet nor
are square, circles, a beam, a reflector and air of its own, drawn from a specification
between half and twice the typical one, by bodies (`truepath_simulators`), not by the
formulas of the estimate. Judged by one place on the fly, one place at points, and two
places on the fly that share the tracker.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict

import numpy as np
from document import DOCUMENT, table, write_section
from judging import map_mm, true_map_mm, volume
from random_machines import FEED_MM_MIN, LINES
from recordings import plan_program, random_air, random_content, run_of

from truepath.alignment.align import align_all
from truepath.estimation.solve.batch import estimate
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic

MACHINES, POINTS = 12, 80
UNCERTAINTY = DOCUMENT.with_name("uncertainty.md")
WAYS = {
    "on the fly, one place": ("otf", 1),
    "on the fly, two places": ("otf", 2),
    "at points, one place": ("standstill", 1),
}


def draw_specification(seed: int) -> dict[str, float]:
    """Return a specification of half to twice what is typical, each key by itself."""
    rng = np.random.default_rng([seed, 3])
    usual = asdict(TrackerSpecification())
    return {key: size * 2.0 ** rng.uniform(-1.0, 1.0) for key, size in usual.items()}


def outcome(seed: int, mode: str, places: int) -> tuple[float, float, float]:
    """Return error left and stated in mm, and the share inside 95 % intervals."""
    content = random_content(seed)
    content["tracker"] |= {"rate_hz": 250, "specification": draw_specification(seed)}
    if mode == "otf":
        program = plan_program(content, FEED_MM_MIN, LINES)
    else:
        machine = parse_machine(content)
        program = paths.standstill_points(machine, seed, POINTS, dwell_s=0.5)
    setting = synthetic.Setting(air=random_air(seed), machine_seed=seed)
    made = [
        synthetic.record(content, program, seed + 1000 * k, mode, setting)
        for k in range(places)
    ]
    runs = [run_of(one) for one in made]
    seen = align_all(runs, [f"place {k + 1}" for k in range(places)])
    models = build_run_models(runs[0].machine, [one.at for one in seen])
    found = estimate(models, seen)
    within = volume(runs[0].machine)
    error, sigma = map_mm(within, found.model, found.theta, found.covariance)
    left = true_map_mm(within, made[0].truth) - error
    covered = within.share(np.abs(left) < 1.96 * sigma)
    return within.rms_length(left), within.rms_length(sigma), covered


def main() -> None:
    """Judge the machines and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    options, _ = parser.parse_known_args()
    rows = []
    for way, (mode, places) in WAYS.items():
        seeds = range(1, options.machines + 1)
        found = np.array([outcome(seed, mode, places) for seed in seeds])
        left, stated = 1e3 * np.sqrt((found[:, :2] ** 2).mean(axis=0))
        inside = found[:, 2]
        rows.append(
            [
                way,
                len(found),
                f"{left:.2f}",
                f"{stated:.2f}",
                f"**{inside.mean():.1%}**",
                f"{inside.min():.0%}",
            ]
        )
    head = ["measured", "machines", "left µm", "stated µm", "in 95 %", "least of one"]
    write_section("instrument-errors", table(head, rows), UNCERTAINTY)


if __name__ == "__main__":
    main()
