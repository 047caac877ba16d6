"""Plans: what they tell, times and feeds; plans for effects that are known."""

from dataclasses import replace

import numpy as np
import pytest

from estimating import estimate
from recorded import record_path
from truepath.alignment.align import align
from truepath.alignment.observations.surroundings import add_surroundings
from truepath.answers.plan_report import plan_document, render_plan_report
from truepath.errors import BundleError, PlanningError
from truepath.estimation.problem.prior_model import PriorModel
from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.files.earlier.result_file import CalibrationResult
from truepath.kinematics.effects.backlash import BacklashFamily
from truepath.kinematics.effects.elastic_sag import ElasticSagFamily
from truepath.kinematics.effects.speed_error import ServoMismatchFamily
from truepath.kinematics.machine.machine import MotionLimits
from truepath.kinematics.model import MachineModel, restore_effect
from truepath.motion.motion_times import Drive, Legs, Stops, row_times_s
from truepath.motion.paths.default_points import corner_path
from truepath.motion.workspace import Workspace, inner_travel
from truepath.planning.default_path import default_path
from truepath.planning.design_state import LineDesignState, inverse
from truepath.planning.forecast import Assumptions, forecast
from truepath.planning.initial_design import predict_lag_sigmas_s, start_design
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath.planning.planner import LegChoice, Planner, SearchEffort
from truepath_drivers.interfaces.records import Path
from truepath_simulators.hidden import drives, structure
from truepath_simulators.machine_file import load_machine
from truepath_simulators.motion.profile import Limits, rest_to_rest
from truepath_simulators.worlds.synthetic import Setting


def left_mm(planner, plan):
    design = planner.update(plan).design
    return float(np.sum(inverse(design.precision) * design.gram)) ** 0.5


@pytest.fixture(scope="module")
def points(planner, mill):
    return planner(mill, "points").plan(60.0)


def test_a_path_uses_its_budget_in_long_lines_and_ends_elsewhere(planner, mill):
    made = planner(mill)
    lines = made.plan(90.0)
    assert 75.0 < row_times_s(lines).sum() <= 90.0
    away = np.linalg.norm(lines.position[-1] - lines.position[0])
    assert away >= made.design.drive.shortest_mm(6000.0)
    legs = Stops(lines.position, lines.feed_mm_min).legs
    lost, seconds = made.design.drive.steady(legs)
    assert lost.max() <= 0.25
    assert seconds.min() > 0.2


def test_the_default_path_leaves_little_more_than_a_plan_of_its_time(planner, mill):
    usual = default_path(mill, 6000.0)
    made = planner(mill)
    best = made.plan(float(row_times_s(usual).sum()))
    assert left_mm(made, usual) < 1.1 * left_mm(made, best)


def test_moving_stops_after_a_greedy_choice_leaves_less(planner, mill):
    made = planner(mill)
    low, _ = inner_travel(mill)

    def left(rounds, seed):
        rng, effort = np.random.default_rng(seed), SearchEffort(rounds=rounds)
        choice = LegChoice(made.design, made.region(), (6000.0,), rng, effort)
        stops = choice.stops(low, 60.0)
        told = made.design.information(stops.legs)
        C = inverse(made.design.precision + told)
        return float(np.sum(C * made.design.gram)) ** 0.5

    ratios = [left(2, seed) / left(0, seed) for seed in (1, 2, 3)]
    assert max(ratios) <= 1.0
    assert np.mean(ratios) < 0.99


def test_planned_lines_leave_less_than_corner_lines_of_the_same_time(planner, mill):
    made = planner(mill, across=True)
    corners = corner_path(mill, 6000.0, 0.4)
    planned = made.plan(float(row_times_s(corners).sum()))
    assert left_mm(made, planned) <= 0.55 * left_mm(made, corners)


def test_several_feeds_share_the_lines_and_tell_lags_better_than_one(planner, mill):
    feeds = (3000.0, 6000.0, 12_000.0)
    path = planner(mill, feeds=feeds).plan(120.0)
    counts = [(path.feed_mm_min[1:] == feed).sum() for feed in feeds]
    assert max(counts) - min(counts) <= 1
    drive = Drive.of(mill.axis_names, 0.4)
    station_mm = np.array([250.0, -900.0, 100.0])
    design = start_design(LineDesignState, mill, station_mm, drive, dynamic=True)

    def known(*feeds):
        made = Planner(mill, design, Workspace(), feeds)
        lags = predict_lag_sigmas_s(made.update(made.plan(120.0)).design)
        return np.mean(list(lags.values()))

    assert known(*feeds) < 0.95 * known(6000.0)


def test_after_some_lines_the_rest_is_planned_from_where_the_machine_is(planner, mill):
    made = planner(mill)
    first = made.plan(45.0)
    known = made.update(first)
    rest = known.plan(45.0, start=first.position[-1], seed=1)
    assert rest.position[0].tolist() == first.position[-1].tolist()
    again = Path(rest.axes, first.position, first.feed_mm_min, first.dwell_s)
    assert left_mm(known, rest) < 1.02 * left_mm(known, again)


def test_a_louder_tracker_is_planned_for_with_a_new_design(planner, mill):
    made = planner(mill)
    noise = made.design.noise
    louder = replace(noise, density_s=tuple(9.0 * d for d in noise.density_s))
    loud = replace(made, design=replace(made.design, noise=louder))
    plan = loud.plan(45.0)
    assert left_mm(loud, plan) > 1.5 * left_mm(made, plan)


def test_points_keep_their_budget_and_tell_more_than_random(points, planner, mill, rng):
    made = planner(mill, "points")
    drive = made.design.drive
    feed = np.full(len(points), 6000.0)
    moves = drive.times_s(Stops(points.position, feed).legs)
    assert 50.0 < moves.sum() + drive.dwell_s <= 60.0
    low, high = points.position.min(axis=0), points.position.max(axis=0)
    anywhere = replace(points, position=rng.uniform(low, high, points.position.shape))
    assert left_mm(made, points) < 0.8 * left_mm(made, anywhere)
    step = np.sign(np.diff(made.plan(90.0).position, axis=0))
    forward, backward = (step > 0).mean(axis=0), (step < 0).mean(axis=0)
    assert min(forward.min(), backward.min()) > 0.2


def test_an_approach_from_one_side_tells_less(points, planner, mill, rng):
    made = planner(mill, "points")
    design, at = made.design, points.position
    motions = [e.name for e in design.model.effects if e.name.startswith("backlash-")]
    part = np.r_[tuple(design.model.slices[name] for name in motions)]

    def variances(begin):
        rows = design.rows(Legs(begin, at, np.full(len(at), 6000.0)))
        flat = rows.reshape(-1, rows.shape[2])
        C = inverse(design.precision + flat.T @ flat)
        return np.diag(C)[part]

    from_both = variances(at - 10.0 * rng.choice([-1.0, 1.0], at.shape))
    from_one = variances(at - 10.0)
    assert np.median(from_both / from_one) < 0.6


def moving_at(machine, **stated):
    return machine_from_json({**machine_to_json(machine), "motion": stated})


def test_a_file_keeps_what_the_machine_can_and_sluggish_ones_get_lower_feeds(mill):
    stated = {"max_feed_mm_min": 16_000.0, "jerk_mm_s3": 3e4}
    machine = moving_at(mill, **stated)
    assert machine_to_json(machine)["motion"] == stated
    assert machine.motion.assumed == ("acceleration_mm_s2",)
    assert "motion" not in machine_to_json(mill)
    sluggish = moving_at(mill, max_feed_mm_min=40_000, acceleration_mm_s2=200)
    feeds = PlanRequirements().feeds(sluggish)
    assert max(feeds) < 15_000.0
    longest_mm = np.linalg.norm([500.0, 400.0, 300.0])
    assert Drive.of_machine(sluggish, 0.4).shortest_mm(max(feeds))[0] <= longest_mm


@pytest.mark.parametrize("jerk_mm_s3", [np.inf, 3e4, 3e3])
@pytest.mark.parametrize("length_mm", [1.0, 40.0, 700.0])
def test_a_line_takes_as_long_as_a_jerk_limited_machine_does(length_mm, jerk_mm_s3):
    limits = MotionLimits(1.2e4, 1500.0, jerk_mm_s3)
    leg = Legs(np.zeros((1, 3)), np.array([[length_mm, 0, 0]]), np.array([1.2e4]))
    known = Limits(1500.0, jerk_mm_s3)
    expected = rest_to_rest(np.array([length_mm]), np.array([200.0]), known)
    drive = Drive.of("XYZ", 0.0, limits)
    assert drive.times_s(leg)[0] == pytest.approx(expected[0, :, 0].sum(), rel=1e-9)


def test_a_plan_keeps_to_the_highest_feed_and_says_why_it_has_its_feeds(small_mill):
    machine = moving_at(small_mill, max_feed_mm_min=16_000, acceleration_mm_s2=3000)
    planned = make_plan(machine, PlanRequirements(minutes=1.0))
    feeds = planned.commanded.feed_mm_min[1:]
    document = plan_document(planned)
    assert feeds.max() <= 16_000.0
    assert document["feeds_mm_min"] == sorted(set(feeds), reverse=True)
    assert "16000" in document["feed_choice"]["reason"]
    lines = {f["feed_mm_min"]: f["lines"] for f in document["feed_choice"]["feeds"]}
    assert sum(lines.values()) == len(feeds)
    assert max(planned.feeds_worth.values()) < 1.08


def test_no_plan_is_faster_than_the_machine_can_or_than_is_asked_for(small_mill, mill):
    slow = replace(small_mill, motion=MotionLimits(2400.0, assumed=()))
    plan = make_plan(slow, PlanRequirements(minutes=0.6))
    assert plan.commanded.feed_mm_min.max() <= 2400.0
    with pytest.raises(PlanningError, match="give 1 to 2400 mm"):
        make_plan(slow, PlanRequirements(minutes=1.0, feeds_mm_min=(6000.0,)))
    document = plan_document(make_plan(small_mill, PlanRequirements(minutes=0.4)))
    assert document["motion"]["max_feed_mm_min"] == 10_000.0
    assert any("10000" in text for text in document["motion"]["assumed"])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("max_feed_mm_min", value) for value in (0.0, -6000.0, 1e12)),
        ("acceleration_mm_s2", 1e-9),
        *(("jerk_mm_s3", value) for value in (0.0, float("nan"))),
    ],
)
def test_motion_that_no_machine_has_is_refused_by_its_name(mill, name, value):
    with pytest.raises(BundleError, match=rf"motion\.{name} is .*; "):
        moving_at(mill, **{name: value})


def test_no_feed_is_chosen_above_the_one_asked_for_or_that_controls_do_not_read(mill):
    assert max(PlanRequirements(max_feed_mm_min=3_000.0).feeds(mill)) == 3_000.0
    both = PlanRequirements(feeds_mm_min=(900.0,), max_feed_mm_min=3e3)
    with pytest.raises(PlanningError, match="leave it out where feeds are given"):
        both.reject_nonsense(mill)
    machine = moving_at(mill, max_feed_mm_min=200_000, acceleration_mm_s2=1e5)
    assert max(PlanRequirements().feeds(machine)) <= 99_999.0


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
