"""Random machines with rotary axes, and how little of each its targets may tell.

Judged are the tables, and the error of the measured tool and of one of another length
that nobody measured, against the exact transforms of the simulators.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from document import table, write_section
from few_targets import KINDS, OTHER, draw_machine, measure
from information_bound import true_noise
from target_seats import remove_rigid_motion

from truepath.alignment.align import align_all
from truepath.alignment.observations.observations import Observations
from truepath.estimation.problem.design_matrix import linearise
from truepath.estimation.problem.information import compute_posterior
from truepath.estimation.problem.normal_equations import compute_information
from truepath.estimation.solve.batch import Estimate, estimate
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.model import EstimatedModel
from truepath.kinematics.volumetric_map import build_volumetric_map
from truepath.results.error_tables import build_error_tables
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.truth_machine import TruthMachine, perfect
from truepath_simulators.machine_file import MachineFile, parse_machine
from truepath_simulators.worlds import synthetic

MACHINES, FIRST_SEED, GRID = 20, 1001, 300
SHAPES = 8  # of an error motion here: four harmonics, a sine and a cosine each
DRAWS = 200  # of machines of the same make, for what the ideal estimator knows
# Which of its straight line's slope each squareness has, with the other's of the pair.
SQUARENESS = {"C0Y": ("EXY", "EYX", -1.0), "B0Z": ("EXZ", "EZX", 1.0)}
SQUARENESS["A0Z"] = ("EYZ", "EZY", -1.0)


@dataclass(frozen=True)
class Score:
    """Root mean square lengths over the travel in µm; the share of components in 2u.

    bound : what an ideal estimator would leave on average; ideal : what it leaves here
    """

    before: float
    left: float
    bound: float
    ideal: float
    inside: float


@dataclass(frozen=True)
class Outcome:
    """One machine: places on the tool and on the table, scores, table values in 2u."""

    seed: int
    chain: str
    places: tuple[int, int]
    maps: dict[str, Score]
    off: dict[str, np.ndarray]

    def tables_inside(self) -> float:
        """Return the share of all values of tables and numbers inside 2u."""
        return float((np.abs(np.concatenate(list(self.off.values()))) < 2.0).mean())


def judge(kind: str, seed: int) -> Outcome:
    content = draw_machine(kind, seed)
    run, _ = measure(content, seed)
    (seen,) = align_all([run], [run.name])
    found = estimate(build_run_models(seen.at.machine, [seen.at]), [seen])
    machine = parse_machine(content)
    truth = random_machine(machine, seed)
    ideal = estimate_ideally(seen, found, machine, truth)
    maps: dict[str, Score] = {}
    for name in ("T1", OTHER):
        before, left, sigma = map_mm(found, machine, truth, name, seed)
        _, rest, bound = map_mm(ideal, machine, truth, name, seed)
        inside = np.abs(left) < 2.0 * sigma
        sizes = [1e3 * root_mean_square(v) for v in (before, left, bound, rest)]
        maps[name] = Score(*sizes, float(inside.mean()))
    targets = list(content["targets"])[:-1]
    on_tool = sum(name.startswith("T") for name in targets)
    places = on_tool, len(targets) - on_tool
    off = dict(list_deviations(found, truth))
    return Outcome(seed, content["kinematic_chain"], places, maps, off)


def map_mm(
    found: EstimatedModel,
    machine: MachineFile,
    truth: TruthMachine,
    target: str,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return error before, error left and its uncertainty at random places, (n, 3)."""
    q = np.random.default_rng([seed, 17]).uniform(
        machine.low, machine.high, (GRID, len(machine.low))
    )
    reflector = machine.reflector(target)
    place = perfect(machine).nominal_point_mm(q, reflector)
    offset = np.tile(np.array(reflector.offset_mm), (GRID, 1))
    at = make_standstill(found.model.machine, q, offset)
    told = build_volumetric_map(found.model, target)
    before = remove_rigid_motion(place, truth.deviation_mm(q, target))
    left = remove_rigid_motion(place, before - told.error_mm(at, found.theta))
    return before, left, told.sigma_mm(at, found.covariance)


def root_mean_square(vectors: np.ndarray) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def estimate_ideally(
    seen: Observations, found: Estimate, machine: MachineFile, truth: TruthMachine
) -> EstimatedModel:
    """Return what an estimator finds that is told noise and prior.

    How strongly each error motion bends, and how large slopes, angles and places of
    axes are on machines of this make.
    """
    nested = build_run_models(seen.at.machine, [seen.at]).nested
    model = nested.alone.with_confounded(nested.confounded)
    about = linearise(seen, model, found.runs[0].pose, true_noise(synthetic.Air()))
    data = compute_information(seen, about)
    precision = np.zeros((len(data.vector),) * 2)
    drawn = [random_machine(machine, 10_000 + k) for k in range(DRAWS)]
    motions = [truth.error_motions(), *(m.error_motions() for m in drawn)]
    numbers = [read_numbers(m) for m in drawn]
    for effect in model.effects:
        part = model.slices[effect.name]
        charge = effect.prior()
        if isinstance(effect, ErrorMotion):
            s = np.linspace(effect.axis.low, effect.axis.high, 101)
            shapes = np.linalg.pinv(effect.rows(s))
            own, *usual = (shapes @ m[effect.name].at(s) for m in motions)
            form = charge.form
            free = np.diag(form) < 1e-9 * np.diag(form).max()
            square = np.mean(np.square(usual), axis=0)
            energy = np.sort(own**2 * np.diag(form))[-SHAPES:].mean()
            precision[part, part] = form / energy
            precision[part, part] += np.diag(np.where(free, 1.0 / square, 0.0))
        elif charge:
            precision[part, part] = charge.form
        else:
            square = np.mean([n[effect.name] ** 2 for n in numbers])
            precision[part, part] = 1.0 / square
    size = model.size
    best = compute_posterior(data, precision)
    return EstimatedModel(model, best.theta[:size], best.covariance[:size, :size])


def read_numbers(truth: TruthMachine) -> dict[str, float]:
    """Return squarenesses and places of rotary axes."""
    return {**truth.squareness_rad, **truth.locations()}


def list_deviations(
    found: Estimate, truth: TruthMachine
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the values of each table, less the truth, in standard uncertainties."""
    tables = build_error_tables(found)
    moved, numbers = merge_turns(found, truth)
    for one in tables.tables:
        s = one.position_mm
        off = one.value - 1e3 * (1e3 if one.unit == "urad" else 1.0) * moved(
            one.symbol, s
        )
        known = one.uncertainty > 1e-5  # elsewhere the gauge makes both nothing
        yield one.symbol, off[known] / one.uncertainty[known]
    for single in (*tables.squareness, *tables.locations):
        true = 1e3 * (1e3 if single.unit == "urad" else 1.0) * numbers[single.symbol]
        yield single.symbol, np.array([(single.value - true) / single.uncertainty])


def merge_turns(found: Estimate, truth: TruthMachine) -> tuple[Any, dict[str, float]]:
    """Return what tables of the measured targets can hold: E(s) by symbol, and numbers.

    Turns of a linear axis that the targets do not tell move the first of them as a
    displacement of the axis does; straightness is without its end-point line, whose
    slope is squareness.
    """
    motions, numbers = truth.error_motions(), read_numbers(truth)
    tool = np.array(truth.machine.reflector("T1").offset_mm)
    axes = {axis.name: axis for axis in truth.machine.linear_axes}
    merged = [n for n in found.model.confounded if n[0] == "E" and n[2] in axes]
    arms = {n: np.cross(np.eye(3)["ABC".index(n[1])], tool) for n in merged}

    def displace(symbol: str, s: np.ndarray) -> np.ndarray:
        value = motions[symbol].at(s)
        for name, arm in arms.items():
            if symbol[1] in "XYZ" and name[2] == symbol[2]:
                value = value + motions[name].at(s) * arm["XYZ".index(symbol[1])]
        return value

    def slope(symbol: str) -> float:
        axis = axes[symbol[2]]
        first, last = displace(symbol, np.array([axis.low, axis.high]))
        return float((last - first) / (axis.high - axis.low))

    def straighten(symbol: str, s: np.ndarray) -> np.ndarray:
        value = displace(symbol, s)
        if symbol[2] not in axes or symbol[1] not in set("XYZ") - {symbol[2]}:
            return value
        axis = axes[symbol[2]]
        first = displace(symbol, np.array([axis.low]))
        return value - first - slope(symbol) * (s - axis.low)

    squareness = {
        name: numbers[name] + sign * (slope(one) + slope(other))
        for name, (one, other, sign) in SQUARENESS.items()
    }
    return straighten, {**numbers, **squareness}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    options, _ = parser.parse_known_args()
    seeds = range(options.first_seed, options.first_seed + options.machines)
    rows = [make_row(kind, [judge(kind, seed) for seed in seeds]) for kind in KINDS]
    head = [
        "machines",
        "before µm",
        "left µm",
        "bound µm",
        "ideal here µm",
        "left / bound",
        "map in 2u",
        "tables in 2u",
        "another tool: left µm",
        "bound µm",
        "map in 2u",
    ]
    write_section("five-axes", table(head, rows))


def make_row(kind: str, outcomes: list[Outcome]) -> list[str]:
    """Return a row of the table: root mean squares and shares over the machines."""

    def total(name: str, key: str) -> float:
        values = [getattr(o.maps[name], key) for o in outcomes]
        return float(np.sqrt(np.mean(np.square(values))))

    inside = [np.mean([o.maps[n].inside for o in outcomes]) for n in ("T1", OTHER)]
    return [
        kind,
        f"{total('T1', 'before'):.1f}",
        f"{total('T1', 'left'):.2f}",
        f"{total('T1', 'bound'):.2f}",
        f"{total('T1', 'ideal'):.2f}",
        f"{total('T1', 'left') / total('T1', 'bound'):.2f}",
        f"{inside[0]:.1%}",
        f"{np.mean([o.tables_inside() for o in outcomes]):.1%}",
        f"{total(OTHER, 'left'):.2f}",
        f"{total(OTHER, 'bound'):.2f}",
        f"{inside[1]:.1%}",
    ]


if __name__ == "__main__":
    main()
