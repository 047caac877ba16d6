"""Targets that sit off their places, each by itself: found, and no harm done."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.unit.estimation.test_rotary_axes import measured

from estimating import estimate, judge_map
from truepath.alignment.align import align
from truepath.estimation.solve.batch import Estimate
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.bundle.run import Run
from truepath.kinematics.machine.machine import Machine

OFF_UM = {"T2": (15.0, -20.0, 8.0), "T3": (-9.0, 4.0, 20.0), "W1": (20.0, 20.0, -20.0)}
FAR_UM = {"W2": (2500.0, -3000.0, 1000.0)}


def seat(machine: Machine, off_um: dict[str, tuple[float, ...]]) -> Machine:
    """Return the machine whose file states targets where they are not."""
    targets = [
        replace(t, offset_mm=tuple(np.array(t.offset_mm) - 1e-3 * np.array(off)))
        for t in machine.targets
        for off in [off_um.get(t.name, (0.0, 0.0, 0.0))]
    ]
    return replace(machine, targets=tuple(targets))


@pytest.fixture(scope="module")
def made() -> tuple[Run, object]:
    return measured("head-table", 3)


@pytest.fixture(scope="module", params=[OFF_UM, FAR_UM], ids=["micrometres", "far"])
def case(
    request: pytest.FixtureRequest, made: tuple[Run, object]
) -> tuple[Estimate, dict[str, tuple[float, ...]]]:
    run, _ = made
    moved = replace(run, machine=seat(run.machine, request.param))
    return estimate(align(moved)), request.param


def test_where_each_target_sits_is_found_and_no_harm_is_done(case, made) -> None:
    found, off_um = case
    for one in found.runs[0].seats:
        off = 1e-3 * np.array(off_um.get(one.target.name, (0.0, 0.0, 0.0)))
        assert (one.sigma_mm < 0.02).all()
        assert (np.abs(one.shift_mm - off) < 4.0 * one.sigma_mm + 1e-4).all()
    told = [one.target.name for one in found.runs[0].seats]
    assert told == ["T2", "T3", "W1", "W2", "W3"]
    # The error is found as if the targets sat where they are stated.
    left = judge_map(found, partial(made[1].deviation_mm, target="T1"), "T1")
    assert left.share < 0.05
    assert left.inside > 0.85


def test_a_place_that_is_known_better_is_part_of_the_machine_file() -> None:
    run, _ = measured("head-table", 3, 3)
    content = machine_to_json(run.machine)
    assert "seat_sigma_mm" not in content["targets"]["W1"]
    content["targets"]["W1"]["seat_sigma_mm"] = 0.002
    again = machine_from_json(content)
    assert again.target("W1").seat_sigma_mm == 0.002
    assert machine_to_json(again) == content
