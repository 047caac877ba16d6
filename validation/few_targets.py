"""Random machines with rotary axes, measured by so few targets that much stays open.

Chains, travels, places of axes, tools and targets are drawn: one to three places on the
tool, most of them lengths, and one to three targets on the table. Each target sits up
to 20 µm off its place.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
from recordings import draw_specification

from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.paths import standstill_points
from truepath_simulators.worlds import synthetic

POINTS, OFF_MM, OTHER = 200, 0.02, "another"
KINDS = {
    "two axes in the head": ("w-b-X-Y-Z-C-B-t", "w-X-b-Y-Z-C-A-t"),
    "head and table": ("w-C-b-X-Y-Z-B-t", "w-B-b-X-Y-Z-A-t", "w-C-X-b-Y-Z-A-t"),
    "two axes in the table": ("w-C-A-b-X-Y-Z-t", "w-C-A-X-b-Y-Z-t", "w-C-B-b-X-Y-Z-t"),
    "one rotary axis": ("w-C-b-X-Y-Z-t", "w-A-b-X-Y-Z-t", "w-b-X-Y-Z-B-t"),
    "three axes": ("w-b-X-Y-Z-t", "w-X-b-Y-Z-t", "w-X-Y-b-Z-t", "w-Z-b-Y-X-t"),
}


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
        "tracker": {
            "stands_on": "base" if "W1" in targets else "workpiece",
            "specification": draw_specification(seed),
        },
    }


def measure(content: dict[str, Any], seed: int) -> tuple[Run, TruthMachine]:
    """Stand at random places, every target but the last in turn, each off its place."""
    measured = copy.deepcopy(content)
    del measured["targets"][OTHER]
    machine, points = parse_machine(measured), POINTS
    if machine.rotary_axes:
        program = paths.turning_points(machine, seed, points, dwell_s=0.6)
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
    return Run(content["name"], stated, commanded, samples), made.truth
