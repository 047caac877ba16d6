"""Plans: what they tell, how long they take, and planning anew on the way."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.motion.motion_times import Drive, Legs, Stops, row_times_s
from truepath.motion.paths.default_points import corner_path
from truepath.motion.workspace import Workspace, inner_travel
from truepath.planning.default_path import default_path
from truepath.planning.design_state import LineDesignState, inverse
from truepath.planning.initial_design import predict_lag_sigmas_s, start_design
from truepath.planning.planner import LegChoice, Planner, SearchEffort
from truepath_drivers.interfaces.records import Path


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
