"""A result against other measurements; figures of standards from known deviations."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import recorded
from following import shift
from recorded import record_run, with_samples
from results_fixtures import TRAVEL_MM, load_small
from truepath.alignment.align import align
from truepath.answers.verification.conformity import compute_joint_factor, decide_points
from truepath.answers.verification.matched_points import predict_displacement
from truepath.answers.verification.reduced_points import (
    correlate_means,
    merge_points,
    reduce_to_points,
)
from truepath.answers.verification.static_tests import (
    SampledVectors,
    evaluate_static_lines_and_circles,
)
from truepath.answers.verification.verification import (
    NAMES,
    compute_measured_statistics,
    verify,
)
from truepath.answers.verification.verification_json import (
    describe_findings,
    verification_json,
)
from truepath.errors import BadInput
from truepath.estimation.noise.noise_fit import guess_noise
from truepath.files.earlier.result_file import HalfDifference
from truepath.files.environment import Refraction
from truepath.kinematics.conditions import make_standstill
from truepath.motion.configurations import select_rows
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.paths import standstill_points, turning_points
from truepath_simulators.worlds.synthetic import Setting

MACHINE = 1
POINTS = 30
TOLERANCE_UM = 5.5


@pytest.fixture(scope="module")
def remeasured(record):
    def measured(seed, mode="standstill", truth=None, hidden=()):
        setting = Setting(machine_seed=MACHINE, truth=truth, hidden=hidden)
        how = {"rows": POINTS if mode == "standstill" else 14, "feed": 6000.0}
        return record(seed, mode, **how, travel_mm=TRAVEL_MM, setting=setting)

    return measured


@dataclass(frozen=True)
class Compensated(TruthMachine):
    """A machine whose controller adds to commanded positions."""

    correction: object = None

    def point_mm(self, q, reflector, frame="workpiece", carry=None):
        moved = q + self.correction(q)
        return TruthMachine.point_mm(self, moved, reflector, frame, carry)


def truth_with(sign, result):
    truth = random_machine(parse_machine(load_small()), MACHINE)

    def add(q):
        return sign * predict_displacement(result, make_standstill(result.machine, q))

    return Compensated(truth.machine, truth.joints, truth.squareness_rad, add)


def leave(sign, result):
    add = truth_with(sign, result).correction
    return lambda at: add(at.position_mm)


@pytest.mark.parametrize("mode", ["standstill", "otf"])
def test_the_same_machine_measured_from_elsewhere_agrees(calibrated, remeasured, mode):
    run, _ = remeasured(101, mode)
    found = verify(calibrated, run, tolerance_um=TOLERANCE_UM)
    assert found.consistency.is_consistent
    assert found.consistency.fits_together
    assert found.consistency.share_within > 0.85
    assert found.conformity["deviation"].conformity == "within"
    assert found.conformity["measured"].conformity == "outside"
    assert found.scale.value == pytest.approx(1.0, abs=0.03)
    largest = max(one.value_um for one in found.statistics["deviation"].values())
    assert largest < 3.0
    content = json.loads(json.dumps(verification_json(found), allow_nan=False))
    assert content["schema"] == "verification/1"
    assert content["map_scale"]["cause"] is None
    assert content["conformity"]["deviation"]["conformity"] == "within"
    difference = content["difference_um"]["mean"]
    assert difference["within"]
    mean = {key: one["mean"] for key, one in content["volumetric_error_um"].items()}
    left = mean["measured"] - mean["predicted"]
    assert difference["value"] == pytest.approx(left)
    if mode == "standstill":
        places = content["places"]
        assert len(places["measured_um"]) == len(places["row"]) == len(found.points)
        length_um = np.linalg.norm(places["measured_um"], axis=1)
        outside = np.array(places["conformity"]) == "outside"
        assert outside.any()
        assert length_um[outside].min() > TOLERANCE_UM
        assert set(places["conformity"]) >= {"outside", "within"}
        return
    assert found.points.unseen_directions == ()
    across = np.tile([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], (len(found.points), 1))
    along_x = replace(found.points, component=across)
    assert along_x.unseen_directions == ("X",)
    said = list(describe_findings(replace(found, points=along_x)))
    assert any("Nothing was measured along X" in one for one in said)


def test_the_measured_volumetric_error_is_true(calibrated, remeasured, rigid_free):
    run, truth = remeasured(102)
    found = verify(calibrated, run)
    position, point = found.points.at.position_mm, found.points.at.point_mm
    left_mm = rigid_free(point, truth.deviation_mm(position))
    length_um = 1e3 * np.linalg.norm(left_mm, axis=1)
    true = length_um.mean(), np.quantile(length_um, 0.95), length_um.max()
    for name, value in zip(("mean", "p95", "largest"), true, strict=True):
        stated = found.statistics["measured"][name]
        assert abs(stated.value_um - value) < 3.0 * stated.uncertainty_um


def test_the_scale_of_air_and_tracker_is_in_u_of_a_place(calibrated, remeasured):
    run, _ = remeasured(101)
    tracker = replace(run.machine.tracker, range_ppm=40.0)  # as its data sheet says
    machine = replace(calibrated.machine, tracker=tracker)
    result = replace(calibrated, model=replace(calibrated.model, machine=machine))
    stated = replace(run.machine, tracker=tracker)
    found = verify(result, replace(run, machine=stated))
    places = found.points
    point = places.at.point_mm
    far = np.linalg.norm(point - point.mean(axis=0), axis=1).argmax()
    noise = places.collect_covariance(places.noise_mm2)[far]
    more = found.deviation.covariance_mm2[far] - noise
    # 40 ppm of the way from the middle, less what goes with the pose.
    away_um = 40e-3 * np.linalg.norm(point[far] - point.mean(axis=0))
    assert 1e3 * np.sqrt(np.trace(more)) == pytest.approx(away_um, rel=0.05)
    (content,) = verification_json(found)["runs"]
    assert content["length_scale_ppm"] == pytest.approx(40.0, abs=0.1)


def test_lengths_that_differ_as_air_allows_are_no_fault(calibrated, remeasured):
    run, _ = remeasured(101)
    longer = with_samples(run, position_mm=1.0001 * run.tracker.position_mm)
    known = replace(longer, refraction=Refraction("instrument"))
    warmer = verify(calibrated, known, tolerance_um=TOLERANCE_UM)
    assert warmer.conformity["deviation"].conformity == "outside"
    assert not warmer.consistency.is_consistent
    assert warmer.consistency.fits_together  # some machine does so
    warm = with_samples(run, position_mm=(1.0 + 3e-5) * run.tracker.position_mm)
    little = verify(calibrated, warm).consistency
    assert (little.is_consistent, little.fits_together) == (False, True)
    open_air = replace(known, refraction=Refraction("nobody", why="no pressure"))
    decided = verify(calibrated, open_air, tolerance_um=TOLERANCE_UM).conformity
    assert {one.conformity for one in decided.values()} == {"undecided"}
    assert verify(calibrated.widen_by_scale(1e-4), known).consistency.is_consistent


def test_the_air_of_the_verifying_measurement_is_judged(calibrated, remeasured):
    open_air = Refraction("nobody", why="no pressure")
    run = replace(remeasured(101)[0], refraction=open_air)
    content = verification_json(verify(calibrated, run))
    (said,) = content["run_verdict"]["reasons"]
    assert content["run_verdict"]["state"] == "doubtful"
    assert said in content["statements"]
    assert "NOT corrected: no pressure" in content["statements"][-1]
    (one,) = content["runs"]
    assert one["environment"]["refraction"]["by"] == "nobody"


@pytest.mark.long
def test_stated_uncertainties_hold_the_deviations_at_their_rate(calibrated, remeasured):
    found = [verify(calibrated, remeasured(seed)[0]) for seed in range(110, 118)]
    within = np.mean([one.consistency.share_within for one in found])
    assert 0.88 <= within <= 0.99  # of 95 %; one calibration stands behind all
    assert sum(one.consistency.is_consistent for one in found) >= 7


def test_a_machine_that_has_changed_by_ten_micrometres_is_found(calibrated, remeasured):
    truth = random_machine(parse_machine(load_small()), MACHINE)
    y = truth.joints["Y"]
    leaned = np.subtract(y.direction, [80e-6, 0.0, 0.0])  # 16 µm over its travel
    joints = {**truth.joints, "Y": replace(y, direction=tuple(leaned.tolist()))}
    run, _ = remeasured(103, truth=replace(truth, joints=joints))
    found = verify(calibrated, run, tolerance_um=3.0)
    assert found.conformity["deviation"].conformity == "outside"
    assert not found.consistency.is_consistent
    assert found.consistency.fits_together  # some machine does so: not the tracker
    assert any("a machine that has changed" in s for s in describe_findings(found))
    length_um = float(found.deviation.length_um.max())
    found = verify(calibrated, run, tolerance_um=length_um - 0.3)
    assert found.conformity["deviation"].conformity == "undecided"


def cut(run, row, first_row):
    """Cut a Run in two; before the second the tracker settles by some micrometres."""
    seen = align(run)
    time_s = run.tracker.device_time_s
    parts = []
    for begin, end in ((0, row), (first_row, len(run.commanded))):
        own = seen.at.time_s[(seen.row >= begin) & (seen.row < end)]
        inside = (time_s > own.min() - 0.7) & (time_s < own.max() + 0.7)
        tracker = run.tracker.select(np.flatnonzero(inside))
        commanded = select_rows(run.commanded, slice(begin, None))
        part = replace(run, commanded=commanded, tracker=tracker)
        parts.append(shift(part, 0.01) if begin else part)
    return parts


@pytest.mark.parametrize(("row", "first_row"), [(14, 14), (26, 23)])
def test_two_runs_say_what_the_whole_says(calibrated, remeasured, row, first_row):
    run, _ = remeasured(105)
    whole = verify(calibrated, run)
    parts = cut(run, row, first_row)
    found = verify(calibrated, *parts, first_row=(0, first_row))
    assert found.points.row.tolist() == whole.points.row.tolist()
    assert found.consistency.is_consistent
    assert found.deviation.length_um.max() < whole.deviation.length_um.max() + 1.0
    one, other = (each.statistics["measured"]["mean"] for each in (found, whole))
    assert one.value_um == pytest.approx(other.value_um, abs=3.0)
    content = verification_json(found)
    assert [one["samples_used"] > 0 for one in content["runs"]] == [True, True]
    assert all(one["left_out"] == [] for one in content["runs"])
    assert "of each Run" in content["gauge"]


def test_parts_that_are_separate_runs_have_a_noise_each(calibrated, remeasured):
    run, truth = remeasured(105)
    first, second = cut(run, 22, 22)
    row = truth.recording.row[np.isin(run.tracker.sequence, second.tracker.sequence)]
    each_mm = np.random.default_rng(8).normal(0.0, 0.02, (row.max() + 1, 3))
    differing = shift(second, each_mm[np.maximum(row, 0)])
    found = verify(calibrated, first, differing, first_row=(0, 22))
    one, other = (np.mean(each.noise.place) for each in found.runs)
    assert one < 0.5
    assert other > 2.0


def test_a_compensated_machine_is_left_with_what_is_stated(calibrated, remeasured):
    run, _ = remeasured(105, truth=truth_with(-1.0, calibrated))
    left = leave(-1.0, calibrated)
    found = verify(calibrated, run, tolerance_um=8.0, correction=left)
    assert found.conformity["measured"].conformity == "within"
    assert found.consistency.is_consistent
    assert abs(found.scale.value) < 0.03
    assert found.statistics["measured"]["mean"].value_um < 1.5
    run, _ = remeasured(105, truth=truth_with(-0.15, calibrated))
    found = verify(calibrated, run, correction=leave(-0.15, calibrated))
    assert found.consistency.is_consistent
    assert found.scale.value == pytest.approx(0.85, abs=0.03)
    assert found.scale.expected == pytest.approx(0.85, abs=0.001)
    assert found.scale.cause is None


@pytest.mark.parametrize(
    ("seed", "sign", "scale", "cause", "words"),
    [
        (106, 1.0, 2.0, "wrong-sign", "wrong sign"),
        (101, None, 1.0, "not-active", "is not active"),
    ],
)
def test_a_compensation_of_the_wrong_sign_or_that_is_not_active_is_named(
    calibrated, remeasured, seed, sign, scale, cause, words
):
    run, _ = remeasured(seed, truth=sign and truth_with(sign, calibrated))
    found = verify(calibrated, run, correction=leave(-1.0, calibrated))
    assert found.scale.value == pytest.approx(scale, abs=0.03)
    assert not found.consistency.is_consistent
    assert any(words in sentence for sentence in describe_findings(found))
    assert verification_json(found)["map_scale"]["cause"] == cause
    hopeless = replace(found, consistency=replace(found.consistency, repeated=0.0))
    assert not any("look at tracker" in said for said in describe_findings(hopeless))


def test_lost_motion_that_a_result_states_is_predicted(calibrated, remeasured):
    run, _ = remeasured(107, hidden=(Backlash("X", 9.0),))
    x = calibrated.machine.axes[0]
    half = HalfDifference(np.array([x.low, x.high]), np.array([-4.5, -4.5]))
    aware = replace(calibrated, halves={"EXX": half})
    assert verify(aware, run).consistency.is_consistent
    found = verify(calibrated, run)
    assert not found.consistency.is_consistent
    assert found.consistency.fits_together  # play is a change of the machine


def test_a_result_is_not_verified_by_its_own_measurement(calibrated, record):
    own = record(MACHINE, rows=24, travel_mm=TRAVEL_MM)[0]
    with pytest.raises(BadInput, match="was made from this measurement"):
        verify(calibrated, own)
    for part in (slice(200, None), slice(4000, 9000)):
        cut = replace(own, name="cut", tracker=own.tracker.select(part))
        with pytest.raises(BadInput, match="cut: the result was made from samples of"):
            verify(calibrated, cut)


def test_means_of_correlated_noise_are_correlated_as_their_samples_are(rng):
    tau_s, step_s, samples = 0.7, 0.01, 60
    time_s = step_s * (np.arange(4 * samples) + 0.5)
    covariance = np.exp(-np.abs(time_s[:, None] - time_s) / tau_s)
    mean = np.kron(np.eye(4), np.full((1, samples), 1.0 / samples))
    expected = mean @ covariance @ mean.T
    span = np.full(4, step_s * samples)
    found = correlate_means(mean @ time_s, span, tau_s)
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_an_axis_that_was_not_driven_leaves_the_tolerance_undecided(calibrated, record):
    program = standstill_points(parse_machine(load_small()), 9, POINTS)
    program.position[:, 2] = program.position[:, 2].mean().round(1)
    how = {"travel_mm": TRAVEL_MM, "setting": Setting(machine_seed=MACHINE)}
    run, _ = record(109, "standstill", program=program, **how)
    found = verify(calibrated, run, tolerance_um=1e3)
    assert found.points.resting_axes == ("Z",)
    assert found.points.unseen_directions == ()
    assert found.conformity["measured"].conformity == "undecided"
    assert any(one.startswith("Not driven: Z.") for one in describe_findings(found))


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


@pytest.mark.parametrize("times_the_noise", [8.0, 3.0, 0.6, 0.3])
def test_what_noise_hides_of_lengths_is_within_their_uncertainty(times_the_noise):
    rng = np.random.default_rng(8)
    inside = dict.fromkeys(NAMES, 0)
    for _ in range(TRIALS):
        at = rng.uniform(-1.0, 1.0, (PLACES, 3))
        shapes = [at, at**2, np.sin(3.0 * at), at[:, [0]] * at[:, [1]]]
        true = np.column_stack(shapes) @ rng.standard_normal((10, 3))
        true -= true.mean(axis=0)
        mean_mm = np.linalg.norm(true, axis=1).mean()
        true *= times_the_noise * SIGMA_MM / mean_mm
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


def test_points_of_several_runs_keep_targets_on_the_table_and_their_seats():
    content = recorded.load_small("trunnion")
    program = turning_points(parse_machine(content), 3, 40, dwell_s=0.4)
    parts = []
    for seed in (3, 4):
        seen = align(record_run(content, program, seed, "standstill")[0])
        seated = replace(seen.at, seat_mm=np.full((len(seen), 3), 0.01 * seed))
        noise = guess_noise(seen, perpendicular_only=False)
        parts.append(reduce_to_points(replace(seen, at=seated), seen.pose, noise))
    merged = merge_points(parts)
    assert merged.at.on_workpiece.any()
    assert not merged.at.on_workpiece.all()
    expected = np.concatenate([part.at.point_mm for part in parts])
    np.testing.assert_array_equal(merged.at.point_mm, expected)
