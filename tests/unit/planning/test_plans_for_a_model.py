"""A plan for a machine whose effects are known in part tells these apart as well."""

import numpy as np
import pytest

from estimating import estimate
from recorded import record_path
from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.answers.plan.plan_document import plan_document
from truepath.answers.plan.plan_report import render_plan_report
from truepath.errors import BundleError
from truepath.estimation.problem.prior_model import PriorModel
from truepath.files.bundle.machine_file import machine_from_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.effects.backlash import BacklashFamily
from truepath.kinematics.effects.elastic_sag import ElasticSagFamily
from truepath.kinematics.effects.servo_mismatch import ServoMismatchFamily
from truepath.kinematics.model import MachineModel, restore_effect
from truepath.planning.forecast import Assumptions, forecast
from truepath.planning.plan_builder import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath_simulators.hidden import drives, structure
from truepath_simulators.machine_file import load_machine
from truepath_simulators.worlds.synthetic import Setting

FEEDS = (3000.0, 9000.0)
SMALL = load_machine("demo")
for axis in SMALL["axes"].values():
    axis["min_mm"], axis["max_mm"] = 0.0, 220.0
MACHINE = machine_from_json(SMALL, file="machine.json")
# Lost motion, a lag, and a guide that bends: within these, and alike as far as one
# earlier Run could tell.
SIGMA = np.array([0.003, 1e-4, 0.02])


@pytest.fixture(scope="module")
def model():
    sag = {"axis": "X", "by": "Y", "direction": "Z"}
    kinds = (BacklashFamily, {"axis": "X"}), (ServoMismatchFamily, {"axis": "X"})
    kinds += ((ElasticSagFamily, sag),)
    effects = tuple(restore_effect(kind(), MACHINE, keys, {}) for kind, keys in kinds)
    likeness = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    covariance = likeness * np.outer(SIGMA, SIGMA)
    loaded = CalibrationResult(MachineModel(MACHINE, effects), 0.2 * SIGMA, covariance)
    return PriorModel(loaded, "model.json", "abc")


def plan_it(model, seed=0):
    order = PlanRequirements(minutes=0.8, feeds_mm_min=FEEDS, model=model, seed=seed)
    return make_plan(MACHINE, order)


@pytest.fixture(scope="module")
def planned(model):
    return {knows: plan_it(model if knows else None) for knows in (True, False)}


@pytest.mark.long
def test_lines_tell_the_effects_better_than_lines_planned_without_them(planned, model):
    known = model.select_effects(MACHINE)
    assumed = Assumptions(known)

    def left(plan):
        after = forecast(MACHINE, plan.commanded, plan.station_mm, assumed)
        part = known.locate(after.model)
        return np.mean(np.sqrt(np.diag(after.covariance)[part]) / SIGMA)

    ratios = [left(planned[True]) / left(planned[False])]
    for seed in (1, 2):
        ratios.append(left(plan_it(model, seed)) / left(plan_it(None, seed)))
    assert np.mean(ratios) < 0.9


def test_what_is_foretold_is_what_the_measurement_then_states(planned, model):
    plan = planned[True]
    play, lag = drives.Backlash("X", 4.0), drives.ServoMismatch("X", 0.05)
    hidden = (play, lag, structure.ElasticSag("X", "Y", "Z", 12.0))
    setting = Setting(machine_seed=6, hidden=hidden)
    run, _ = record_path(SMALL, plan.commanded, 7, setting=setting)
    known = model.select_effects(MACHINE)
    found = estimate(add_surroundings(align(run), run.commanded), known=known)
    part = known.locate(found.model)
    stated = np.sqrt(np.diag(found.covariance)[part])
    variance = np.diag(plan.forecast.covariance)[known.locate(plan.forecast.model)]
    foretold = np.sqrt(variance)
    assert (np.abs(np.log(stated / foretold)) < np.log(3.0)).all()
    true = np.array([-0.002, 5e-5, 0.012])
    assert (np.abs(found.theta[part] - true) < 3.0 * stated).all()


def test_a_plan_of_lines_or_points_states_effects_before_and_after(planned, model):
    document = plan_document(planned[True])
    assert document["model"]["source"] == "model.json"
    lost, lag, sag = document["predicted"]["effects"]
    assert (lost["name"], lag["name"], sag["by"]) == ("backlash", "servo-mismatch", "Y")
    before, after = lag["known_before"]["lag_ms"], lag["parameters"]["lag_ms"]
    assert before["uncertainty"] == pytest.approx(0.1)
    assert after["uncertainty"] < 0.5 * before["uncertainty"]
    assert "Sag of a guide of X under Y along Z" in render_plan_report(document)
    assert plan_document(planned[False])["model"] is None
    stops = make_plan(MACHINE, PlanRequirements("standstill", minutes=0.4, model=model))
    (of_points, *_) = plan_document(stops)["predicted"]["effects"]
    for one in (lost, of_points):
        width_um = (one[key]["width_um"] for key in ("parameters", "known_before"))
        assert next(width_um)["uncertainty"] < next(width_um)["uncertainty"]


def test_a_model_of_another_machine_is_refused(model):
    other = machine_from_json(load_machine("demo"), file="machine.json")
    with pytest.raises(BundleError, match=r"model.json: machine.axes: X 0 to 220"):
        make_plan(other, PlanRequirements(minutes=0.5, model=model))
