"""What a result says of sensors, of the air on the beam, and of known lengths."""

from dataclasses import replace

import numpy as np
import pytest

from recorded import with_samples
from results_fixtures import TRAVEL_MM
from truepath.answers.verification.conformity import Conformity, decide_conformity
from truepath.estimation.solve.known_scale import KnownScale, settle_scale
from truepath.files.bundle.run import KnownLength, Run, RunEvent, summarize_run
from truepath.files.environment import (
    Refraction,
    correct_refraction,
    range_scale_uncertainty_ppm,
    refraction_from_json,
    refraction_to_json,
    state_length_ppm,
)
from truepath.kinematics.identifiable import build_identifiable_model
from truepath.kinematics.model import EstimatedModel, compute_scale_parameters
from truepath.numerics.air_index import compute_air_index, compute_site_pressure_hpa
from truepath.results.analysis import analyse
from truepath.results.error_tables import build_error_tables
from truepath.results.result_assessment import assess_air, assess_scale
from truepath.results.result_json import (
    describe_refraction,
    describe_scale,
    environment_json,
    result_json,
)
from truepath.results.result_summary import state_findings
from truepath_drivers.interfaces import records, tracker_records

LIGHT = tracker_records.Light(633.0, is_group=False)
BY_NOBODY = Refraction("nobody", why="no pressure")
LONG_MM = 2300.0
WRONG = 60e-6  # as by a pressure in another unit


@pytest.fixture
def run(mill, square):
    time_s = 100.0 + np.arange(0.0, 600.0, 0.5)
    n = len(time_s)
    columns = np.arange(n), time_s, np.ones((n, 3)), np.zeros(n, np.int64)
    at_s = np.arange(100.0, 701.0, 1.0)
    rises = 20.0 + 0.01 * (at_s - 100.0)
    dies = np.where(at_s < 300.0, 21.0, np.nan)
    celsius = np.stack([rises, dies, np.full(len(at_s), np.nan)], axis=1)
    temperature = records.TemperatureSamples(("X", "Y", "Z"), at_s, celsius)
    air = records.AirSamples(
        at_s, np.full(len(at_s), 1002.0), np.full(len(at_s), np.nan)
    )
    silent = RunEvent(0, "sensor-silent", "Y_degC: no valid reply")
    streams = records.TrackerSamples(*columns), temperature, air
    return Run("warm", mill, square, *streams, events=(silent,))


def test_mean_range_and_change_of_every_sensor_are_stated_and_which_are_used(run):
    stated = environment_json(summarize_run(run))
    sensors = {one["name"]: one for one in stated["sensors"]}
    assert set(sensors) == {"X_degC", "Y_degC", "Z_degC", "pressure_hPa"}
    warm, dies = sensors["X_degC"], sensors["Y_degC"]
    assert warm["mean"] == pytest.approx(23.0)
    assert (warm["low"], warm["high"]) == pytest.approx((20.0, 26.0))
    assert warm["change"] == pytest.approx(6.0)
    assert (warm["used"], dies["used"]) == (True, False)
    assert dies["longest_without_s"] == pytest.approx(400.0, abs=2.0)
    assert sensors["Z_degC"]["mean"] is None
    assert stated["told"] == ["Y_degC: no valid reply"]
    at_s = np.arange(100.0, 156.0, 4.0)
    early_dies = np.where(at_s < 106.0, 20.0, np.nan)[:, None]
    few = run.tracker.select(run.tracker.device_time_s < 155.0)
    temperature = records.TemperatureSamples(("X",), at_s, early_dies)
    early = replace(run, tracker=few, temperature=temperature)
    assert not summarize_run(early).sensors[0].is_used


def test_air_that_was_written_down_once_holds_all_the_time(run):
    at_s = np.array([50.0])
    once = records.TemperatureSamples(("air",), at_s, np.array([[21.0]]))
    air = records.AirSamples(at_s, np.array([1002.0]), np.array([45.0]))
    nobody = Refraction("nobody", LIGHT)
    told, samples = correct_refraction(nobody, run.tracker, once, air)
    assert told.by == "truepath"
    assert (samples.position_mm < run.tracker.position_mm).all()


@pytest.mark.parametrize("by", ["instrument", "truepath"])
def test_the_scale_is_uncertain_by_what_the_air_is_mistaken(run, by):
    refraction = Refraction(by, LIGHT, 1.00027, (20, 1013, 50))
    corrected = replace(run, refraction=refraction)
    scale = environment_json(summarize_run(corrected))["range_scale"]
    assert scale["per_K_ppm"] == pytest.approx(0.95, abs=0.02)
    assert scale["per_hPa_ppm"] == pytest.approx(0.27, abs=0.005)
    assert scale["uncertainty_ppm"] == pytest.approx(np.hypot(0.95 / 2, 0.27), abs=0.05)
    assert scale["in_tables"]
    assert "positioning errors of all axes" in describe_scale(corrected.refraction)


def test_who_has_corrected_is_said_in_words_and_what_stays_uncorrected_is_doubtful():
    assert "instrument" in describe_refraction(Refraction("instrument"))
    done = Refraction("truepath", LIGHT, 1.00027137, (20.0, 1013.0, 50.0))
    assert "271.37" in describe_refraction(done)
    assert "NOT" in describe_refraction(Refraction("nobody", LIGHT, why="no pressure"))
    assert "not known" in describe_refraction(Refraction())
    air_ppm = range_scale_uncertainty_ppm(Refraction())[0]
    assert air_ppm > 0.4
    # The tracker shares the uncertainty of all lengths with the air.
    assert state_length_ppm(Refraction(), 0.0) == pytest.approx(air_ppm)
    both = state_length_ppm(Refraction("instrument"), 0.5)
    assert both == pytest.approx(np.hypot(air_ppm, 0.5))
    assert state_length_ppm(Refraction("nobody"), 0.5) > 250.0
    known = [Refraction(), Refraction("instrument")]
    assert assess_air(known, ["a", "b"]).reasons == ()
    (reason,) = assess_air([BY_NOBODY], ["a"]).reasons
    assert (reason.state, reason.run) == ("doubtful", "")
    assert "no pressure" in str(reason)


@pytest.mark.parametrize(
    ("assumed", "ppm"),
    [
        (("humidity_percent",), 0.6),
        (("pressure_hPa",), 2.7),
        (("air_degC",), 4.6),
        (("air_degC", "pressure_hPa", "humidity_percent"), 5.3),
        (("air_degC", "pressure_hPa", "humidity_percent", "altitude_m"), 10.3),
    ],
)
def test_air_taken_as_usual_is_as_uncertain_as_halls_and_sites_are(assumed, ppm):
    air = (20.0, 954.6, 50.0)
    usual = Refraction("truepath", LIGHT, 1.00027, air, "no sensor", assumed)
    assert range_scale_uncertainty_ppm(usual)[0] == pytest.approx(ppm, abs=0.15)
    assert refraction_from_json(refraction_to_json(usual)) == usual


def test_recordings_in_any_hall_are_right_within_what_is_said_of_their_air(run):
    rng, off_ppm = np.random.default_rng(5), []
    for _ in range(200):
        altitude_m = rng.uniform(0.0, 1000.0)
        hpa = compute_site_pressure_hpa(altitude_m) + rng.normal(0.0, 10.0)
        air = rng.normal(20.0, 5.0), hpa, rng.uniform(10.0, 90.0)
        state = (np.array([one]) for one in air)
        (index,) = compute_air_index(633.0, *state, is_group=False)
        shown = replace(run.tracker, position_mm=index * run.tracker.position_mm)
        nobody = Refraction("nobody", LIGHT)
        told, samples = correct_refraction(nobody, shown, None, None)
        off_ppm.append(1e6 * (samples.position_mm[0, 0] - 1.0))
    stated_ppm = range_scale_uncertainty_ppm(told)[0]
    assert np.mean(np.abs(off_ppm) < 2.0 * stated_ppm) > 0.93
    assert np.std(off_ppm) == pytest.approx(stated_ppm, rel=0.15)
    (reason,) = assess_air([told], ["run"]).reasons
    assert (reason.kind, reason.state) == ("air-assumed", "usable")
    assert reason.values["within_um"] == pytest.approx(2.0 * stated_ppm)


def test_uncorrected_ranges_decide_no_tolerance_nor_the_scale(estimate, provenance):
    (run,) = provenance.runs
    runs = (replace(run, refraction=by) for by in (Refraction("instrument"), BY_NOBODY))
    told = [state_findings(estimate, replace(provenance, runs=(one,))) for one in runs]
    corrected, open_air = (one.volumetric.before.mean for one in told)
    for tolerance_um in (0.8 * corrected.value_um, 1.25 * corrected.value_um):
        for one in (corrected, open_air):
            u_um = 2.0 * one.uncertainty_um
            decided = decide_conformity(one.value_um, u_um, tolerance_um)
            assert (decided is Conformity.UNDECIDED) == (one is open_air)
    known, open_air = (one.tables.table("EXX") for one in told)
    more_ppm = np.sqrt(np.diff([one.length_scale_ppm**2 for one in told])[0])
    away_mm = known.position_mm - known.position_mm[np.argmin(known.uncertainty)]
    more_um = np.sqrt(open_air.uncertainty**2 - known.uncertainty**2)
    assert more_um == pytest.approx(1e-3 * more_ppm * np.abs(away_mm), abs=1e-6)
    straight = [one.tables.table("EYX").uncertainty for one in told]
    assert straight[1] == pytest.approx(straight[0], abs=1e-9)


def test_axes_that_are_all_long_by_the_same_ask_for_air_and_temperature(estimate):
    stretch = compute_scale_parameters(estimate.model)
    (reason,) = assess_scale(replace(estimate, theta=68e-6 * stretch)).reasons
    assert (reason.kind, reason.state) == ("all-axes-scaled", "doubtful")
    assert reason.values["distance_um"] == pytest.approx(68.0)
    # What air and a machine at 22 °C explain, and axes that are each for themselves.
    assert not assess_scale(replace(estimate, theta=40e-6 * stretch)).reasons
    stretch[estimate.model.slices["EXX"]] *= 0.5
    assert not assess_scale(replace(estimate, theta=68e-6 * stretch)).reasons


def bar(off, sigma_mm=0.0005, direction=(0.0, 1.0, 0.0)):
    """Return a scale bar as a tracker measures it whose ranges are too long."""
    middle_mm = np.array([2500.0, 300.0, -200.0])
    half_mm = 0.5 * (1.0 + off) * LONG_MM * np.array(direction)
    ends = tuple(tuple(middle_mm + sign * half_mm) for sign in (-1, 1))
    return KnownLength(ends, (1.0 + off) * LONG_MM, LONG_MM, sigma_mm)


@pytest.fixture(scope="module")
def recorded(record):
    return record(1, rows=24, travel_mm=TRAVEL_MM)[0]


@pytest.fixture(scope="module")
def as_it_is(recorded):
    return analyse(recorded)


def test_a_known_length_takes_the_scale_of_air_out_of_all_lengths(recorded, as_it_is):
    longer_mm = (1.0 + WRONG) * recorded.tracker.position_mm
    wrong = with_samples(recorded, position_mm=longer_mm)
    told = analyse(replace(wrong, known_lengths=(bar(WRONG),)))
    states = {reason.kind: reason.state for reason in told.verdict.reasons}
    assert states["scale-known"] == "usable"
    for symbol in ("EXX", "EYY", "EZZ"):
        settled, true = told.tables.table(symbol), as_it_is.tables.table(symbol)
        off_um = np.abs(settled.value - true.value)
        assert (off_um <= 2.0 * np.hypot(settled.uncertainty, true.uncertainty)).all()
    stated = result_json(told)["provenance"]["known_lengths"]
    assert stated["count"] == 1
    assert stated["off_ppm"] == pytest.approx(60.0, abs=3.0)


def test_uncorrected_ranges_are_known_as_well_as_a_known_length(recorded, as_it_is):
    open_air = replace(recorded, refraction=BY_NOBODY)
    told = analyse(replace(open_air, known_lengths=(bar(0.0),)))
    assert analyse(open_air).length_scale_ppm > 250.0
    assert told.length_scale_ppm < 6.0
    far_um = [one.tables.table("EXX").uncertainty.max() for one in (told, as_it_is)]
    assert far_um[0] < far_um[1] + 1e-3 * 6.0 * TRAVEL_MM
    left_mm = [one.contributions.sigma_mm for one in (told, as_it_is)]
    assert left_mm[0] < 2.0 * left_mm[1]
    budget = told.budget.variance_mm2.sum()
    assert np.sqrt(budget) == pytest.approx(left_mm[0], rel=1e-3)


@pytest.mark.parametrize(
    ("off", "kinds"),
    [
        (None, {"all-axes-scaled": "doubtful"}),
        (68e-6, {"scale-known": "usable"}),
        (0.0, {"scale-known": "usable", "machine-scaled": "usable"}),
        (-68e-6, {"scale-known": "usable", "machine-scaled": "doubtful"}),
    ],
)
def test_all_axes_are_long_by_the_air_or_the_machine(estimate, provenance, off, kinds):
    long = replace(estimate, theta=68e-6 * compute_scale_parameters(estimate.model))
    lengths = () if off is None else (bar(off),)
    run = replace(provenance.runs[0], known_lengths=lengths)
    found = state_findings(long, replace(provenance, runs=(run,)))
    said = assess_scale(found.estimate, found.known_scale).reasons
    assert {one.kind: one.state for one in said} == kinds


@pytest.mark.parametrize(
    ("off", "state"), [(2e-6, "usable"), (68e-6, "doubtful"), (-68e-6, "doubtful")]
)
def test_a_length_that_air_and_tracker_deny_is_doubted(mill, provenance, off, state):
    flat = replace(mill, tool_side=("Y",), axes=mill.axes[:2])
    model, _ = build_identifiable_model(flat, np.array([[0.0, 0.0, -150.0]]))
    found = EstimatedModel(model, np.zeros(model.size), 1e-8 * np.eye(model.size))
    known = KnownScale(1, off, 1e-6, is_expected=abs(off) < 1e-5)
    (reason,) = assess_scale(found, known).reasons
    assert (reason.kind, reason.state) == ("scale-known", state)


@pytest.mark.parametrize("sigma_mm", [0.001, 0.01])
def test_what_is_left_of_scale_is_as_uncertain_as_stated(construct, sigma_mm):
    estimate = construct()
    stretch, scale = compute_scale_parameters(estimate.model), 10e-6
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(estimate.covariance)
    off, wrong = [], []
    for _ in range(300):
        s = scale * rng.standard_normal()
        known = bar(s + sigma_mm / LONG_MM * rng.standard_normal(), sigma_mm)
        drawn = estimate.theta + root @ rng.standard_normal(len(root)) + s * stretch
        one = replace(estimate, theta=drawn)
        settled, left, told = settle_scale(one, scale, [[known]])
        wrong.append((settled.theta - estimate.theta) @ stretch)
        off.append(not told.is_expected)
    stated = float(stretch @ settled.covariance @ stretch) ** 0.5
    assert np.std(wrong) < 1.1 * stated
    assert left < scale
    assert np.mean(off) < 0.01


def test_a_known_length_says_nothing_of_another_run(estimate, provenance):
    (run,) = (replace(one, refraction=BY_NOBODY) for one in provenance.runs)
    told = replace(run, known_lengths=(bar(0.0),))

    def find_ppm(*runs):
        found = state_findings(estimate, replace(provenance, runs=runs))
        return found.length_scale_ppm

    assert find_ppm(told, told) < 10.0
    assert find_ppm(told, run) == pytest.approx(find_ppm(run, run), rel=1e-3)
    far_off = replace(told, known_lengths=(bar(200e-6),))
    assert find_ppm(far_off, *provenance.runs) > 200.0


def test_many_bars_of_which_some_are_short_are_no_better_than_the_best(construct):
    estimate = construct()
    rows = [bar(0.0, 0.01, d) for d in np.eye(3).tolist() * 5]
    _, left, told = settle_scale(estimate, 270e-6, [rows])
    assert told.lengths == 15
    assert left > 0.9 * 0.01 / LONG_MM
    long = bar(0.0, 0.001)
    ends = tuple(tuple(0.8 * np.array(end)) for end in long.ends_mm)
    short_mm = 0.2 * LONG_MM
    short = replace(long, ends_mm=ends, measured_mm=short_mm, length_mm=short_mm)
    _, _, alone = settle_scale(estimate, 270e-6, [[long] * 5])
    _, _, both = settle_scale(estimate, 270e-6, [[long] * 5 + [short] * 5])
    assert both.sigma > 0.99 * 0.001 / LONG_MM
    assert both.sigma == pytest.approx(alone.sigma, rel=0.1)


def test_without_a_known_length_the_scale_is_what_air_and_tracker_leave(construct):
    estimate = construct()
    settled, left, told = settle_scale(estimate, 5e-6, [[]])
    assert (left, told) == (5e-6, None)
    wider = build_error_tables(estimate.widen_by_scale(5e-6), estimate.measured)
    own = build_error_tables(settled, estimate.measured)
    for one, other in zip(own.tables, wider.tables, strict=True):
        np.testing.assert_allclose(one.uncertainty, other.uncertainty)
