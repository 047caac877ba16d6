"""Machines with rotary axes, measured at standstills, against exact truth."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from estimating import estimate, judge_map
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.estimation.problem.information import invert_covariance
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics import conditions, identifiable
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.motion_times import Drive
from truepath.planning.initial_design import start_design
from truepath.planning.next_configuration import PointDesignState
from truepath.results.error_tables import build_error_tables
from truepath_simulators import machine_file
from truepath_simulators.motion import paths

OFF_UM = {"T2": (15.0, -20.0, 8.0), "T3": (-9.0, 4.0, 20.0), "W1": (20.0, 20.0, -20.0)}
FAR_UM = {"W2": (2500.0, -3000.0, 1000.0)}
MEASURED = ("T1", "T2", "W1", "W2", "W3")


@cache
def measured(name, seed, points=200, targets=()):
    content = content_of(targets) if targets else load_small(name)
    machine = machine_file.parse_machine(content)
    program = paths.turning_points(machine, seed, points, dwell_s=0.5)
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


def told(stands_on, targets):
    """Return the effects that targets tell, and what is said of others, by symbol."""
    content = machine_file.load_machine("head-table")
    content["tracker"]["stands_on"] = stands_on
    content["targets"] = {name: content["targets"][name] for name in targets}
    machine = machine_from_json(content)
    offsets = np.array([t.offset_mm for t in machine.targets])
    model, merged = identifiable.build_identifiable_model(machine, offsets, intervals=5)
    return {e.name for e in model.effects}, {m.symbol: str(m) for m in merged}


def test_a_single_target_in_a_head_cannot_tell_its_turns_from_its_shifts():
    names, said = told("workpiece", ["T1"])
    # Turns and tilts of the last axis move one point as shifts of it do.
    assert {"EAB", "EBB", "ECB", "AOB", "COB"} <= set(said)
    assert {"EXB", "EYB", "EZB", "XOB", "ZOB"} <= names
    assert "EYB" in said["AOB"]
    # The table at the other end shows all it has: the tool goes everywhere over it.
    assert {"XOC", "YOC", "AOC", "BOC", "EXC", "EYC", "EZC", "ECC"} <= names


def test_what_targets_on_one_side_do_not_tell_of_the_other_is_named():
    names, said = told("base", ["T1", "T2", "T3"])
    table = {*(f"E{d}C" for d in "XYZABC"), "XOC", "YOC", "AOC", "BOC"}
    assert table <= set(said)
    assert all("does not move the target" in said[s] for s in table)
    assert {"XOB", "ZOB", "AOB", "COB"} <= names
    names, said = told("base", ["W1", "W2", "W3"])
    # Motions show; the location has nothing to refer to but the pose of the tracker.
    assert {f"E{d}C" for d in "XYZABC"} <= names
    assert {"XOC", "YOC", "AOC", "BOC"} <= set(said)


@pytest.mark.parametrize("off_um", [OFF_UM, FAR_UM], ids=["micrometres", "far"])
def test_where_each_target_sits_is_found_and_no_harm_is_done(off_um):
    run, truth = measured("head-table", 3)
    targets = []
    for one in run.machine.targets:
        off_mm = 1e-3 * np.array(off_um.get(one.name, (0.0, 0.0, 0.0)))
        targets.append(replace(one, offset_mm=tuple(one.offset_mm - off_mm)))
    machine = replace(run.machine, targets=tuple(targets))
    found = estimate(align(replace(run, machine=machine)))
    for one in found.runs[0].seats:
        off = 1e-3 * np.array(off_um.get(one.target.name, (0.0, 0.0, 0.0)))
        assert (one.sigma_mm < 0.02).all()
        assert (np.abs(one.shift_mm - off) < 4.0 * one.sigma_mm + 1e-4).all()
    told = [one.target.name for one in found.runs[0].seats]
    assert told == ["T2", "T3", "W1", "W2", "W3"]
    # The error is found as if the targets sat where they are stated.
    left = judge_map(found, partial(truth.deviation_mm, target="T1"), "T1")
    assert left.share < 0.05
    assert left.inside > 0.85


def content_of(targets):
    content = load_small("head-table")
    content["targets"] = {name: content["targets"][name] for name in targets}
    return content


@pytest.fixture(scope="module")
def two_lengths():
    run, truth = measured("head-table", 7, 160, targets=MEASURED)
    machine = machine_from_json(content_of([*MEASURED, "T3"]))
    return estimate(align(replace(run, machine=machine))), truth


def test_turns_about_a_line_of_targets_are_left_to_the_prior_and_held_by_u(two_lengths):
    result, truth = two_lengths
    assert result.model.confounded == {"COB", "ECB"}
    known = truth.locations()
    for symbol in ("XOB", "ZOB", "AOB", "COB", "XOC", "YOC", "AOC", "BOC"):
        theta, covariance = result.part(symbol)
        assert abs(theta[0] - known[symbol]) < 3.0 * covariance[0, 0] ** 0.5
    motions, off = truth.error_motions(), []
    for table in build_error_tables(result).tables:
        if table.symbol[2] in "BC":
            scale = 1e3 if table.unit == "um" else 1e6
            true = scale * motions[table.symbol].at(table.position_mm)
            told = table.uncertainty > 1e-5
            off.append((table.value - true)[told] / table.uncertainty[told])
    assert (np.abs(np.concatenate(off)) < 2.0).mean() > 0.9


def test_u_covers_a_tool_that_nobody_measured(two_lengths):
    result, truth = two_lengths
    machine = result.model.machine
    whole = machine_file.parse_machine(content_of(["T3"]))

    def deviation_mm(q):
        offset = np.tile(np.array(machine.target("T3").offset_mm), (len(q), 1))
        nominal_mm = conditions.make_standstill(machine, q, offset).point_mm
        return truth.point_mm(q, whole.reflector("T3")) - nominal_mm

    assert judge_map(result, deviation_mm, "T3").inside > 0.85
    gram = {name: compute_volumetric_gram(result.model, name) for name in ("T1", "T3")}
    own, other = (np.sum(one * result.covariance) for one in gram.values())
    assert other > 1.2**2 * own


def test_a_further_target_is_asked_for_and_tells_and_a_plan_knows_it_lacks(two_lengths):
    result, _ = two_lengths
    said = result.observability.unobservable
    hint = next(s for s in said if s.startswith("ECB"))
    assert "a further tool longer or shorter separates them" in hint
    assert not any("too little for any tool" in s for s in said)
    machine = machine_from_json(machine_file.load_machine("head-table"))
    offsets = np.array([t.offset_mm for t in machine.targets])
    position = np.zeros((len(offsets), len(machine.axes)))
    runs = [conditions.make_standstill(machine, position, offsets)]
    assert not build_run_models(machine, runs).nested.with_confounded.confounded
    machine = machine_from_json(content_of(MEASURED[:4]))
    drive, at_mm = Drive.of_machine(machine, 1.0), np.array([-900.0, 200.0, 100.0])
    design = start_design(PointDesignState, machine, at_mm, drive, target="T1")
    assert "ECB" in design.model.confounded
    assert np.isfinite(design.integrated_variance)


def test_a_covariance_of_millimetres_and_radians_is_inverted_in_its_own_units():
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 6)) * np.array([1e-2] * 3 + [1e-7] * 3)[:, None]
    covariance = half @ half.T
    scale = np.sqrt(np.diag(covariance))
    found = invert_covariance(covariance) @ covariance * scale / scale[:, None]
    np.testing.assert_allclose(found, np.eye(6), atol=0.05)
