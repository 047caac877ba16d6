"""Figures of standards, lengths and decisions, from deviations that are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from truepath.answers.verification.conformity import (
    compute_joint_factor,
    decide_points,
)
from truepath.answers.verification.static_tests import (
    SampledVectors,
    evaluate_static_lines_and_circles,
)
from truepath.answers.verification.verification import (
    NAMES,
    compute_measured_statistics,
)
from truepath.kinematics.conditions import make_standstill

TARGETS = np.array([20.0, 120.0, 260.0, 390.0])
BEYOND = 10.0, 400.0
RUNS = 5
SHAPES_UM = {  # radial, by the outward direction of a place and its sense
    "an exact circle": lambda out, sense: 0.0 * sense,
    "an ellipse": lambda out, sense: 4.0 * out[:, 0] ** 2,
    "a small ellipse": lambda out, sense: 0.5 * out[:, 0] ** 2,
    "lost motion": lambda out, sense: 1.5 * sense * np.sign(out[:, 1]),
    "a place that is off": lambda out, sense: np.where(out[:, 1] > 0.999, 8.0, 0.0),
}
MANY = 1e6  # degrees of freedom: as good as known
PLACES, TRIALS, DRAWS = 120, 60, 300
SIGMA_MM = 1e-3


def axis_runs(machine, start, direction):
    """Return positions of five runs to and fro along a line, with both overruns."""
    along = np.array([BEYOND[0], *TARGETS, BEYOND[1], *TARGETS[::-1]])
    distance = np.append(np.tile(along, RUNS), BEYOND[0])
    return np.array(start) + distance[:, None] * np.array(direction), distance


def evaluate(machine, position, deviation_mm, rng, noise_mm=1e-9, scale_mm=None):
    nothing = np.zeros_like(deviation_mm)
    noise = noise_mm * rng.standard_normal((*deviation_mm.shape, 50))
    scale = nothing if scale_mm is None else scale_mm
    measured = SampledVectors(deviation_mm, noise, scale[:, :, None])
    places = SimpleNamespace(at=make_standstill(machine, np.array(position)))
    return evaluate_static_lines_and_circles(places, measured, nothing)


def test_figures_of_an_axis_are_those_of_the_standard(mill, rng):
    position, distance = axis_runs(mill, (0.0, 50.0, -40.0), (1.0, 0.0, 0.0))
    came = np.sign(np.diff(distance, prepend=distance[0] - 1.0))
    # 10 µm a metre, 3 µm of reversal, and runs that scatter by −1, 0 or 1 µm.
    run = np.minimum(np.arange(len(distance)) // (2 * len(TARGETS) + 2), RUNS - 1)
    scatter = np.array([-1.0, 1.0, 0.0, 1.0, -1.0])[run]
    deviation = np.zeros((len(position), 3))
    deviation[:, 0] = 1e-3 * (0.01 * distance + 1.5 * came + scatter)
    found = evaluate(mill, position, deviation, rng, noise_mm=1e-12).lines
    assert [(one.axes, one.kind, one.runs) for one in found] == [("X", "iso-230-2", 5)]
    figures = found[0].figures.value_um
    assert found[0].position_mm == pytest.approx(TARGETS - BEYOND[0])
    assert figures["B"] == pytest.approx(3.0, abs=1e-6)
    assert figures["M"] == pytest.approx(3.7, abs=1e-6)
    assert figures["E"] == pytest.approx(6.7, abs=1e-6)
    s = np.std([-1.0, 1.0, 0.0, 1.0, -1.0], ddof=1)
    assert figures["R"] == pytest.approx(4.0 * s + 3.0, abs=1e-6)
    assert figures["A"] == pytest.approx(6.7 + 4.0 * s, abs=1e-6)


def test_a_target_between_two_rounded_numbers_stays_one_target(mill, rng):
    position, _ = axis_runs(mill, (0.0, 50.0, -40.0), (1.0, 0.0, 0.0))
    at_edge = np.abs(position[:, 0] - TARGETS[1]) < 1.0
    position[at_edge, 0] = 120.0005  # half of a thousandth from the first place
    position += 1e-12 * rng.standard_normal(position.shape)  # means of many samples
    # What the tracker scatters is said beside repeatability.
    still = np.zeros((len(position), 3))
    (found,) = evaluate(mill, position, still, rng, noise_mm=1e-3).lines
    assert (len(found.position_mm), found.runs) == (len(TARGETS), RUNS)
    assert found.figures.value_um["R"] == 0.0
    assert 4.0 < found.figures.own_um["R"] < 9.0
    assert found.figures.own_um["E"] < found.figures.own_um["A"]


def test_both_senses_of_a_circle_stay_one_circle_whatever_its_centre(mill, rng):
    out, position = circle_in_both_senses()
    position += np.array([0.05, 0.05, 0.0])
    position[len(out) // 2 :] += 1e-5  # rows of a plan are rounded
    position[: len(out) // 2] -= 1e-5
    (found,) = evaluate(mill, position, np.zeros_like(out), rng).circles
    assert (found.plane, len(found.angle_deg)) == ("XY", len(out))


def test_a_line_of_three_axes_is_a_diagonal_and_scattered_points_are_no_line(mill, rng):
    position, distance = axis_runs(mill, (0.0, 0.0, -300.0), (0.6, 0.48, 0.64))
    deviation = 1e-5 * distance[:, None] * np.array([0.6, 0.48, 0.64])
    (found,) = evaluate(mill, position, deviation, rng).lines
    assert (found.axes, found.kind) == ("XYZ", "iso-230-6")
    assert found.figures.value_um["E"] == pytest.approx(3.7, abs=1e-3)
    position = rng.uniform((0.0, 0.0, -300.0), (500.0, 400.0, 0.0), (40, 3))
    scattered = evaluate(mill, position, np.zeros((40, 3)), rng)
    assert scattered.lines == ()
    assert scattered.circles == ()


def count_held(machine, position, exact_mm, noise_um, trials, rng):
    of = "lines" if np.ptp(position[:, 1]) == 0.0 else "circles"
    (true,) = getattr(evaluate(machine, position, exact_mm, rng), of)
    noise_mm = 1e-3 * noise_um * rng.standard_normal((*exact_mm.shape, 300))
    nothing, held = np.zeros_like(exact_mm), dict.fromkeys(true.figures.value_um, 0)
    places = SimpleNamespace(at=make_standstill(machine, position))
    for _ in range(trials):
        scatter_mm = 1e-3 * noise_um * rng.standard_normal(exact_mm.shape)
        seen = SampledVectors(exact_mm + scatter_mm, noise_mm, nothing[:, :, None])
        found = evaluate_static_lines_and_circles(places, seen, nothing)
        (found,) = getattr(found, of)
        for name, value in found.figures.value_um.items():
            off_um = abs(value - true.figures.value_um[name])
            held[name] += off_um <= 2.0 * found.figures.uncertainty_um[name]
    return held


@pytest.mark.parametrize("scatter_um", [0.0, 2.0])
def test_accuracy_and_repeatability_hold_in_95_of_100_cases(mill, rng, scatter_um):
    position, distance = axis_runs(mill, (0.0, 50.0, -40.0), (1.0, 0.0, 0.0))
    exact_mm = np.zeros((len(position), 3))
    scatter = scatter_um * rng.standard_normal(len(position))
    exact_mm[:, 0] = 1e-3 * (0.01 * distance + scatter)
    held = count_held(mill, position, exact_mm, 1.0, 60, rng)
    assert min(held["A"], held["R"]) >= 0.95 * 60


def circle_in_both_senses():
    """Return outward directions of a polygon of 24 standstills, and positions on it."""
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    angle = np.concatenate([angle, angle[::-1]])
    out = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    return out, np.round(np.array([200.0, 200.0, -50.0]) + 100.0 * out, 4)


def test_circles_in_two_planes_are_two_and_an_axis_too_long_an_ellipse(mill, rng):
    out, _ = circle_in_both_senses()
    in_xz, in_yz = out[:, [0, 2, 1]], out[:, [2, 0, 1]]
    position = np.array([200.0, 200.0, -150.0]) + 100.0 * np.vstack([in_xz, in_yz])
    deviation = np.zeros_like(position)
    deviation[: len(out), 0] = 4e-3 * in_xz[:, 0]  # X is too long as XZ is driven
    found = evaluate(mill, np.round(position, 4), deviation, rng)
    assert found.lines == ()
    for circle, plane, long_um in zip(found.circles, ("XZ", "YZ"), (4, 0), strict=True):
        assert (circle.plane, len(circle.angle_deg)) == (plane, len(out))
        assert circle.radius_mm == pytest.approx(100.0, abs=1e-3)
        assert circle.figures.value_um["G"] == pytest.approx(long_um, abs=0.05)
        assert circle.figures.value_um["F_max"] == pytest.approx(long_um, abs=0.01)
        assert circle.figures.value_um["F_min"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("noise_um", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("shape", SHAPES_UM)
def test_circle_figures_hold_true_ones_in_95_of_100_cases(mill, rng, shape, noise_um):
    out, position = circle_in_both_senses()
    sense = np.repeat([1.0, -1.0], len(out) // 2)
    radial_um = SHAPES_UM[shape](out, sense)
    true_mm = 1e-3 * radial_um[:, None] * out
    held = count_held(mill, position, true_mm, noise_um, 80, rng)
    assert min(held.values()) >= 0.95 * 80


def test_of_an_exact_circle_the_noise_is_said_and_nought_is_within_u(mill, rng):
    out, position = circle_in_both_senses()
    still = 1e-3 * rng.standard_normal(out.shape)
    (found,) = evaluate(mill, position, still, rng, noise_mm=1e-3).circles
    assert 3.0 < found.figures.own_um["G"] < 6.0
    assert 0.0 <= found.figures.value_um["G"] <= 2.0 * found.figures.uncertainty_um["G"]
    assert found.figures.value_um["G"] < found.figures.own_um["G"]


def test_the_scale_of_lengths_is_in_figures_of_length_and_not_in_noise(mill, rng):
    position, _ = axis_runs(mill, (0.0, 50.0, -40.0), (1.0, 0.0, 0.0))
    still, ppm = np.zeros((len(position), 3)), 10.0
    scale_mm = 1e-6 * ppm * (position - position.mean(axis=0))
    (line,) = evaluate(mill, position, still, rng, scale_mm=scale_mm).lines
    travel_m = 1e-3 * np.ptp(TARGETS)
    assert line.figures.uncertainty_um["E"] == pytest.approx(
        ppm * travel_m * 0.6, rel=0.3
    )
    assert line.figures.own_um["E"] < 1e-3
    assert line.figures.uncertainty_um["B"] < 1e-3

    out, position = circle_in_both_senses()
    still, radius_m = np.zeros_like(out), 0.1
    scale_mm = 1e-6 * ppm * (position - position.mean(axis=0))
    (circle,) = evaluate(mill, position, still, rng, scale_mm=scale_mm).circles
    assert circle.figures.uncertainty_um["F_max"] == pytest.approx(
        ppm * radius_m, rel=0.5
    )
    assert circle.figures.uncertainty_um["G"] < 1e-2


@pytest.mark.parametrize(
    ("length_um", "decision"),
    [
        ([3.0, 7.9], "within"),
        ([3.0, 9.5], "undecided"),
        ([3.0, 11.0], "undecided"),
        ([3.0, 12.5], "outside"),
    ],
)
def test_only_what_is_clear_of_the_limit_by_u_is_decided(length_um, decision):
    sigma_um = np.full(2, 0.9)  # expanded for two places: 2.0 µm
    found = decide_points(np.array(length_um), sigma_um, MANY, 10.0)
    assert found.conformity == decision
    assert found.worst == 1
    assert found.expanded_um == pytest.approx(2.01, abs=0.02)


def test_one_place_that_fails_fails_all_and_what_was_not_seen_is_never_within():
    length, sigma = np.array([1.0, 9.9, 20.0]), np.array([0.1, 5.0, 0.1])
    found = decide_points(length, sigma, MANY, 10.0)
    assert (found.conformity, found.worst) == ("outside", 2)
    for length_um, decision in ((3.0, "undecided"), (20.0, "outside")):
        length = np.array([length_um])
        found = decide_points(length, sigma[:1], MANY, 10.0, sees_all=False)
        assert found.conformity == decision


def test_so_many_places_lie_within_together_in_95_of_100_cases(rng):
    k = compute_joint_factor(30, MANY)
    within = np.abs(rng.standard_normal((20_000, 30))).max(axis=1) <= k
    assert within.mean() == pytest.approx(0.95, abs=0.005)
    assert compute_joint_factor(1, MANY) == pytest.approx(1.96, abs=0.01)
    assert compute_joint_factor(1, 8.0) == pytest.approx(2.306, abs=0.001)  # Student


def draw_noise(rng, count):
    slow = rng.standard_normal((PLACES // 10, 3, count)).repeat(10, axis=0)
    return SIGMA_MM * (0.8 * rng.standard_normal((PLACES, 3, count)) + 0.6 * slow)


def draw_field(rng, mean_mm):
    at = rng.uniform(-1.0, 1.0, (PLACES, 3))
    shapes = np.column_stack([at, at**2, np.sin(3.0 * at), at[:, [0]] * at[:, [1]]])
    field = shapes @ rng.standard_normal((shapes.shape[1], 3))
    field -= field.mean(axis=0)
    return field * (mean_mm / np.linalg.norm(field, axis=1).mean())


@pytest.mark.parametrize("times_the_noise", [8.0, 3.0, 0.6, 0.3])
def test_what_noise_hides_of_lengths_is_within_their_uncertainty(times_the_noise):
    rng = np.random.default_rng(8)
    inside = dict.fromkeys(NAMES, 0)
    for _ in range(TRIALS):
        true = draw_field(rng, times_the_noise * SIGMA_MM)
        length_um = 1e3 * np.linalg.norm(true, axis=1)
        known = (length_um.mean(), np.quantile(length_um, 0.95), length_um.max())
        seen = true + draw_noise(rng, 1)[:, :, 0]
        noise, nothing = draw_noise(rng, DRAWS), np.zeros_like(seen)
        stated = compute_measured_statistics(seen, noise, 60.0, nothing)
        for name, value in zip(NAMES, known, strict=True):
            off = abs(stated[name].value_um - value)
            inside[name] += off <= 2.0 * stated[name].uncertainty_um
    # 95 % are stated; of 60 fewer than 52 would come with a chance of 0.4 %.
    assert all(count >= 52 for count in inside.values()), inside
