"""Machines with rotary axes, measured at standstills, against exact truth."""

import numpy as np
import pytest
from tests.estimation.estimating import estimate

from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.bundle.run import Run
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import turning_paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic


def measured(name, seed, points=200):
    content = load_machine(name)
    program = turning_paths.turning_points(
        parse_machine(content), seed, points, dwell_s=0.5
    )
    made = synthetic.record(content, program, seed, "standstill")
    machine = machine_from_json(content)
    samples = TrackerSamples(
        np.arange(len(made)), made.time_s, made.position_mm, made.status
    )
    commanded = Configurations(
        machine.axis_names, program.position, program.dwell_s, program.target
    )
    return Run(name, machine, commanded, samples), made.truth


@pytest.mark.parametrize("name", ["head-table", "trunnion"])
def test_a_five_axis_machine_is_found_within_its_uncertainty(
    name, deviations, share_left
):
    run, truth = measured(name, 3)
    result = estimate(align(run))
    assert result.observability.rank == result.observability.parameters
    assert not result.observability.unobservable
    names = {e.name for e in result.model.effects}
    assert set(truth.locations()) | set(truth.error_motions()) <= names
    share, inside = share_left(result, truth)
    assert share < 0.05
    assert inside > 0.85
    z = deviations(result, truth)
    assert (np.abs(z) < 2.0).mean() > 0.9


@pytest.mark.long
@pytest.mark.timeout(900)
def test_ten_random_machines_are_recovered_within_their_uncertainties(deviations):
    inside = []
    for seed in range(10):
        run, truth = measured(("head-table", "trunnion")[seed % 2], 50 + seed)
        z = deviations(estimate(align(run)), truth)
        inside.append((np.abs(z) < 2.0).mean())
        assert np.abs(z).max() < 4.5
    assert np.mean(inside) > 0.93
    assert min(inside) > 0.88


def content(name, stands_on, targets):
    made = load_machine(name)
    made["tracker"]["stands_on"] = stands_on
    made["targets"] = {k: v for k, v in made["targets"].items() if k in targets}
    return made


def told(name, stands_on, targets):
    machine = machine_from_json(content(name, stands_on, targets))
    offsets = np.array([t.offset_mm for t in machine.targets])
    model, merged = build_identifiable_model(machine, offsets, intervals=5)
    return {e.name for e in model.effects}, {m.symbol: str(m) for m in merged}


def test_a_single_target_in_a_head_cannot_tell_its_turns_from_its_shifts():
    names, said = told("head-table", "workpiece", ["T1"])
    # Turns and tilts of the last axis move one point as shifts of it do.
    assert {"EAB", "EBB", "ECB", "AOB", "COB"} <= set(said)
    assert {"EXB", "EYB", "EZB", "XOB", "ZOB"} <= names
    assert "EYB" in said["AOB"]
    # The table at the other end shows all it has: the tool goes everywhere over it.
    assert {"XOC", "YOC", "AOC", "BOC", "EXC", "EYC", "EZC", "ECC"} <= names


def test_from_the_base_a_tool_alone_says_nothing_of_the_table():
    names, said = told("head-table", "base", ["T1", "T2", "T3"])
    table = {*(f"E{d}C" for d in "XYZABC"), "XOC", "YOC", "AOC", "BOC"}
    assert table <= set(said)
    assert all("does not move the target" in said[s] for s in table)
    assert {"XOB", "ZOB", "AOB", "COB"} <= names


def test_targets_on_the_table_alone_do_not_say_where_its_axis_is():
    names, said = told("head-table", "base", ["W1", "W2", "W3"])
    # Motions show; the location has nothing to refer to but the pose of the tracker.
    assert {f"E{d}C" for d in "XYZABC"} <= names
    assert {"XOC", "YOC", "AOC", "BOC"} <= set(said)
