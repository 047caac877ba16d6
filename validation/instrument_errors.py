"""Trackers within their specification: what is left, and whether it is stated.

Each tracker has axes that neither meet nor are square, circles, a beam, a reflector and
air of its own, drawn from a specification between half and twice the typical one, by
bodies (`truepath_simulators`), not by the formulas of the estimate. The bound is what
linear information leaves with the same priors (`information_bound`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from document import DOCUMENT, table, write_section
from few_targets import KINDS, draw_machine, measure
from five_axes import map_mm as map_turning_mm
from five_axes import root_mean_square
from information_bound import ideal
from judging import map_mm, true_map_mm, volume
from large_machines import FEED_MM_MIN as GANTRY_FEED_MM_MIN
from large_machines import WORLDS, draw_gantry
from random_machines import FEED_MM_MIN, LINES
from recordings import plan_program, random_air, random_content, run_of

from truepath.alignment.align import align_all
from truepath.estimation.problem.knots import merge_cells
from truepath.results.analysis import analyse
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds import synthetic

MACHINES, GANTRIES, POINTS, GANTRY = 36, 10, 80, WORLDS[1]
UNCERTAINTY = DOCUMENT.with_name("uncertainty.md")
ROTARY = [kind for kind in KINDS if kind != "three axes"]


@dataclass(frozen=True)
class Outcome:
    """One measurement; root mean square lengths over the travel in mm.

    bound : what an ideal estimator leaves on average; inside : share of the components
        within 2u; usable : by its own verdict
    """

    left: float
    stated: float
    bound: float
    inside: float
    usable: bool


def plan_lines(content: dict[str, Any], seed: int) -> Program:
    del seed
    return plan_program(content, FEED_MM_MIN, LINES)


def plan_points(content: dict[str, Any], seed: int) -> Program:
    return paths.standstill_points(parse_machine(content), seed, POINTS, dwell_s=0.5)


def plan_gantry(content: dict[str, Any], seed: int) -> Program:
    machine = parse_machine(content)
    return paths.chord_path(machine, seed, 60, GANTRY_FEED_MM_MIN)


def judge_linear(
    content: dict[str, Any],
    plan: Callable[[dict[str, Any], int], Program],
    seed: int,
    places: int,
) -> Outcome:
    """Measure a machine without rotary axes from places that share the tracker."""
    content["tracker"]["rate_hz"] = 250
    program, air = plan(content, seed), random_air(seed)
    mode = "standstill" if plan is plan_points else "otf"
    setting = synthetic.Setting(air=air, machine_seed=seed, sensors=False)
    made = [
        synthetic.record(content, program, seed + 1000 * k, mode, setting)
        for k in range(places)
    ]
    runs = [run_of(one) for one in made]
    findings = analyse(*runs)
    found, within = findings.estimate, volume(runs[0].machine)
    error, sigma = map_mm(within, found.model, found.theta, found.covariance)
    left = true_map_mm(within, made[0].truth) - error
    seen = align_all(runs, [f"place {k + 1}" for k in range(places)])
    if len(found.runs) == places:  # no set-up was split
        seen = merge_cells(seen, found.model)
        bound = ideal(within, seen, found, made[0], air).bound_mm
    else:
        bound = np.nan
    return Outcome(
        within.rms_length(left),
        within.rms_length(sigma),
        bound,
        within.share(np.abs(left) < 2.0 * sigma),
        findings.verdict.state == "usable",
    )


def judge_turning(seed: int) -> Outcome:
    """Measure a machine with rotary axes at points."""
    content = draw_machine(ROTARY[seed % len(ROTARY)], seed)
    run, truth = measure(content, seed)
    findings = analyse(run)
    machine = parse_machine(content)
    _, left, sigma = map_turning_mm(findings.estimate, machine, truth, "T1", seed)
    return Outcome(
        root_mean_square(left),
        root_mean_square(sigma),
        np.nan,
        float((np.abs(left) < 2.0 * sigma).mean()),
        findings.verdict.state == "usable",
    )


WAYS: dict[str, Callable[[int], Outcome]] = {
    "three axes, on the fly, one place": lambda seed: judge_linear(
        random_content(seed), plan_lines, seed, 1
    ),
    "three axes, on the fly, two places": lambda seed: judge_linear(
        random_content(seed), plan_lines, seed, 2
    ),
    "three axes, at points, one place": lambda seed: judge_linear(
        random_content(seed), plan_points, seed, 1
    ),
    "three axes, at points, two places": lambda seed: judge_linear(
        random_content(seed), plan_points, seed, 2
    ),
    "rotary axes, at points, one place": judge_turning,
    "6 m gantry, on the fly, one place": lambda seed: judge_linear(
        draw_gantry(GANTRY, seed), plan_gantry, seed, 1
    ),
    "6 m gantry, on the fly, two places": lambda seed: judge_linear(
        draw_gantry(GANTRY, seed), plan_gantry, seed, 2
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--gantries", type=int, default=GANTRIES)
    options, _ = parser.parse_known_args()
    rows: list[list[str]] = []
    every: list[Outcome] = []
    for way, judge in WAYS.items():
        found: list[Outcome] = []
        count = options.gantries if "gantry" in way else options.machines
        for seed in range(1, count + 1):
            found.append(judge(seed))
            print(way, seed, found[-1], flush=True)
        rows.append(_row(way, found))
        every += found
    rows.append(_row("all", every))
    head = [
        "measured",
        "machines",
        "left µm",
        "stated µm",
        "bound µm",
        "inside 2u",
        "usable",
        "least of those",
    ]
    write_section("instrument-errors", table(head, rows), UNCERTAINTY)


def _row(way: str, found: list[Outcome]) -> list[str]:
    left, stated, bound = (
        f"{1e3 * np.sqrt(np.nanmean([getattr(o, key) ** 2 for o in found])):.2f}"
        if any(np.isfinite(getattr(o, key)) for o in found)
        else ""
        for key in ("left", "stated", "bound")
    )
    inside = [o.inside for o in found]
    trusted = [o.inside for o in found if o.usable]
    return [
        way,
        str(len(found)),
        left,
        stated,
        bound,
        f"**{np.mean(inside):.1%}**",
        str(len(trusted)),
        f"{min(trusted):.0%}" if trusted else "",
    ]


if __name__ == "__main__":
    main()
