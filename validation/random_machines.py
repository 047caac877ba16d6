"""Twenty random machines: the error left against the information bound, and coverage.

Chains, travels, tools, tracker places and the correlated share of the noise are drawn;
each machine is measured once, on our own path.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from information_bound import ideal
from judging import Study, study, table_deviations, true_parameters
from recordings import plan_program, random_air, random_content

from truepath_simulators.worlds import synthetic

MACHINES, LINES, FEED_MM_MIN = 20, 24, 6000.0


@dataclass(frozen=True)
class Outcome:
    """One machine; root mean square lengths over the volume, in mm.

    bound : what the ideal estimator would leave on average; ideal : what it leaves here
    stated : what the estimate itself states
    map_covered, tables_covered : share of truth in 95 % intervals
    """

    seed: int
    chain: str
    before: float
    left: float
    bound: float
    ideal: float
    stated: float
    map_covered: float
    tables_covered: float


def outcome(seed: int) -> Outcome:
    """Record, estimate and judge one machine."""
    content, air = random_content(seed), random_air(seed)
    program = plan_program(content, FEED_MM_MIN, LINES)
    setting = synthetic.Setting(air=air)
    done = study(synthetic.record(content, program, seed, "otf", setting))
    best = ideal(done.within, [done.seen], done.found, done.recording, air)
    rms = done.within.rms_length
    return Outcome(
        seed,
        content["kinematic_chain"],
        rms(done.truth_mm),
        rms(done.left_mm),
        best.bound_mm,
        rms(done.truth_mm - best.error_mm),
        rms(done.sigma_mm),
        done.covered,
        _tables_covered(done),
    )


def ratio(outcomes: list[Outcome]) -> float:
    """Return the error left over the bound, root mean squares over the machines."""
    left, bound = (
        np.array([getattr(o, k) for o in outcomes]) for k in ("left", "bound")
    )
    return float(np.sqrt(np.mean(left**2) / np.mean(bound**2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    options, _ = parser.parse_known_args()
    outcomes = [outcome(seed) for seed in range(1, options.machines + 1)]
    write_section("random-machines", _table(outcomes))
    _figure(outcomes)


def _tables_covered(done: Study) -> float:
    truth = true_parameters(done.found.model, done.recording.truth)
    found = done.found
    off, sigma, _ = table_deviations(found.model, found.theta, found.covariance, truth)
    return float((np.abs(off) < 1.96 * sigma).mean())


def _table(outcomes: list[Outcome]) -> str:
    rows = [
        [
            f"{o.seed}: {o.chain}",
            f"{1e3 * o.before:.1f}",
            f"{1e3 * o.left:.2f}",
            f"{1e3 * o.bound:.2f}",
            f"{1e3 * o.ideal:.2f}",
            f"{1e3 * o.stated:.2f}",
            f"{o.left / o.bound:.2f}",
            f"{o.map_covered:.1%}",
            f"{o.tables_covered:.1%}",
        ]
        for o in outcomes
    ]
    keys = ("before", "left", "bound", "ideal", "stated")
    total = [
        float(np.sqrt(np.mean([getattr(o, key) ** 2 for o in outcomes])))
        for key in keys
    ]
    covered = [
        float(np.mean([getattr(o, key) for o in outcomes]))
        for key in ("map_covered", "tables_covered")
    ]
    rows.append(
        [
            "**all**",
            f"{1e3 * total[0]:.1f}",
            *[f"{1e3 * value:.2f}" for value in total[1:]],
            f"**{ratio(outcomes):.2f}**",
            *[f"**{value:.1%}**" for value in covered],
        ]
    )
    head = [
        "machine",
        "before µm",
        "left µm",
        "bound µm",
        "ideal here µm",
        "stated µm",
        "left / bound",
        "map in 95 %",
        "tables in 95 %",
    ]
    return table(head, rows)


def _figure(outcomes: list[Outcome]) -> None:
    figure, panel = plt.subplots(figsize=(4.2, 3.6))
    bound, left, best = (
        1e3 * np.array([getattr(o, key) for o in outcomes])
        for key in ("bound", "left", "ideal")
    )
    top = 1.1 * max(left.max(), best.max())
    panel.plot([0.0, top], [0.0, top], color="black", lw=0.6, label="the bound")
    panel.plot(bound, best, "o", mfc="none", color=figures.PAPER, label="ideal")
    panel.plot(bound, left, "o", color=figures.OURS, label="ours")
    panel.set_xlabel("information bound, µm")
    panel.set_ylabel("left on this recording, µm")
    panel.legend(fontsize=8)
    figures.save(figure, "random-machines.svg")


if __name__ == "__main__":
    main()
