"""Machines with rotary axes, measured at standstills, against exact truth."""

from functools import partial

import numpy as np
import pytest

from estimating import estimate, judge_map
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.identifiable import build_identifiable_model
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import turning_paths
from truepath_simulators.scenario import load_machine


def measured(name, seed, points=200):
    content = load_small(name)
    machine = parse_machine(content)
    program = turning_paths.turning_points(machine, seed, points, dwell_s=0.5)
    run, made = record_run(content, program, seed, "standstill")
    return run, made.truth


@pytest.mark.parametrize("name", ["head-table", "trunnion"])
def test_a_five_axis_machine_is_found_within_its_uncertainty(name, deviations):
    run, truth = measured(name, 3)
    result = estimate(align(run))
    assert result.observability.rank == result.observability.parameters
    assert not result.observability.unobservable
    names = {e.name for e in result.model.effects}
    assert set(truth.locations()) | set(truth.error_motions()) <= names
    left = judge_map(result, partial(truth.deviation_mm, target="T1"), "T1")
    assert left.share < 0.05
    assert left.inside > 0.85
    z = deviations(result, truth)
    assert (np.abs(z) < 2.0).mean() > 0.9


@pytest.mark.long
def test_random_machines_are_recovered_within_their_uncertainties(deviations):
    inside = []
    for seed in range(6):
        run, truth = measured(("head-table", "trunnion")[seed % 2], 50 + seed)
        z = deviations(estimate(align(run)), truth)
        inside.append((np.abs(z) < 2.0).mean())
        assert np.abs(z).max() < 4.5
    assert np.mean(inside) > 0.92
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
