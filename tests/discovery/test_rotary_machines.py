"""Machines with rotary axes: arcs hide nothing and make nothing up."""

from __future__ import annotations

import numpy as np
import pytest

from app.discovery.discover import Discovery, discover
from app.files.machine_file import machine_from_json
from app.files.run import Run
from app.planning.default_path import default_path
from drivers.interfaces.records import TrackerSamples
from simulators import synthetic
from simulators.hidden.backlash import Backlash
from simulators.hidden.effect import HiddenEffect
from simulators.hidden.servo_mismatch import ServoMismatch
from simulators.hidden.turning import GearCyclic, TurningBacklash
from simulators.scenario import load_machine
from simulators.timeline import Program

pytestmark = pytest.mark.timeout(180)


def found_in(name: str, hidden: tuple[HiddenEffect, ...]) -> Discovery:
    """Drive the default path of a machine, arcs of its rotary axes included."""
    content = load_machine(name)
    content["tracker"]["stands_on"] = "base"
    machine = machine_from_json(content)
    path = default_path(machine, 6000.0, seed=3)
    program = Program(path.position, path.feed_mm_min / 60, path.dwell_s, path.target)
    setting = synthetic.Setting(hidden=hidden)
    made = synthetic.record(content, program, 3, "otf", setting)
    number = np.arange(len(made))
    samples = TrackerSamples(number, made.time_s, made.position_mm, made.status)
    return discover([Run(name, machine, path, samples)])


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        ("trunnion", Backlash("X", 8.0)),
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
