"""The map from a result: what it must not depend on, how sure it is, its figures."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from results_fixtures import THREE_TARGETS, as_loaded
from truepath.answers.predicted_points import encode_predictions, read_points
from truepath.compensation.residual_error import compute_residual_error
from truepath.compensation.tables.error_map import compute_measured_ranges, map_errors
from truepath.errors import BundleError
from truepath.files.earlier.result_file import HalfDifference
from truepath.kinematics import conditions, volumetric_map
from truepath.kinematics.effects.backlash import make_half_width
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.model import MachineModel
from truepath.results import error_tables, prediction
from truepath.results.prediction import Prediction, predict
from truepath.results.result_assessment import assess_gain
from truepath.results.volumetric_error import (
    compute_both_directions,
    compute_volumetric_error,
)

HEADER = "x_mm,y_mm,z_mm"
HALF_MM, SIGMA_MM = 0.015, 2e-4


def rigid_motion(model, shift_mm, turn_rad):
    """Return θ of a machine whose whole volume moves by a shift and a turn.

    X stands first in the chain: its own turns move all that stands right of it, and
    straightness in proportion to its position moves X itself.
    """
    theta = np.zeros(model.size)
    for i, (d, t) in enumerate(zip("XYZ", "ABC", strict=True)):
        motion = next(e for e in model.effects if e.name == f"E{d}X")
        carried = np.cross(turn_rad, np.array([1.0, 0.0, 0.0]))[i]
        theta[model.slices[f"E{d}X"]] = shift_mm[i] + carried * motion.spline.knots
        theta[model.slices[f"E{t}X"]] = turn_rad[i]
    return theta


def test_a_rigid_motion_of_the_volume_changes_no_prediction(loaded, travel_points, rng):
    # So small that motions add up.
    shift_mm, turn_rad = 1e-3 * rng.standard_normal(3), 1e-6 * rng.standard_normal(3)
    model = loaded.model
    effects, theta = list(model.effects), []
    for k, effect in enumerate(model.effects):
        theta.append(loaded.theta[model.slices[effect.name]])
        if isinstance(effect, ErrorMotion):
            effects[k] = replace(effect, gauge=np.eye(effect.spline.size))
            theta[k] = effect.gauge @ theta[k]
    model = MachineModel(model.machine, tuple(effects))
    theta, none = np.concatenate(theta), np.zeros((model.size, model.size))
    free = replace(loaded, model=model, theta=theta, covariance=none)
    moved_by = rigid_motion(free.model, shift_mm, turn_rad)
    at = conditions.make_standstill(free.machine, travel_points)
    assert np.abs(free.model.jacobian(at) @ moved_by).max() > 0.5e-3
    plain = predict(free, travel_points)
    moved = predict(replace(free, theta=free.theta + moved_by), travel_points)
    assert moved.error_um == pytest.approx(plain.error_um, abs=1e-6)
    blind = [rigid_motion(free.model, e, 0 * e) for e in np.eye(3)]
    blind += [rigid_motion(free.model, 0 * e, 1e-3 * e) for e in np.eye(3)]
    covariance = np.sum([np.outer(b, b) for b in blind], axis=0)
    predicted = predict(replace(free, covariance=covariance), travel_points)
    assert predicted.uncertainty_um.max() < 1e-3


def test_a_rigid_motion_within_the_map_is_removed_over_the_travel(loaded):
    machine = loaded.machine
    nodes = [np.linspace(a.low, a.high, 41) for a in machine.linear_axes]
    middle = [0.5 * (n[1:] + n[:-1]) for n in nodes]
    grid = np.stack([g.ravel() for g in np.meshgrid(*middle, indexing="ij")], axis=1)
    error = predict(loaded, grid).error_um
    arm = grid - grid.mean(axis=0)
    largest = np.abs(error).max()
    assert np.abs(error.mean(axis=0)).max() < 1e-3 * largest
    turn = np.abs(np.cross(arm, error).mean(axis=0)).max()
    assert turn < 1e-3 * largest * np.abs(arm).max()


def test_uncertainty_is_the_spread_of_maps(loaded, travel_points, rng, monkeypatch):
    at = conditions.make_standstill(loaded.machine, travel_points)
    J = 1e3 * volumetric_map.build_volumetric_map(loaded.model).jacobian(at)
    normal = loaded.theta, loaded.covariance
    drawn = rng.multivariate_normal(*normal, 4000, method="eigh")
    spread = np.std(J @ drawn.T, axis=2)
    predicted = predict(loaded, travel_points)
    assert predicted.uncertainty_um == pytest.approx(spread, rel=0.06)
    assert predicted.error_um == pytest.approx(J @ loaded.theta)
    assert predicted.warnings == ()
    monkeypatch.setattr(prediction, "_BLOCK", 7)
    cut = predict(loaded, travel_points)
    assert cut.error_um == pytest.approx(predicted.error_um, abs=1e-12)
    assert cut.uncertainty_um == pytest.approx(predicted.uncertainty_um, abs=1e-12)


def test_beyond_the_travel_errors_go_on_straight_and_the_user_is_told(loaded):
    x = np.array([300.0, 350.0, 400.0, 450.0])
    points = np.column_stack([x, np.full(4, 100.0), np.full(4, 100.0)])
    predicted = predict(loaded, points)
    assert np.diff(predicted.error_um, 2, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert (np.diff(predicted.uncertainty_um[1:].max(axis=1)) > 0).all()
    end = np.array([[300.0 + 1e-5, 400.0, 310.0]])  # rounded
    assert predict(loaded, end).warnings == ()
    (told,) = predicted.warnings
    assert told.startswith("3 of 4 points lie beyond the travel (X -200 to 300, Y")


def test_each_point_is_predicted_for_its_target(construct, rng):
    result = as_loaded(construct(THREE_TARGETS))
    points = rng.uniform([-200, 10, 0], [300, 400, 310], (9, 3))
    names = ("short", "long", "aside") * 3
    mixed = predict(result, points, names)
    for name in set(names):
        mine = [i for i, n in enumerate(names) if n == name]
        alone = predict(result, points[mine], [name] * len(mine))
        assert mixed.error_um[mine] == pytest.approx(alone.error_um)
    assert mixed.error_um[0] != pytest.approx(predict(result, points).error_um[1])
    plain = predict(result, points)
    named = predict(result, points, ["short"] * len(points))
    assert plain.error_um == pytest.approx(named.error_um)
    (said,) = plain.warnings
    assert said == "the points name no target: short is meant, the first of the machine"
    assert named.warnings == ()


def test_the_answer_holds_the_question_and_six_numbers_more(loaded):
    asked = f'{HEADER},label\n10.50,20,30,first\n-1e2,4e+01,0.5,"a, b"\n'
    points = read_points(asked.encode(), loaded.machine)
    predicted = predict(loaded, points.position)
    rows = list(csv.reader(io.StringIO(encode_predictions(points, predicted))))
    assert rows[0][:4] == ["x_mm", "y_mm", "z_mm", "label"]
    assert rows[0][4:] == [f"{what}{axis}_um" for what in "du" for axis in "xyz"]
    assert rows[1][:4] == ["10.50", "20", "30", "first"]
    assert rows[2][:4] == ["-1e2", "4e+01", "0.5", "a, b"]
    numbers = np.array([row[4:] for row in rows[1:]], float)
    expected = np.hstack([predicted.error_um, predicted.uncertainty_um])
    assert numbers == pytest.approx(expected, abs=1e-5)


def test_an_answer_can_be_asked_again_and_columns_stand_in_any_order(loaded):
    points = read_points(b"z_mm,note,x_mm,y_mm\n3,n,1,20\n", loaded.machine)
    assert points.position.tolist() == [[1.0, 20.0, 3.0]]
    once = encode_predictions(points, predict(loaded, points.position))
    again = read_points(once.encode(), loaded.machine)
    assert encode_predictions(again, predict(loaded, again.position)) == once
    nothing = Prediction(np.full((1, 3), -1e-9), np.zeros((1, 3)), ())
    assert "-0.00000" not in encode_predictions(points, nothing)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "p.csv, row 1: has no header"),
        ("x_mm,y_mm\n1,2\n", "p.csv, column z_mm: is missing"),
        (f"{HEADER}\n", "p.csv: has no rows"),
        (f"{HEADER}\n1,20,3\n1,nan,3\n", "p.csv, row 3, column y_mm: is empty or NaN"),
        (f"{HEADER}\n1,20,\n", "p.csv, row 2, column z_mm: is empty or NaN"),
        (f"{HEADER}\n1,20,inf\n", "p.csv, row 2, column z_mm: is infinite"),
        (f"{HEADER}\n1,left,3\n", "p.csv, row 2, column y_mm: is 'left', not a number"),
        (f"{HEADER}\n1,20\n", "p.csv, row 2: has 2 cells, the header 3"),
        (f"{HEADER}\n1e9,20,3\n", "p.csv, row 2, column x_mm: is 1e+09, no position"),
        (f"{HEADER},x_mm\n1,20,3,4\n", "column x_mm: appears more than once"),
    ],
)
def test_bad_points_are_one_clear_error(loaded, text, said):
    with pytest.raises(BundleError) as caught:
        read_points(text.encode(), loaded.machine, file="p.csv")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_point_may_name_its_target(loaded, construct):
    asked = f"{HEADER},target\n1,20,3,"
    of_three = construct(THREE_TARGETS).model.machine
    assert read_points(f"{asked}long\n".encode(), of_three).target == ("long",)
    with pytest.raises(BundleError, match=r"row 2, column target: is 'T9', unknown"):
        read_points(f"{asked}T9\n".encode(), of_three)
    # A machine without named targets passes the column on.
    points = read_points(f"{asked}T9\n".encode(), loaded.machine)
    assert points.target == ()
    assert "target" in points.table.names


@pytest.fixture(scope="module")
def seen(estimate):
    return compute_volumetric_error(estimate)


def test_the_map_is_that_of_predictions_and_what_they_leave(estimate, seen, loaded):
    axes = estimate.model.machine.linear_axes
    assert len(seen.position_mm) == 729
    assert seen.position_mm.min(axis=0).tolist() == [a.low for a in axes]
    assert seen.position_mm.max(axis=0).tolist() == [a.high for a in axes]
    predicted = predict(loaded, seen.position_mm)
    assert seen.error_um == pytest.approx(predicted.error_um)
    assert seen.uncertainty_um == pytest.approx(predicted.uncertainty_um)
    length = np.linalg.norm(seen.error_um, axis=1)
    assert seen.before.mean.value_um == pytest.approx(length.mean())
    assert seen.before.p95.value_um == pytest.approx(np.quantile(length, 0.95))
    assert seen.before.largest.value_um == pytest.approx(length.max())
    # After: the mean square length is the mean trace of the covariance at the points.
    expected = np.mean(np.sum(seen.uncertainty_um**2, axis=1))
    quantiles = seen.after_lengths_um
    middle = 0.5 * (quantiles[1:] + quantiles[:-1])
    assert np.mean(middle**2) == pytest.approx(expected, rel=0.1)
    assert (np.diff(quantiles) >= 0).all()
    after = seen.after
    assert after.mean.value_um < after.p95.value_um < after.largest.value_um
    surer = (replace(estimate, covariance=k * estimate.covariance) for k in (0.25, 0.0))
    halved, certain = map(compute_volumetric_error, surer)
    assert halved.after.mean.value_um == pytest.approx(after.mean.value_um / 2)
    assert halved.before.mean.value_um == pytest.approx(seen.before.mean.value_um)
    assert certain.after.largest.value_um == 0.0
    assert certain.before.mean.uncertainty_um == pytest.approx(0.0, abs=1e-9)


def test_the_scale_of_lengths_is_in_the_uncertainty_of_the_volumetric_error(estimate):
    ppm, certain = 40.0, replace(estimate, covariance=1e-6 * estimate.covariance)
    scaled = certain.widen_by_scale(1e-6 * ppm)
    stated = compute_volumetric_error(scaled, ppm).before.mean
    place = compute_volumetric_error(certain)
    without = place.before.mean
    low, high = np.array([(a.low, a.high) for a in estimate.model.machine.axes]).T
    away_mm = place.position_mm - (low + high) / 2.0
    scale = 1e-3 * ppm * np.random.default_rng(4).standard_normal(2000)
    drawn = (place.error_um + one * away_mm for one in scale)
    true = [np.linalg.norm(one, axis=1).mean() for one in drawn]
    off = np.abs(np.array(true) - stated.value_um)
    assert np.mean(off <= 2.0 * stated.uncertainty_um) >= 0.94
    assert np.mean(off <= 2.0 * without.uncertainty_um) < 0.1
    assert stated.value_um == without.value_um
    # Nothing but the scale is unknown: the farthest corner is off by 1 ppm of its way.
    surest = replace(estimate, covariance=1e-12 * estimate.covariance)
    left = compute_volumetric_error(surest.widen_by_scale(1e-6), 1.0).after.largest
    corner_um = 1e-3 * np.linalg.norm(high - low) / 2.0
    most_um = left.value_um + 2.0 * left.uncertainty_um
    assert most_um == pytest.approx(2.0 * corner_um, rel=0.1)
    assert left.scale_uncertainty_um == pytest.approx(left.uncertainty_um, rel=0.1)


def test_lost_motion_adds_to_the_map_as_accounts_of_files_say(estimate, seen, loaded):
    assert compute_both_directions(estimate) is None
    effect = make_half_width("EXX", estimate.model.machine.linear("X"))
    covariance = np.pad(estimate.covariance, (0, 1))
    covariance[-1, -1] = SIGMA_MM**2
    model, theta = estimate.model.with_effects(effect), [*estimate.theta, HALF_MM]
    told = {"theta": np.array(theta), "covariance": covariance}
    losing = replace(estimate, model=model, **told)
    mean = compute_volumetric_error(losing).before.mean.value_um
    assert mean == pytest.approx(seen.before.mean.value_um)
    found = compute_both_directions(losing)
    both, after_um = found.before, compute_volumetric_error(losing).after.mean.value_um
    left_um = np.hypot(after_um, 1e3 * HALF_MM)
    assert found.left.mean.value_um == pytest.approx(left_um, rel=0.15)
    assert both.mean.value_um > max(mean, 1e3 * HALF_MM)
    assert both.mean.value_um == pytest.approx(np.hypot(mean, 1e3 * HALF_MM), rel=0.1)
    (half,) = error_tables.compute_half_differences(losing)
    known = {"EXX": HalfDifference(half.position_mm, half.value)}
    result = replace(loaded, halves=known)
    measured = compute_measured_ranges(result.machine, {}, None)
    account = compute_residual_error(map_errors(result), measured).summarise_map()
    expanded = 2.0 * both.mean.uncertainty_um
    assert both.mean.value_um == pytest.approx(account["mean"], abs=expanded)
    assert both.largest.value_um == pytest.approx(account["largest"], rel=0.01)


@pytest.mark.parametrize(
    ("share", "state"),
    [(0.1, "usable"), (0.4, "doubtful"), (0.7, "doubtful"), (1.2, "not-usable")],
)
def test_a_result_that_would_hardly_make_the_machine_better_says_so(seen, share, state):
    left_um = share * seen.before.mean.value_um
    mean = replace(seen.after.mean, value_um=left_um)
    verdict = assess_gain(replace(seen, after=replace(seen.after, mean=mean)))
    assert verdict.state == state
    kinds = [reason.kind for reason in verdict.reasons]
    assert kinds == ["little-gained"] * (state != "usable")
