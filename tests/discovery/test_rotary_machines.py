"""Machines with rotary axes: arcs hide nothing and make nothing up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from truepath.discovery.discover import Discovery, discover
from truepath.discovery.extended_model import extend_model
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.estimated_model import EstimatedModel
from truepath.planning.lines.default_path import default_path
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.hidden.dynamics import ServoMismatch
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.screws import Backlash
from truepath_simulators.hidden.turning import (
    GearCyclic,
    RotaryEccentricity,
    SwivelSag,
    TurningBacklash,
)
from truepath_simulators.motion.program import Program
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic

pytestmark = pytest.mark.timeout(180)


# A small machine whose head turns, with two targets on it.
LINEAR: dict[str, Any] = {"type": "linear", "min_mm": 0.0, "max_mm": 300.0}
ROTARY: dict[str, Any] = {"type": "rotary", "min_deg": 0.0, "max_deg": 360.0}
HEAD: dict[str, Any] = {
    "schema": "machine/1",
    "name": "small",
    "kinematic_chain": "w-b-X-Y-Z-C-t",
    "axes": {**dict.fromkeys("XYZ", LINEAR), "C": {**ROTARY, "origin_mm": [3, -5, 0]}},
    "targets": {
        "T1": {"on": "tool", "offset_mm": [60.0, 0.0, -120.0]},
        "T2": {"on": "tool", "offset_mm": [-20.0, 70.0, -180.0]},
    },
    "tracker": {"stands_on": "workpiece", "rate_hz": 100},
}


def drive(
    content: dict[str, Any],
    hidden: tuple[HiddenEffect, ...],
    lines: int | None = None,
    reference: EstimatedModel | None = None,
) -> Discovery:
    """Drive the default path of a machine, arcs of its rotary axes included."""
    machine = machine_from_json(content)
    path = default_path(machine, 6000.0, lines=lines, seed=3)
    program = Program(path.position, path.feed_mm_min / 60, path.dwell_s, path.target)
    setting = synthetic.Setting(hidden=hidden)
    made = synthetic.record(content, program, 3, "otf", setting)
    number = np.arange(len(made))
    samples = TrackerSamples(number, made.time_s, made.position_mm, made.status)
    return discover([Run(content["name"], machine, path, samples)], reference)


@pytest.mark.parametrize("amplitude_urad", [0.0, 40.0])
def test_a_scale_that_was_mounted_off_centre_since_the_model_was_made_is_named(
    amplitude_urad: float,
) -> None:
    before = extend_model(drive(HEAD, (), 28))
    hidden = RotaryEccentricity("C", amplitude_urad, 1.0)
    found = drive(HEAD, (hidden,), 28, before)
    wanted = ["rotary-eccentricity C"] if amplitude_urad else []
    assert [finding.candidate.label for finding in found.findings] == wanted
    for finding in found.findings:
        for name, true in hidden.parameters(None).items():
            told = finding.parameters[name]
            assert abs(told.value - true) < 4.0 * told.uncertainty


def found_in(name: str, hidden: tuple[HiddenEffect, ...]) -> Discovery:
    """Drive a machine of the simulators, the tracker beside it."""
    content = load_machine(name)
    content["tracker"]["stands_on"] = "base"
    return drive(content, hidden)


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        (None, []),
        (GearCyclic("C", 6.0, 40.0, 1.0), ["gear-cyclic C"]),
        (SwivelSag("Y", "C", "Z", 8.0, 0.5), ["swivel-sag Y C Z"]),
    ],
    ids=["nothing", "gear", "sag"],
)
def test_an_error_of_a_gear_or_a_sag_that_turns_is_named_where_there_is_one(
    hidden: HiddenEffect | None, said: list[str]
) -> None:
    found = drive(HEAD, () if hidden is None else (hidden,), 28)
    assert [finding.candidate.label for finding in found.findings] == said
    for finding in found.findings:
        told = finding.parameters
        for name, true in hidden.parameters(None).items() if hidden else ():
            assert abs(told[name].value - true) < 4.0 * told[name].uncertainty


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        pytest.param("trunnion", Backlash("X", 8.0), marks=pytest.mark.long),
        pytest.param("trunnion", None, marks=pytest.mark.long),
        pytest.param("head-table", None, marks=pytest.mark.long),
        pytest.param("head-table", ServoMismatch("Y", 0.3), marks=pytest.mark.long),
        pytest.param("trunnion", TurningBacklash("C", 60.0), marks=pytest.mark.long),
        pytest.param(
            "head-table", GearCyclic("C", 5.0, 25.0, 1.0), marks=pytest.mark.long
        ),
    ],
)
def test_what_is_hidden_in_a_machine_with_rotary_axes_is_named_alone(name, hidden):
    found = found_in(name, () if hidden is None else (hidden,))
    wanted = [] if hidden is None else [f"{hidden.name} {hidden.axis}"]
    assert [f.candidate.label for f in found.findings] == wanted
    assert found.gap.after_um < 1.05 * found.gap.noise_floor_um
