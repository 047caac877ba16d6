"""A result against measurements it was not made from, of a machine that is known."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from following import shift
from recorded import with_samples
from results_fixtures import TRAVEL_MM, load_small
from truepath.alignment.align import align
from truepath.answers.verification.places.predicted_motion import predict_displacement
from truepath.answers.verification.places.reduced_points import correlate_means
from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_json import verification_json
from truepath.answers.verification.verification_statements import state_findings
from truepath.errors import BadInput
from truepath.files.environment.refraction import Refraction
from truepath.kinematics.conditions import make_standstill
from truepath.motion.configurations import select_rows
from truepath_simulators.hidden.drives import Backlash
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion.paths import standstill_points
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


def leaned(urad):
    truth = random_machine(parse_machine(load_small()), MACHINE)
    y = truth.joints["Y"]
    turned = np.array(y.direction) + 1e-6 * urad * np.array([-1.0, 0.0, 0.0])
    joints = {**truth.joints, "Y": replace(y, direction=tuple(turned.tolist()))}
    return replace(truth, joints=joints)


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
        assert len(places["measured_um"]) == len(places["row"]) == len(found.places)
        length_um = np.linalg.norm(places["measured_um"], axis=1)
        outside = np.array(places["conformity"]) == "outside"
        assert outside.any()
        assert length_um[outside].min() > TOLERANCE_UM
        assert set(places["conformity"]) >= {"outside", "within"}
        return
    assert found.places.unseen_directions == ()
    across = np.tile([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], (len(found.places), 1))
    along_x = replace(found.places, component=across)
    assert along_x.unseen_directions == ("X",)
    said = list(state_findings(replace(found, places=along_x)))
    assert any("Nothing was measured along X" in one for one in said)


def test_the_measured_volumetric_error_is_true(calibrated, remeasured, rigid_free):
    run, truth = remeasured(102)
    found = verify(calibrated, run)
    position, point = found.places.at.position_mm, found.places.at.point_mm
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
    places = found.places
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
    run, _ = remeasured(103, truth=leaned(80.0))  # 16 µm over the travel of Y
    found = verify(calibrated, run, tolerance_um=3.0)
    assert found.conformity["deviation"].conformity == "outside"
    assert not found.consistency.is_consistent
    assert found.consistency.fits_together  # some machine does so: not the tracker
    assert any("a machine that has changed" in s for s in state_findings(found))
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
    assert found.places.row.tolist() == whole.places.row.tolist()
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
    assert any(words in sentence for sentence in state_findings(found))
    assert verification_json(found)["map_scale"]["cause"] == cause
    hopeless = replace(found, consistency=replace(found.consistency, repeated=0.0))
    assert not any("look at tracker" in said for said in state_findings(hopeless))


def test_lost_motion_that_a_result_states_is_predicted(calibrated, remeasured):
    run, _ = remeasured(107, hidden=(Backlash("X", 9.0),))
    x = calibrated.machine.axes[0]
    half = {"X": (np.array([x.low, x.high]), np.array([-4.5, -4.5]))}
    aware = replace(calibrated, half_difference_um=half)
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
    assert found.places.resting_axes == ("Z",)
    assert found.places.unseen_directions == ()
    assert found.conformity["measured"].conformity == "undecided"
    assert any(one.startswith("Not driven: Z.") for one in state_findings(found))
