"""What the measured targets do not tell: it stays in the model, and in u."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate, judge_map
from recorded import load_small, record_run
from truepath.alignment.align import align
from truepath.estimation.problem.information import invert_covariance
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.coarse_model import build_run_models
from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.motion_times import Drive
from truepath.planning.initial_design import start_design
from truepath.planning.points.next_configuration import PointDesignState
from truepath.results.error_tables import build_error_tables
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import turning_paths
from truepath_simulators.scenario import load_machine

MEASURED = ["T1", "T2", "W1", "W2", "W3"]


def content_of(name, measured, asked=()):
    """Content of machine.json with some of the targets, the measured ones first."""
    content = load_small(name)
    content["targets"] = {k: content["targets"][k] for k in (*measured, *asked)}
    return content


@pytest.fixture(scope="module")
def two_lengths():
    """A B head measured with two tools, and its truth; T3 is not measured."""
    content = content_of("head-table", MEASURED)
    program = turning_paths.turning_points(parse_machine(content), 7, 160, dwell_s=0.5)
    run, made = record_run(content, program, 7, "standstill")
    machine = machine_from_json(content_of("head-table", MEASURED, ["T3"]))
    return estimate(align(replace(run, machine=machine))), made.truth


def test_turns_about_the_line_of_a_heads_targets_leave_its_place_to_the_prior(
    two_lengths,
):
    result, truth = two_lengths
    assert result.model.confounded == {"COB", "ECB"}
    known = truth.locations()
    for symbol in ("XOB", "ZOB", "AOB", "COB", "XOC", "YOC", "AOC", "BOC"):
        theta, covariance = result.part(symbol)
        assert abs(theta[0] - known[symbol]) < 3.0 * covariance[0, 0] ** 0.5


def test_tables_of_what_is_partly_told_hold_the_truth(two_lengths):
    result, truth = two_lengths
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
    whole = parse_machine(content_of("head-table", ["T3"]))

    def deviation_mm(q):
        offset = np.tile(np.array(machine.target("T3").offset_mm), (len(q), 1))
        nominal_mm = make_standstill(machine, q, offset).point_mm
        return truth.point_mm(q, whole.reflector("T3")) - nominal_mm

    assert judge_map(result, deviation_mm, "T3").inside > 0.85
    sizes = [
        np.sum(compute_volumetric_gram(result.model, name) * result.covariance)
        for name in ("T1", "T3")
    ]
    assert sizes[1] > 1.2**2 * sizes[0]


def test_a_further_target_is_asked_for_and_tells(two_lengths):
    """What the hint asks for brings the rank: no tool is called useless."""
    result, _ = two_lengths
    said = result.observability.unobservable
    hint = next(s for s in said if s.startswith("ECB"))
    assert "a further tool longer or shorter separates them" in hint
    assert not any("too little for any tool" in s for s in said)
    machine = machine_from_json(load_machine("head-table"))
    offsets = np.array([t.offset_mm for t in machine.targets])
    position = np.zeros((len(offsets), len(machine.axes)))
    runs = [make_standstill(machine, position, offsets)]
    assert not build_run_models(machine, runs).nested.whole.confounded


def test_a_plan_knows_what_its_targets_do_not_tell():
    machine = machine_from_json(content_of("head-table", ["T1", "T2", "W1", "W2"]))
    design = start_design(
        PointDesignState,
        machine,
        np.array([-900.0, 200.0, 100.0]),
        Drive.of_machine(machine, 1.0),
        target="T1",
    )
    assert "ECB" in design.model.confounded
    assert np.isfinite(design.integrated_variance)


def test_a_covariance_of_millimetres_and_radians_is_inverted_in_its_own_units():
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 6)) * np.array([1e-2] * 3 + [1e-7] * 3)[:, None]
    covariance = half @ half.T
    exact = np.eye(6)
    scale = np.sqrt(np.diag(covariance))
    found = invert_covariance(covariance) @ covariance
    np.testing.assert_allclose(found * scale / scale[:, None], exact, atol=0.05)
