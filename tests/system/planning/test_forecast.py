"""The next configuration, what a plan leaves unknown, and its grade."""

from dataclasses import asdict, replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.linalg import block_diag

import paths_by_hand
from estimating import estimate, judge_map
from mills import build_mill
from recorded import load_small, record_run
from truepath.alignment.align import align, align_all
from truepath.errors import PlanningError, Unidentifiable
from truepath.files.environment import Refraction, state_length_ppm
from truepath.kinematics import conditions, model, splines, volumetric_map
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.machine.machine import RotaryAxis, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise, TrackerSpecification
from truepath.kinematics.model import MachineModel
from truepath.kinematics.volumetric_map import compute_volumetric_gram
from truepath.motion.configurations import Configurations
from truepath.numerics.design_criteria import IntegratedVariance
from truepath.planning.default_path import default_path
from truepath.planning.forecast import Assumptions, forecast, predict_undetermined
from truepath.planning.grade import SetUp, grade, grade_together, verdict
from truepath.planning.next_configuration import (
    SearchSpace,
    next_configuration,
    search_space,
)
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
    stretch = model.compute_scale_parameters(foretold.model)
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


plan = cache(default_path)
STATION_MM = np.array([-900.0, 200.0, 100.0])


@pytest.fixture(scope="module")
def demo(record):
    return record(1)[0].machine


path_of = partial(paths_by_hand.path_of, dwell_s=0.4)


@pytest.mark.parametrize(("mode", "rows"), [("otf", 16), ("standstill", 60)])
def test_what_is_expected_before_motion_is_achieved(record, mode, rows):
    run, _ = record(51, mode, rows=rows)
    found = estimate(align(run))
    stand = found.runs[0].pose.invert().translation_mm
    expected = grade(run.machine, run.commanded, station_mm=stand).sigma_mm
    achieved = np.sqrt(np.sum(compute_volumetric_gram(found.model) * found.covariance))
    assert 0.6 < achieved / expected < 1.6


def test_more_lines_and_a_nearer_tracker_are_graded_better_a_better_one_the_same(demo):
    few, many = (plan(demo, lines=n) for n in (8, 24))
    near = grade(demo, many, station_mm=STATION_MM)
    assert grade(demo, few, station_mm=STATION_MM).number > 1.5 * near.number
    assert near.sigma_mm < grade(demo, many, station_mm=4.0 * STATION_MM).sigma_mm
    fine = TrackerNoise(0.5, 0.15, 1.5, 2.0)
    path = plan(demo)
    number = grade(demo, path, station_mm=STATION_MM).number
    finer = grade(replace(demo, tracker=fine), path, station_mm=STATION_MM).number
    assert finer == pytest.approx(number, rel=0.15)


def test_an_unknown_stand_counts_as_the_worst_of_usual_ones(demo):
    path = plan(demo, lines=10)
    found = grade(demo, path)
    assert found.assumed
    assert found.best < found.number
    known = grade(demo, path, station_mm=found.station_mm)
    assert known.number == pytest.approx(found.number)
    assert not known.assumed


def test_the_default_plan_is_good_and_verdicts_change_at_a_quarter_and_at_one(demo):
    found = grade(demo, plan(demo))
    assert found.verdict == "good"
    assert found.shapes == ()
    assert all(motion.remedy is None for motion in found.weakest)
    assert found.improved is None
    numbers = (0.25, 0.251, 1.0, 1.01)
    assert [verdict(n) for n in numbers] == ["good", "usable", "usable", "poor"]


def test_the_blind_spot_of_corner_paths_is_named_before_anything_moves(record):
    run, _ = record(27, corners=True)
    found = grade(run.machine, run.commanded, perpendicular_only=True)
    assert {m.symbol for m in found.weakest} == {"EXX", "EYY", "EZZ"}
    assert set(found.shapes[0].symbols) == {"EXX", "EYY", "EZZ"}
    assert found.shapes[0].form == "an S of the error along X"
    assert grade(run.machine, run.commanded).shapes == ()


def test_a_short_reach_in_z_is_cured_by_lines_that_go_up_z(demo):
    low = plan(demo)
    flat = replace(low, position=low.position * np.array([1.0, 1.0, 0.3]))
    found = grade(demo, flat, station_mm=STATION_MM)
    assert found.verdict == "poor"
    assert found.weakest[0].symbol[2] == "Z"
    remedy = found.weakest[0].remedy
    assert abs(remedy.end[2] - remedy.begin[2]) > 0.8 * demo.linear_axes[2].high
    assert found.improved < 0.5 * found.number


def test_the_line_asked_for_lowers_the_number_it_promises(demo):
    path = plan(demo, lines=6)
    found = grade(demo, path, station_mm=STATION_MM)
    remedy = found.weakest[0].remedy
    longer = np.vstack([path.position, remedy.begin, remedy.end])
    again = grade(demo, path_of(*longer), station_mm=STATION_MM)
    assert found.improved < found.number
    assert again.number == pytest.approx(found.improved, rel=0.1)


def test_a_path_in_two_runs_is_worth_hardly_less_and_a_longer_tool_tells_more(demo):
    path = plan(demo, lines=24)
    half = len(path) // 2
    halves = path.position[: half + 1], path.position[half:]
    parts = [path_of(*rows) for rows in halves]
    together = grade_together(demo, [SetUp(demo, part, STATION_MM) for part in parts])
    alone = grade(demo, parts[0], station_mm=STATION_MM)
    whole = grade(demo, path, station_mm=STATION_MM)
    assert whole.number <= together.number < 1.3 * whole.number
    assert together.number < alone.number
    second = (20.0, 30.0, -350.0)
    longer = replace(demo, targets=(Target("", "tool", second),))
    both = replace(demo, targets=(*demo.targets, Target("long", "tool", second)))
    path = plan(demo)
    set_ups = [SetUp(machine, path, STATION_MM) for machine in (demo, longer)]
    said = {s[:3] for s in grade_together(both, set_ups).unobservable}
    assert said == {s[:3] for s in grade(demo, path).unobservable} - {"EAZ", "EBZ"}


@pytest.mark.parametrize(
    "rows", [[[0, 0, 0], [400, 300, 200]], [[0, 0, 0], [400, 0, 0]]]
)
def test_a_set_up_that_tells_little_is_poor_and_one_of_nothing_refused(demo, rows):
    assert grade(demo, path_of(*rows)).number > 5.0
    stood = Configurations(demo.axis_names, np.array(rows[:1], float), np.ones(1))
    assert grade(demo, stood).verdict == "poor"
    stood = Configurations(demo.axis_names, np.zeros((1, 3)), np.zeros(1))
    with pytest.raises(PlanningError, match="nothing would be measured"):
        grade(demo, stood)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_what_is_left_of_the_error_follows_the_grade(record):
    """The table of docs/grade.md, on machines of one size."""
    share = {"good": [], "usable": [], "poor": []}
    for seed, rows in enumerate([6, 7, 9, 11, 16, 20, 34], 400):
        run, truth = record(seed, rows=rows)
        found = estimate(align(run))
        stand = found.runs[0].pose.invert().translation_mm
        graded = grade(run.machine, run.commanded, station_mm=stand)
        left = judge_map(found, truth.deviation_mm)
        share[graded.verdict].append(left.share)
    assert max(share["good"]) < 0.12
    assert np.median(share["good"]) < np.median(share["usable"])
    assert np.median(share["usable"]) < np.median(share["poor"])


SPLINES = [splines.natural_spline(np.linspace(0.0, 1.0, n)) for n in (5, 6, 7)]
AXES = SearchSpace(tuple(s.knots for s in SPLINES), (3, 3, 3))
VARIANCE = 1e-4


def stacked(position):
    """Three stacked splines seen as one height (brunn-hanebeck-2005, Figure 6)."""
    return np.hstack([s.basis(position[:, k]) for k, s in enumerate(SPLINES)])


def stacked_belief():
    gram = block_diag(*(spline.gram() for spline in SPLINES))
    return IntegratedVariance(np.eye(len(gram)), gram)


def dense(known, rows, axes, ticks):
    grid = np.meshgrid(*[np.linspace(b[0], b[-1], ticks) for b in axes.borders])
    position = np.stack([g.ravel() for g in grid], axis=1)
    return known.compute_drops(rows(position), VARIANCE).max()


def test_each_next_configuration_of_three_stacked_axes_beats_a_dense_search():
    known = stacked_belief()
    for turn in range(8):
        best = next_configuration(known, stacked, AXES, VARIANCE, seed=turn)
        assert best.drop >= dense(known, stacked, AXES, 41)
        there = known.compute_drops(stacked(best.position[None]), VARIANCE)[0]
        assert best.drop == pytest.approx(there)
        known = known.update(stacked(best.position[None])[0], VARIANCE)


def test_the_answer_is_no_worse_than_the_dense_search_and_the_same_again():
    known = stacked_belief()
    best = next_configuration(known, stacked, AXES, VARIANCE)
    assert best.drop >= best.searched > 0.9 * best.drop
    again = next_configuration(known, stacked, AXES, VARIANCE)
    assert best.position.tolist() == again.position.tolist()


def mill(*rotary):
    made = build_mill((0.0, 0.0, -100.0), travel_mm=(400.0, 400.0, 400.0))
    names = tuple(axis.name for axis in rotary)
    return replace(made, workpiece_side=names, axes=(*made.axes, *rotary))


def believed(model):
    sizes = np.array([1e-5 if p.unit == "rad" else 1e-2 for p in model.parameters])
    return IntegratedVariance(np.diag(sizes**2), np.diag(sizes**-2.0))


def motions(machine, symbols):
    axes = {axis.name: axis for axis in machine.axes}
    made = (make_error_motion(symbol, axes[symbol[2]], 4) for symbol in symbols)
    return MachineModel(machine, tuple(made))


def point_rows(model, direction=None):
    def rows(position):
        columns = model.jacobian(conditions.make_standstill(model.machine, position))
        return columns if direction is None else np.einsum("nip,i", columns, direction)

    return rows


@pytest.mark.parametrize("direction", [np.array([1.0, 0.0, 0.0]), None])
def test_turns_on_their_levers_are_searched_exactly_as_well(direction):
    model = motions(mill(), ("EXX", "ECX", "EXY", "EBY", "EXZ"))
    known, axes = believed(model), search_space(model)
    rows = point_rows(model, direction)
    best = next_configuration(known, rows, axes, VARIANCE)
    assert best.drop >= dense(known, rows, axes, 21)


def test_rotary_axes_are_searched_between_their_knots_too():
    table = RotaryAxis("C", 0.0, 360.0, (200.0, 200.0, 0.0), (0.0, 0.0, 1.0))
    model = motions(mill(table), ("EXX", "ECX", "EXC", "EAC", "ECC"))
    known, axes = believed(model), search_space(model)
    rows = point_rows(model)
    best = next_configuration(known, rows, axes, VARIANCE)
    there = known.compute_drops(rows(best.position[None]), VARIANCE)[0]
    assert best.drop == pytest.approx(there, rel=1e-6)
    assert best.drop >= dense(known, rows, axes, 13)
