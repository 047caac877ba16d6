"""What a result says of sensors and of the air on the beam."""

from dataclasses import replace

import numpy as np
import pytest

from truepath.answers.verification.places.conformity import (
    Conformity,
    decide_conformity,
)
from truepath.files.bundle.run import Run, RunEvent, summarize_run
from truepath.files.environment.refraction import (
    Refraction,
    correct_refraction,
    refraction_from_json,
    refraction_to_json,
    state_length_ppm,
    state_scale_ppm,
)
from truepath.kinematics.estimated_model import find_stretch
from truepath.numerics.air_index import find_air_index, find_site_pressure_hpa
from truepath.results.environment_json import (
    describe_refraction,
    describe_scale,
    environment_json,
)
from truepath.results.findings import state_findings
from truepath.results.verdict import judge_air, judge_scale
from truepath_drivers.interfaces.records import (
    AirSamples,
    Path,
    TemperatureSamples,
    TrackerSamples,
)
from truepath_drivers.interfaces.tracker_records import Light


@pytest.fixture
def run(mill, square):
    assert isinstance(square, Path)
    time_s = 100.0 + np.arange(0.0, 600.0, 0.5)
    tracker = TrackerSamples(
        np.arange(len(time_s)),
        time_s,
        np.ones((len(time_s), 3)),
        np.zeros(len(time_s), np.int64),
    )
    at_s = np.arange(100.0, 701.0, 1.0)
    rises = 20.0 + 0.01 * (at_s - 100.0)
    dies = np.where(at_s < 300.0, 21.0, np.nan)
    celsius = np.stack([rises, dies, np.full(len(at_s), np.nan)], axis=1)
    return Run(
        "warm",
        mill,
        square,
        tracker,
        TemperatureSamples(("X", "Y", "Z"), at_s, celsius),
        AirSamples(at_s, np.full(len(at_s), 1002.0), np.full(len(at_s), np.nan)),
        events=(RunEvent(0, "sensor-silent", "Y_degC: no valid reply"),),
    )


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


def test_a_sensor_that_dies_early_in_a_short_run_is_not_used(run):
    at_s = np.arange(100.0, 156.0, 4.0)
    dies = np.where(at_s < 106.0, 20.0, np.nan)[:, None]
    early = replace(
        run,
        tracker=run.tracker.select(run.tracker.device_time_s < 155.0),
        temperature=TemperatureSamples(("X",), at_s, dies),
    )
    assert not summarize_run(early).sensors[0].is_used


def test_air_that_was_written_down_once_holds_all_the_time(run):
    at_s = np.array([50.0])
    once = TemperatureSamples(("air",), at_s, np.array([[21.0]]))
    light = Light(633.0, is_group=False)
    told, samples = correct_refraction(
        Refraction("nobody", light),
        run.tracker,
        once,
        AirSamples(at_s, np.array([1002.0]), np.array([45.0])),
    )
    assert told.by == "truepath"
    assert (samples.position_mm < run.tracker.position_mm).all()


@pytest.mark.parametrize("by", ["instrument", "truepath"])
def test_the_scale_is_uncertain_by_what_the_air_is_mistaken(run, by):
    corrected = replace(
        run,
        refraction=Refraction(
            by, Light(633.0, is_group=False), 1.00027, (20, 1013, 50)
        ),
    )
    scale = environment_json(summarize_run(corrected))["range_scale"]
    assert scale["per_K_ppm"] == pytest.approx(0.95, abs=0.02)
    assert scale["per_hPa_ppm"] == pytest.approx(0.27, abs=0.005)
    assert scale["uncertainty_ppm"] == pytest.approx(np.hypot(0.95 / 2, 0.27), abs=0.05)
    assert scale["in_tables"]
    assert "positioning errors of all axes" in describe_scale(corrected.refraction)


def test_who_has_corrected_is_said_in_words():
    light = Light(633.0, is_group=False)
    assert "instrument" in describe_refraction(Refraction("instrument"))
    done = Refraction("truepath", light, 1.00027137, (20.0, 1013.0, 50.0))
    assert "271.37" in describe_refraction(done)
    assert "NOT" in describe_refraction(Refraction("nobody", light, why="no pressure"))
    assert "not known" in describe_refraction(Refraction())
    assert state_scale_ppm(Refraction())[0] > 0.4


def test_ranges_that_stay_uncorrected_make_a_result_doubtful():
    assert judge_air([Refraction(), Refraction("instrument")], ["a", "b"]).reasons == ()
    (reason,) = judge_air([Refraction("nobody", why="no pressure")], ["a"]).reasons
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
def test_what_of_the_air_is_taken_as_usual_is_as_uncertain_as_halls_and_sites_are(
    assumed, ppm
):
    light = Light(633.0, is_group=False)
    usual = Refraction(
        "truepath", light, 1.00027, (20.0, 954.6, 50.0), "no sensor", assumed
    )
    assert state_scale_ppm(usual)[0] == pytest.approx(ppm, abs=0.15)
    assert refraction_from_json(refraction_to_json(usual)) == usual


def test_recordings_in_any_hall_are_right_within_what_is_said_of_air_nobody_measured(
    run,
):
    rng = np.random.default_rng(5)
    light = Light(633.0, is_group=False)
    off_ppm = []
    for _ in range(200):
        altitude_m = rng.uniform(0.0, 1000.0)
        hpa = find_site_pressure_hpa(altitude_m) + rng.normal(0.0, 10.0)
        air = rng.normal(20.0, 5.0), hpa, rng.uniform(10.0, 90.0)
        (index,) = find_air_index(
            633.0, *(np.array([one]) for one in air), is_group=False
        )
        shown = replace(run.tracker, position_mm=index * run.tracker.position_mm)
        told, samples = correct_refraction(
            Refraction("nobody", light), shown, None, None
        )
        off_ppm.append(1e6 * (samples.position_mm[0, 0] - 1.0))
    stated_ppm = state_scale_ppm(told)[0]
    assert np.mean(np.abs(off_ppm) < 2.0 * stated_ppm) > 0.93
    assert np.std(off_ppm) == pytest.approx(stated_ppm, rel=0.15)
    (reason,) = judge_air([told], ["run"]).reasons
    assert (reason.kind, reason.state) == ("air-assumed", "usable")
    assert reason.values["within_um"] == pytest.approx(2.0 * stated_ppm)


def test_air_and_tracker_share_the_uncertainty_of_all_lengths():
    air_ppm = state_scale_ppm(Refraction())[0]
    assert state_length_ppm(Refraction(), 0.0) == pytest.approx(air_ppm)
    both = state_length_ppm(Refraction("instrument"), 0.5)
    assert both == pytest.approx(np.hypot(air_ppm, 0.5))
    assert state_length_ppm(Refraction("nobody"), 0.5) > 250.0


def test_ranges_that_nobody_corrects_decide_no_tolerance(estimate, provenance):
    corrected, open_air = (
        state_findings(
            estimate,
            replace(
                provenance,
                runs=tuple(replace(r, refraction=by) for r in provenance.runs),
            ),
        ).volumetric.before.mean
        for by in (Refraction("instrument"), Refraction("nobody", why="no pressure"))
    )
    for tolerance_um in (0.8 * corrected.value_um, 1.25 * corrected.value_um):
        decided = [
            decide_conformity(one.value_um, 2.0 * one.uncertainty_um, tolerance_um)
            for one in (corrected, open_air)
        ]
        assert decided[0] is not Conformity.UNDECIDED
        assert decided[1] is Conformity.UNDECIDED


def find_table(found, symbol):
    return next(table for table in found.tables.tables if table.symbol == symbol)


def test_the_far_end_of_a_positioning_table_knows_the_scale_of_the_air(
    estimate, provenance
):
    told = [
        state_findings(
            estimate,
            replace(
                provenance,
                runs=tuple(replace(r, refraction=by) for r in provenance.runs),
            ),
        )
        for by in (Refraction("instrument"), Refraction("nobody", why="no pressure"))
    ]
    known, open_air = (find_table(one, "EXX") for one in told)
    more_ppm = np.sqrt(np.diff([one.length_scale_ppm**2 for one in told])[0])
    away_mm = known.position_mm - known.position_mm[np.argmin(known.uncertainty)]
    more_um = np.sqrt(open_air.uncertainty**2 - known.uncertainty**2)
    assert more_um == pytest.approx(1e-3 * more_ppm * np.abs(away_mm), abs=1e-6)
    straight = [find_table(one, "EYX").uncertainty for one in told]
    assert straight[1] == pytest.approx(straight[0], abs=1e-9)


def test_axes_that_are_all_long_by_the_same_ask_for_air_and_temperature(estimate):
    stretch = find_stretch(estimate.model)
    (reason,) = judge_scale(replace(estimate, theta=68e-6 * stretch)).reasons
    assert (reason.kind, reason.state) == ("all-axes-scaled", "doubtful")
    assert reason.values["distance_um"] == pytest.approx(68.0)
    # What air and a machine at 22 °C explain, and axes that are each for themselves.
    assert not judge_scale(replace(estimate, theta=40e-6 * stretch)).reasons
    stretch[estimate.model.slices["EXX"]] *= 0.5
    assert not judge_scale(replace(estimate, theta=68e-6 * stretch)).reasons
