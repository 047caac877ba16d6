"""sanders-2023, section 2.3: on the fly against a simulated direct measurement.

Errors of the size of the paper's machine (mean about 7 µm), 2 500 mm/min, the paper's
kind of path; tables in the paper's conventions, squareness left out of the volumes. One
tool offset tells 14 of the 18 motions; where motions merge, the direct tables are
merged the same way before they are compared.

The direct measurement is as a multi-degree-of-freedom laser makes it: every error
motion of every axis on its own, forward and backward, five runs. The figures of that
instrument are assumptions, not those of any make.
"""

from __future__ import annotations

from dataclasses import dataclass

import figures
import numpy as np
from document import table, write_section
from figures import plt
from judging import Study, map_mm, study, true_parameters
from matplotlib.axes import Axes
from recordings import PERFECT, machine_content, papers_program

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion, make_error_motion
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.machine.machine import Machine
from truepath.kinematics.machine.symbols import (
    SQUARENESS,
    is_straightness,
    is_turn,
    list_error_motions,
)
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.worlds import synthetic

RUNS, STEP_MM, MARGIN_MM = 5, 25.0, 10.0
REPEATABILITY = {"um": 0.4, "urad": 1.0}
REVERSAL = {"um": 0.5, "urad": 0.5}


@dataclass(frozen=True)
class DirectTable:
    """One error motion; values (runs, 2, n), forward and backward, in mm or rad."""

    symbol: str
    position_mm: np.ndarray
    value: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Mean over runs and directions."""
        return self.value.mean(axis=(0, 1))


@dataclass(frozen=True)
class DirectMachine:
    """All 18 tables, and the volumetric error that they predict."""

    model: MachineModel
    theta: np.ndarray
    tables: dict[str, DirectTable]

    def deviation_mm(self, position_mm: np.ndarray) -> np.ndarray:
        """Return the volumetric error of the tables, squareness left out."""
        at = make_standstill(self.model.machine, position_mm)
        return self.model.jacobian(at) @ self.theta


def measure(machine: Machine, truth: TruthMachine, seed: int) -> DirectMachine:
    rng = np.random.default_rng(seed)
    tables, motions, theta = {}, [], []
    for axis in machine.linear_axes:
        low, high = axis.low + MARGIN_MM, axis.high - MARGIN_MM
        count = round((high - low) / STEP_MM) + 1
        position = np.linspace(low, high, count)
        for symbol in list_error_motions(axis.name):
            unit = "urad" if is_turn(symbol) else "um"
            scale = 1e-6 if is_turn(symbol) else 1e-3
            value = truth.error_motions()[symbol].at(position)
            half = 0.5 * scale * REVERSAL[unit] * rng.normal()
            noise = rng.normal(size=(RUNS, 2, count)) * scale * REPEATABILITY[unit]
            measured = value + half * np.array([1.0, -1.0])[:, None] + noise
            tables[symbol] = DirectTable(symbol, position, measured)
            motion = make_error_motion(symbol, axis, count - 1)
            fit = np.linalg.lstsq(
                motion.rows(position), tables[symbol].mean, rcond=None
            )[0]
            motions.append(motion)
            theta.append(fit)
    return DirectMachine(
        MachineModel(machine, tuple(motions)), np.concatenate(theta), tables
    )


def by_convention(symbol: str, values: np.ndarray) -> np.ndarray:
    """Return values along the first axis in the paper's convention.

    Straightness loses its end-point line; all else is 0 at the lowest position.
    """
    first, last = values[:1], values[-1:]
    if not is_straightness(symbol):
        return values - first
    share = np.linspace(0.0, 1.0, len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return values - (1.0 - share) * first - share * last


CONTENT = machine_content(
    "w-X-b-Y-Z-t", (600.0, 500.0, 460.0), (20.0, 30.0, -150.0), PERFECT
)
SEED, ERROR_SCALE, FEED_MM_MIN = 231, 0.4, 2500.0
PAPER = {"positioning": "< 10 µm", "straightness": "< 5 µm", "turns": "≤ 25 µrad"}


def main() -> None:
    program = papers_program(CONTENT, FEED_MM_MIN)
    setting = synthetic.Setting(error_scale=ERROR_SCALE)
    done = study(synthetic.record(CONTENT, program, SEED, "otf", setting))
    direct = measure(done.within.machine, done.recording.truth, SEED)
    merged = true_parameters(done.found.model, direct)
    write_section("direct-tables-2023", _tables_compared(done, direct, merged))
    _figures_6_to_8(done, direct, merged)
    _appendix(done, direct, merged)
    _volumes(done, merged)


def compare_to_direct(
    done: Study, direct: DirectMachine, merged: np.ndarray, motion: ErrorMotion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ours, its uncertainty and the direct one, at the direct positions."""
    part = done.found.model.slices[motion.symbol]
    rows = motion.rows(direct.tables[motion.symbol].position_mm)
    rows = by_convention(motion.symbol, rows) * _scale(motion.symbol)
    variance = np.einsum(
        "np,pq,nq->n", rows, done.found.covariance[part, part], rows, optimize=True
    )
    return (
        rows @ done.found.theta[part],
        np.sqrt(np.maximum(variance, 0.0)),
        rows @ merged[part],
    )


def _motions(model: MachineModel) -> dict[str, ErrorMotion]:
    return {e.symbol: e for e in model.effects if isinstance(e, ErrorMotion)}


def _list_merged_symbols(done: Study) -> dict[str, tuple[str, ...]]:
    """Return what one tool does not tell, with what it merges into."""
    _, merged = build_identifiable_model(done.within.machine, done.seen.at.offset_mm)
    return {m.symbol: m.partners for m in merged}


def _scale(symbol: str) -> float:
    return 1e6 if is_turn(symbol) else 1e3


def _tables_compared(done: Study, direct: DirectMachine, merged: np.ndarray) -> str:
    kinds: dict[str, list[np.ndarray]] = {kind: [] for kind in PAPER}
    inside: dict[str, list[float]] = {kind: [] for kind in PAPER}
    for symbol, motion in _motions(done.found.model).items():
        kind = "turns" if is_turn(symbol) else "positioning"
        kind = "straightness" if is_straightness(symbol) else kind
        ours, sigma, theirs = compare_to_direct(done, direct, merged, motion)
        kinds[kind].append(np.abs(ours - theirs))
        inside[kind].append(float((2.0 * sigma).max()))
    rows = [
        [
            kind,
            len(parts),
            PAPER[kind],
            f"{max(float(p.max()) for p in parts):.2f}",
            f"{np.concatenate(parts).mean():.2f}",
            f"{max(inside[kind]):.2f}",
        ]
        for kind, parts in kinds.items()
    ]
    head = ["µm, µrad", "motions", "paper", "largest", "mean", "largest stated 2u"]
    return table(head, rows)


def _figures_6_to_8(done: Study, direct: DirectMachine, merged: np.ndarray) -> None:
    figure, panels = plt.subplots(1, 3, figsize=(10.0, 2.8))
    for panel, symbol in zip(panels, ("EXX", "EYX", "ECX"), strict=True):
        _panel(panel, symbol, done, direct, merged)
    figure.tight_layout()
    figures.save(figure, "2023-figures-6-to-8.svg")


def _appendix(done: Study, direct: DirectMachine, merged: np.ndarray) -> None:
    figure, panels = plt.subplots(6, 3, figsize=(9.4, 10.2))
    for column, axis in enumerate("XYZ"):
        for row, symbol in enumerate(list_error_motions(axis)):
            _panel(panels[row, column], symbol, done, direct, merged)
    figure.tight_layout()
    figures.save(figure, "2023-appendix.png")


def _panel(
    panel: Axes, symbol: str, done: Study, direct: DirectMachine, merged: np.ndarray
) -> None:
    """Direct forward blue and backward green with bars over runs, ours red."""
    lost, motions = _list_merged_symbols(done), _motions(done.found.model)
    unit = "µrad" if is_turn(symbol) else "µm"
    panel.set_title(f"{symbol}, {unit}", fontsize=8)
    panel.tick_params(labelsize=7)
    measured = direct.tables[symbol]
    place = measured.position_mm
    if symbol in lost:
        panel.set_axis_off()
        into = ", ".join(lost[symbol]) or "nothing"
        text = f"one tool does not tell it\nmerges into {into}"
        panel.text(0.5, 0.5, text, ha="center", va="center", fontsize=8)
        return
    ours, sigma, theirs = compare_to_direct(done, direct, merged, motions[symbol])
    panel.fill_between(place, ours - 2 * sigma, ours + 2 * sigma, color="#f2c1bb")
    panel.plot(place, ours, color=figures.OURS, lw=1.2)
    if any(symbol in into for into in lost.values()):
        panel.plot(place, theirs, "--", color=figures.TRUTH, lw=1)
        return
    for direction, color in enumerate((figures.TRUTH, figures.DATA)):
        runs = _scale(symbol) * by_convention(symbol, measured.value[:, direction].T)
        bar = runs.std(axis=1, ddof=1)
        panel.errorbar(
            place, runs.mean(axis=1), bar, fmt=".", ms=2, lw=0.6, color=color
        )


def _volumes(done: Study, merged: np.ndarray) -> None:
    model, theta = done.found.model, done.found.theta.copy()
    for symbol in SQUARENESS:
        theta[model.slices[symbol]] = 0.0
        merged[model.slices[symbol]] = 0.0
    nothing = np.zeros_like(done.found.covariance)
    ours, _ = map_mm(done.within, model, theta, nothing)
    theirs, _ = map_mm(done.within, model, merged, nothing)
    mean = [1e3 * done.within.mean_length(v) for v in (theirs, ours, ours - theirs)]
    head = ["mean volumetric error", "direct µm", "on the fly µm", "difference µm"]
    rows = [
        ["sanders-2023, measured", "7.2", "6.9", "2.65"],
        ["simulated", *(f"{value:.2f}" for value in mean)],
    ]
    write_section("direct-volume-2023", table(head, rows))
    _figure_9(done, 1e3 * (ours - theirs))


def _figure_9(done: Study, difference_um: np.ndarray) -> None:
    figure = plt.figure(figsize=(9.5, 3.6))
    for row, name in enumerate("XYZ"):
        panel = figure.add_subplot(3, 2, 2 * row + 1)
        panel.hist(
            difference_um[:, row],
            bins=41,
            density=True,
            color=figures.OURS,
            weights=done.within.weight,
        )
        panel.set_ylabel(name, rotation=0, fontsize=8)
        panel.tick_params(labelsize=7)
    panel.set_xlabel("on the fly − direct, µm", fontsize=8)
    space = figure.add_subplot(1, 2, 2, projection="3d")
    some = np.arange(0, len(difference_um), 5)
    space.quiver(
        *done.within.position_mm[some].T,
        *(50.0 * difference_um[some].T),
        color=figures.OURS,
        lw=0.6,
    )
    space.set_title("difference, 1 µm drawn as 50 mm", fontsize=8)
    space.tick_params(labelsize=7)
    figure.subplots_adjust(hspace=0.5)
    figures.save(figure, "2023-figure-9.png")


if __name__ == "__main__":
    main()
