"""Random machines with rotary axes, and how little of each its targets may tell.

Chains, travels, places of axes, tools and targets are drawn: one to three places on the
tool, most of them lengths, and one to three targets on the table, from which much stays
confounded. Each target sits up to 20 µm off its place. Judged are the tables, and the
error of the measured tool and of one of another length that nobody measured, against
the exact transforms of the simulators.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from document import table, write_section
from information_bound import true_noise
from target_seats import remove_rigid_motion

from app.alignment.align import align
from app.alignment.observations import Observations
from app.estimation.batch import Estimate, estimate
from app.estimation.design_matrix import linearise
from app.estimation.information import compute_posterior
from app.estimation.normal_equations import compute_information
from app.files.machine_file import machine_from_json
from app.files.model_file import EstimatedModel
from app.files.run import Run
from app.kinematics.coarse_model import build_run_models
from app.kinematics.conditions import make_standstill
from app.kinematics.effects.error_motion import ErrorMotion
from app.kinematics.volumetric_map import build_volumetric_map
from app.motion.configurations import Configurations
from app.results.error_tables import build_error_tables
from drivers.interfaces.records import TrackerSamples
from simulators import synthetic, turning_paths
from simulators.machine_file import MachineFile, parse_machine
from simulators.paths import standstill_points
from simulators.random_machine import random_machine
from simulators.truth_machine import TruthMachine, perfect

MACHINES, FIRST_SEED, POINTS, GRID = 20, 1001, 200, 300
OFF_MM, OTHER = 0.02, "another"
SHAPES = 8  # of an error motion here: four harmonics, a sine and a cosine each
DRAWS = 200  # of machines of the same make, for what the ideal estimator knows
KINDS = {
    "two axes in the head": ("w-b-X-Y-Z-C-B-t", "w-X-b-Y-Z-C-A-t"),
    "head and table": ("w-C-b-X-Y-Z-B-t", "w-B-b-X-Y-Z-A-t", "w-C-X-b-Y-Z-A-t"),
    "two axes in the table": ("w-C-A-b-X-Y-Z-t", "w-C-A-X-b-Y-Z-t", "w-C-B-b-X-Y-Z-t"),
    "one rotary axis": ("w-C-b-X-Y-Z-t", "w-A-b-X-Y-Z-t", "w-b-X-Y-Z-B-t"),
    "three axes": ("w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-X-Y-b-Z-t", "w-Z-b-Y-X-t"),
}
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


def draw_machine(kind: str, seed: int) -> dict[str, Any]:
    """Return the content of machine.json; its last target is measured by nobody."""
    rng = np.random.default_rng([seed, 15])
    chain = KINDS[kind][seed % len(KINDS[kind])]
    travel = np.round(rng.uniform(350.0, 700.0, 3), 1)
    centre = np.array([*travel[:2] / 2.0, -200.0]) + rng.uniform(-30.0, 30.0, 3)
    axes: dict[str, Any] = {
        name: {"type": "linear", "min_mm": 0.0, "max_mm": float(length)}
        for name, length in zip("XYZ", travel, strict=True)
    }
    table_side = chain.split("-b-")[0]
    for name in set(chain) & set("ABC"):
        turns_fully = name == "C" or (name in table_side and len(table_side) == 3)
        low, high = (0.0, 360.0) if turns_fully else (-100.0, 40.0)
        origin = centre if name in table_side else rng.uniform(-20.0, 20.0, 3)
        axes[name] = {"type": "rotary", "min_deg": low, "max_deg": high}
        axes[name]["origin_mm"] = np.round(origin, 2).tolist()
    length = rng.uniform(120.0, 250.0)
    tool = np.array([*rng.uniform(-8.0, 8.0, 2), -length])
    steps = [np.zeros(3), [0.0, 0.0, -rng.uniform(60.0, 120.0)]]
    # The third is of another length still, or to the side.
    steps.append([0.0, 0.0, 60.0] if rng.uniform() < 0.3 else [70.0, 20.0, 40.0])
    places = {f"T{k + 1}": tool + step for k, step in enumerate(steps)}
    count = int(rng.integers(1, 4))
    targets = {
        name: {"on": "tool", "offset_mm": np.round(place, 2).tolist()}
        for name, place in list(places.items())[:count]
    }
    if set(table_side) & set("ABC"):
        for k, turn in enumerate(rng.uniform(-0.4, 0.4, int(rng.integers(1, 4)))):
            angle, reach = turn + 2.1 * k, rng.uniform(90.0, 160.0)
            step = (reach * np.cos(angle), reach * np.sin(angle), 40.0 + 60.0 * k)
            place = np.round(centre + step, 2).tolist()
            targets[f"W{k + 1}"] = {"on": "workpiece", "offset_mm": place}
    longer = rng.choice([-1.0, 1.0]) * rng.uniform(40.0, 100.0)
    asked = np.round(tool + np.array([0.0, 0.0, longer]), 2)
    targets[OTHER] = {"on": "tool", "offset_mm": asked.tolist()}
    return {
        "schema": "machine/1",
        "name": f"{kind} {seed}",
        "kinematic_chain": chain,
        "axes": {name: axes[name] for name in "XYZABC" if name in axes},
        "targets": targets,
        "tracker": {"stands_on": "base" if "W1" in targets else "workpiece"},
    }


def measure(content: dict[str, Any], seed: int) -> tuple[Observations, TruthMachine]:
    """Stand at random places, every target but the last in turn, each off its place."""
    measured = copy.deepcopy(content)
    del measured["targets"][OTHER]
    machine, points = parse_machine(measured), POINTS
    if machine.rotary_axes:
        program = turning_paths.turning_points(machine, seed, points, dwell_s=0.6)
    else:
        names = [reflector.name for reflector in machine.reflectors]
        program = standstill_points(machine, seed, points, dwell_s=0.6)
        in_turn = tuple(names[k % len(names)] for k in range(len(program.position)))
        program = replace(program, target=in_turn)
    rng = np.random.default_rng([seed, 16])
    seated = copy.deepcopy(measured)
    for name, target in seated["targets"].items():
        shift = OFF_MM * rng.uniform(-1.0, 1.0, 3) * (name != "T1")
        target["offset_mm"] = (np.array(target["offset_mm"]) + shift).tolist()
    made = synthetic.record(seated, program, seed, "standstill")
    samples = TrackerSamples(
        np.arange(len(made)), made.time_s, made.position_mm, made.status
    )
    stated = machine_from_json(content)
    commanded = Configurations(
        stated.axis_names, program.position, program.dwell_s, program.target
    )
    return align(Run(content["name"], stated, commanded, samples)), made.truth


def judge(kind: str, seed: int) -> Outcome:
    """Measure a machine, estimate, and compare with the truth."""
    content = draw_machine(kind, seed)
    seen, _ = measure(content, seed)
    found = estimate(build_run_models(seen.at.machine, [seen.at.offset_mm]), [seen])
    machine = parse_machine(content)
    truth = random_machine(machine, seed)
    ideal = estimate_ideally(seen, found, machine, truth)
    q = np.random.default_rng([seed, 17]).uniform(
        machine.low, machine.high, (GRID, len(machine.low))
    )
    maps: dict[str, Score] = {}
    for name in ("T1", OTHER):
        reflector = machine.reflector(name)
        place = perfect(machine).nominal_point_mm(q, reflector)
        offset = np.tile(np.array(reflector.offset_mm), (GRID, 1))
        at = make_standstill(seen.at.machine, q, offset)
        told = build_volumetric_map(found.model, name)
        before = remove_rigid_motion(place, truth.deviation_mm(q, name))
        left = remove_rigid_motion(place, before - told.error_mm(at, found.theta))
        inside = np.abs(left) < 2.0 * told.sigma_mm(at, found.covariance)
        best = build_volumetric_map(ideal.model, name)
        bound = best.sigma_mm(at, ideal.covariance)
        rest = remove_rigid_motion(place, before - best.error_mm(at, ideal.theta))
        sizes = [1e3 * root_mean_square(v) for v in (before, left, bound, rest)]
        maps[name] = Score(*sizes, float(inside.mean()))
    targets = list(content["targets"])[:-1]
    on_tool = sum(name.startswith("T") for name in targets)
    places = on_tool, len(targets) - on_tool
    off = dict(list_deviations(found, truth))
    return Outcome(seed, content["kinematic_chain"], places, maps, off)


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
    nested = build_run_models(seen.at.machine, [seen.at.offset_mm]).nested
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
    """Judge the machines and write the table."""
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
