"""What a plan is said to leave unknown, against what the estimate then states."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from estimating import estimate
from recorded import load_small, record_run
from truepath.alignment.align import align, align_all
from truepath.errors import Unidentifiable
from truepath.files.environment import Refraction, state_length_ppm
from truepath.kinematics import estimated_model, volumetric_map
from truepath.kinematics.machine.tracker_specification import TrackerSpecification
from truepath.planning.forecast import Assumptions, forecast, predict_undetermined
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.motion.program import Program
from truepath_simulators.worlds.synthetic import Setting

IN_SPACE = ((0.1, 0.1, 0.1), (0.9, 0.7, 0.8), (0.2, 0.9, 0.2), (0.9, 0.1, 0.6))
IN_A_PLANE = tuple((0.1 + 0.8 * (k % 2), 0.1 * k, 0.07 * k) for k in range(1, 9))


def state_variance(made):
    ppm = state_length_ppm(Refraction(), made.model.machine.tracker.range_ppm)
    told = made.widen_by_scale(1e-6 * ppm)
    return np.sum(volumetric_map.compute_volumetric_gram(told.model) * told.covariance)


@pytest.fixture(
    scope="module",
    params=[False, pytest.param(True, marks=pytest.mark.long)],
    ids=["all", "perpendicular"],
)
def outcomes(record, request):
    found = []
    for seed in (1, 2):
        run, truth = record(seed, rows=16)
        made = estimate(align(run), perpendicular_only=request.param)
        variance = state_variance(made)
        stand = truth.recording.pose.position_mm

        def foretold(run=run, stand=stand, **known):
            assumed = Assumptions(perpendicular_only=request.param, **known)
            return forecast(run.machine, run.commanded, stand, assumed)

        known = {"prior_precision": made.prior_precision, "noise": made.runs[0].noise}
        found.append((np.sqrt(variance), foretold(), foretold(**known)))
    return found


def test_the_forecast_agrees_with_what_estimates_state_within_15_percent(outcomes):
    ratios = [before.volumetric_sigma_mm / stated for stated, before, _ in outcomes]
    assert 0.85 < np.mean(ratios) < 1.15
    for stated, _, known in outcomes:
        assert known.volumetric_sigma_mm == pytest.approx(stated, rel=0.15)


@pytest.mark.parametrize("places", [1, pytest.param(2, marks=pytest.mark.long)])
def test_what_the_tracker_may_be_off_by_is_foretold_as_it_is_stated(places):
    content = load_small("demo", 1.0)
    content["tracker"]["specification"] = asdict(TrackerSpecification())
    program = paths.chord_path(parse_machine(content), 1, 16, 10_000.0)
    order = {"setting": Setting(machine_seed=1)}
    made = [record_run(content, program, 1 + k, **order) for k in range(places)]
    result = estimate(*align_all([run for run, _ in made], ["one", "two"][:places]))
    stated = state_variance(result) ** 0.5
    found = None
    for run, truth in made:
        stand_mm = truth.pose.position_mm
        found = forecast(run.machine, run.commanded, stand_mm, before=found)
    assert found.volumetric_sigma_mm == pytest.approx(stated, rel=0.1)
    assert found.random_mm < 0.8 * stated


def test_the_scale_of_the_air_is_foretold_as_it_is_stated(outcomes):
    _, foretold, _ = outcomes[0]
    mill = foretold.model.machine
    stretch = estimated_model.compute_scale_parameters(foretold.model)
    ppm = state_length_ppm(Refraction(), mill.tracker.range_ppm)
    less = foretold.covariance - 1e-12 * ppm**2 * np.outer(stretch, stretch)
    known = replace(foretold, covariance=less).motion_sigmas()
    for symbol, sigma_mm in foretold.motion_sigmas().items():
        by_air_mm = (sigma_mm**2 - known[symbol] ** 2) ** 0.5
        if symbol in ("EXX", "EYY", "EZZ"):
            travel_mm = mill.linear_axes["XYZ".index(symbol[1])].high
            expected_mm = 1e-6 * ppm * travel_mm / 3.0**0.5
            assert by_air_mm == pytest.approx(expected_mm, rel=0.1)
        else:
            assert by_air_mm == pytest.approx(0.0, abs=1e-9)


def test_uncertainty_shrinks_from_row_to_row_and_what_is_known_least_is_named(outcomes):
    _, foretold, _ = outcomes[0]
    sigma_mm = [step.sigma_mm for step in foretold.curve]
    rows = [step.row for step in foretold.curve]
    assert (np.diff(sigma_mm) <= 0.0).all()
    assert rows == sorted(set(rows))
    assert sigma_mm[-1] == foretold.volumetric_sigma_mm
    for step in foretold.curve:
        shares = list(step.weakest_mm.values())
        assert shares == sorted(shares, reverse=True)
        assert set(step.weakest_mm) < set(foretold.motion_sigmas())
    first, last = (foretold.curve[i].weakest_mm for i in (0, -1))
    assert max(last.values()) < max(first.values())
    assert {text[:3] for text in foretold.unobservable} == {"EAZ", "EBZ", "ECZ", "ECY"}
    motions = foretold.motion_sigmas()
    assert len([symbol for symbol in motions if symbol.startswith("E")]) == 14
    assert {"C0Y", "B0Z", "A0Z"} < set(motions)
    assert all(sigma > 0.0 for sigma in motions.values())


@pytest.mark.parametrize(
    ("places", "is_determined"),
    [(IN_SPACE[:3], False), (IN_SPACE, True), (IN_A_PLANE, False)],
    ids=["two-lines", "three-lines", "in-a-plane"],
)
def test_what_estimates_refuse_is_foretold_as_they_say(record, places, is_determined):
    n, position_mm = len(places), np.array([500.0, 400.0, 300.0]) * places
    program = Program(position_mm, np.full(n, 100.0), np.full(n, 0.6))
    run, truth = record(2, program=program)
    stand_mm = truth.recording.pose.position_mm
    foretold = predict_undetermined(run.machine, run.commanded, stand_mm)
    refused = ""
    try:
        estimate(align(run))
    except Unidentifiable as error:
        refused = str(error)
    assert foretold == refused
    assert (foretold == "") is is_determined
