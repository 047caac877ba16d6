"""Sensors during a measurement: in the Run, never in the way, never wrong unsaid."""

import math
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest

from truepath.errors import BadInput
from truepath.files.bundle.bundle import read_bundle, write_bundle
from truepath.files.bundle.run import summarize_run
from truepath.files.environment import choose_refraction
from truepath.measurement import messages, progress
from truepath.measurement.monitors import environment_reader as plausibility
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import RunHeader
from truepath.measurement.run_file.run_loader import open_run
from truepath.numerics.air_index import compute_air_index
from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, DeviceTimeout
from truepath_drivers.interfaces.records import Identity, TrackerSamples
from truepath_drivers.interfaces.thermometers import Channel, Reading, Thermometers
from truepath_drivers.interfaces.tracker import AirExchange
from truepath_drivers.interfaces.tracker_records import Air, Light, TrackerCapabilities

pytestmark = pytest.mark.usefixtures("clock")

NAMES = ("X_degC", "air_degC", "pressure_hPa", "humidity_percent")
USUAL = dict(zip(NAMES, (20.5, 21.0, 1002.0, 45.0), strict=True))
HENE = Light(633.0, is_group=False)


class FakeThermometers(Thermometers):
    channels = tuple(Channel(name) for name in NAMES)
    period_s = 0.02

    def __init__(self):
        self.shows, self.faults = dict(USUAL), {}
        self.dead = self.is_open = False
        self.hangs = threading.Event()
        self.hangs.set()
        self.broken = None

    def connect(self):
        if self.dead:
            raise DeviceTimeout("no valid reply in 0.2 s; check power")
        self.is_open = True
        return Identity("Us", "fake thermometers", "", "")

    def close(self):
        self.is_open = False

    def read(self):
        if not self.is_open:
            raise ConnectionLost("connect first")
        host_clock.wait(self.hangs, 20.0)
        if self.broken is not None:
            raise self.broken
        shown = self.shows | dict.fromkeys(self.faults, math.nan)
        now_s, faults = host_clock.now_s(), self.faults
        return tuple(Reading(n, now_s, v, faults.get(n, "")) for n, v in shown.items())


def judged(values, *, step_s=1.0, channel=None):
    judge = plausibility.SensorPlausibility(channel or Channel("X_degC"))
    found, told = [], []
    for number, value in enumerate(values):
        fault = value if isinstance(value, str) else ""
        shown = math.nan if fault else value
        reading = Reading("X_degC", 100.0 + step_s * number, shown, fault)
        value, notice = judge.assess(reading)
        found.append(value)
        told.append("" if notice is None else notice.code)
    return found, told


class TestJudge:
    @pytest.mark.fault_row(12)
    @pytest.mark.parametrize(
        ("wrong", "kind"),
        [
            (327.67, plausibility.IMPLAUSIBLE),
            (-205.0, plausibility.IMPLAUSIBLE),
            (293.15, plausibility.IMPLAUSIBLE),
            (math.inf, plausibility.NO_NUMBER),
            (math.nan, plausibility.NO_NUMBER),
        ],
    )
    def test_a_wrong_number_is_left_out_and_told_at_once(self, wrong, kind):
        found, told = judged([20.0, wrong, *[20.1] * 12])
        assert math.isnan(found[1])
        assert (found[0], found[-1]) == (20.0, 20.1)
        assert [told[1], *filter(None, told)] == [kind, kind, plausibility.BACK]

    def test_good_readings_a_lost_reply_and_a_coarse_sensor_are_no_fault(self):
        assert judged([20.0, 20.1]) == ([20.0, 20.1], ["", ""])
        assert judged([20.0, "no reply", 20.1])[1] == ["", "", ""]
        coarse = Channel("X_degC", stuck_s=0.0)
        assert not any(judged([20.0] * 5, step_s=3600.0, channel=coarse)[1])

    def test_a_silence_is_told_once_and_at_once_if_it_is_from_the_beginning(self):
        _, told = judged([20.0, *["no reply"] * 20, 20.1])
        assert (told.count(plausibility.SILENT), told[-1]) == (1, plausibility.BACK)
        assert told.index(plausibility.SILENT) == 6
        assert judged(["no reply"])[1] == [plausibility.SILENT]

    @pytest.mark.fault_row(12)
    @pytest.mark.parametrize("stuck_s", [0.5, 10.0])
    def test_a_stuck_sensor_is_left_out_until_it_changes(self, stuck_s):
        steady, step_s = Channel("X_degC", stuck_s=stuck_s), stuck_s / 10
        found, told = judged([20.0] * 15 + [20.1], channel=steady, step_s=step_s)
        assert np.isnan(found[10:15]).all()
        assert (found[-1], told[10]) == (20.1, plausibility.STUCK)
        assert told[-1] == plausibility.BACK


def swap_words(value):
    return float(np.array([value], ">f4").view(">u2")[::-1].copy().view(">f4")[0])


@pytest.mark.fault_row(43)
class TestGate:
    def test_of_words_in_the_wrong_order_nothing_is_believed(self):
        draws = np.random.default_rng(0).normal(20.0, 0.02, 1000)
        found, told = judged([swap_words(value) for value in draws])
        assert np.isfinite(found).sum() <= 1  # one that happens to look like one
        assert plausibility.IMPLAUSIBLE in told
        assert plausibility.BACK not in told

    @pytest.mark.parametrize("wrong", [0.0, 2.3e-41, swap_words(20.5), -1e-9])
    def test_nearly_nothing_is_no_temperature_however_long_it_lasts(self, wrong):
        for values in ([wrong] * 60, [20.0, 20.1, *[wrong] * 60]):
            found, told = judged(values)
            assert np.isnan(found[-60:]).all()
            assert told[-60] == plausibility.IMPLAUSIBLE

    def test_a_channel_stays_out_until_it_has_been_steady_for_a_while(self):
        bad = [20.0, 1e-30, 20.0, 327.0, 20.0, 45.0, 20.0]
        found, told = judged([*[20.0] * 30, *bad, *[20.0] * 30])
        assert np.isnan(found[31:40]).all()
        assert (found[-15:], told.count(plausibility.BACK)) == ([20.0] * 15, 1)

    def test_a_sensor_that_keeps_coming_and_going_stays_out(self):
        swapped = struct.unpack("<f", struct.pack(">f", 20.5))[0]  # bytes, not words
        for bad in (0.0, swapped, -20.0, 60.0):
            found, _ = judged([*[20.0] * 20, *[bad, 20.0, 20.0, 20.1] * 20])
            assert np.isnan(found[20:]).all()

    def test_a_new_level_is_believed_when_a_machine_can_have_come_there(self):
        found, _ = judged([*[20.0] * 30, *[26.0] * 600])
        assert 100 < int(np.flatnonzero(np.isfinite(found[30:]))[0]) < 400

    def test_the_air_is_colder_than_a_spindle_may_be(self):
        assert math.isnan(judged([60.0], channel=Channel("air_degC"))[0][0])
        assert judged([60.0], channel=Channel("spindle_degC"))[0] == [60.0]

    @pytest.mark.parametrize("step_s", [0.1, 1.0, 10.0])
    def test_what_warms_is_believed(self, step_s):
        warms = 15.0 + 25.0 * (1.0 - np.exp(-np.arange(0.0, 900.0, step_s) / 100.0))
        values = np.round(warms, 1) + np.random.default_rng(0).normal(0, 0.03)
        assert np.isfinite(judged(values.tolist(), step_s=step_s)[0]).all()


@pytest.fixture
def sensors():
    made = FakeThermometers()
    yield made
    made.hangs.set()


@pytest.fixture
def measure(begin, order, motion, journal):
    def run(sensors, order=order, **given):
        motion.speed = 100.0
        running = begin(order, sensors=sensors, **given)
        assert running.ended() == "finished", journal.events[-4:]
        return running.run

    return run


def test_a_run_holds_what_its_sensors_showed(measure, sensors, tmp_path):
    run = measure(sensors)
    summary = summarize_run(run)
    assert {one.name: one.mean for one in summary.sensors} == pytest.approx(USUAL)
    assert all(one.is_used for one in summary.sensors)
    assert run.temperature.time_s[0] >= run.tracker.device_time_s[0] - 60.0
    assert (np.diff(run.temperature.time_s) > 0).all()
    write_bundle(run, tmp_path / "bundle")
    header = (tmp_path / "bundle" / "environment.csv").read_text().splitlines()[0]
    assert header == "t_s,X_degC,air_degC,pressure_hPa,humidity_percent"
    again = read_bundle(tmp_path / "bundle")
    np.testing.assert_array_equal(again.temperature.celsius, run.temperature.celsius)
    np.testing.assert_array_equal(again.air.pressure_hpa, run.air.pressure_hpa)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"dead": True}, "no valid reply"),
        ({"broken": ZeroDivisionError("of a driver")}, "has failed"),
    ],
)
def test_sensors_that_are_dead_or_of_a_broken_driver_cost_themselves(
    measure, sensors, journal, motion, given, said
):
    vars(sensors).update(given)
    summary = summarize_run(measure(sensors))
    told = {f.text for f in journal.of(messages.FaultReported)}
    assert any(said in text for text in told)
    assert not sensors.dead or len([t for t in told if said in t]) == len(NAMES)
    assert summary.sensors_told
    assert "hold" not in motion.calls
    assert not any(one.is_used for one in summary.sensors)


@pytest.mark.fault_row(14)
def test_a_driver_that_hangs_delays_no_stream_no_beat_no_end(measure, sensors, motion):
    sensors.hangs.clear()
    begin_s = host_clock.now_s()
    run = measure(sensors)
    assert host_clock.now_s() - begin_s < 10.0
    assert motion.beats == motion.looks
    assert (np.diff(run.tracker.sequence) == 1).all()
    assert run.temperature is None


@pytest.mark.fault_row(43)
def test_what_is_left_out_is_counted_in_the_run_with_reason(measure, sensors, journal):
    sensors.shows["X_degC"] = swap_words(20.5)
    sensors.shows["pressure_hPa"] = 746.0  # of mercury, in mm
    run = measure(sensors)
    told = summarize_run(run).sensors_told
    for words in ("nearly 0", "a site whose altitude is not stated"):
        assert any("readings not used" in text and words in text for text in told)
    readings = {one.name: one.readings for one in summarize_run(run).sensors}
    assert readings["X_degC"] == 0 < readings["air_degC"]
    assert "X" not in summarize_run(run).temperature_degc
    assert "sensor-implausible" in {f.code for f in journal.of(messages.FaultReported)}


def test_a_bundle_names_the_sensor_that_it_leaves_out(measure, sensors, tmp_path):
    sensors.faults["X_degC"] = "no reply"
    write_bundle(measure(sensors), tmp_path / "bundle")
    again = read_bundle(tmp_path / "bundle")
    assert again.temperature.names == ("air",)
    assert any("X_degC: no reply" in t for t in summarize_run(again).sensors_told)


class WithStation(AirExchange):
    def push_air(self, air):
        raise NotImplementedError

    def read_air(self):
        return Air(22.0, 990.0, math.nan)


def test_the_station_of_a_tracker_is_read_where_nothing_else_is(measure, tracker):
    tracker.__class__ = type("Station", (WithStation, type(tracker)), {})
    run = measure(None)
    assert (run.temperature.names, run.temperature.celsius[0, 0]) == (("air",), 22.0)
    assert run.air.pressure_hpa[0] == 990.0


@pytest.fixture
def header(mill, square):
    return RunHeader("monday", mill, square, 500.0, {}, ("X", "Y", "Z"), NAMES)


def block(first):
    sequence = np.arange(first, first + 50)
    time_s = 1000.0 + 0.002 * sequence
    place = np.tile([3000.0, 400.0, 1200.0], (50, 1))
    return TrackerSamples(sequence, time_s, place, np.zeros(50, np.int64))


def record(file, header, *, blocks=4, close=True):
    recorder = Recorder(file, header, reserve_bytes=0)
    for number in range(blocks):
        recorder.put_tracker(block(50 * number))
        recorder.put_environment(host_clock.now_s(), USUAL)
        host_clock.sleep_s(0.05)
    recorder.put_environment(host_clock.now_s(), {"X_degC": 20.6})
    if close:
        recorder.close("finished")
    return recorder


def test_readings_come_on_the_trackers_clock_and_outlive_their_writer(tmp_path, header):
    file = tmp_path / "run.sqlite"
    recorder = record(file, header, close=False)
    deadline_s = host_clock.now_s() + 5.0
    while open_run(file).temperature is None and host_clock.now_s() < deadline_s:
        host_clock.sleep_s(0.02)
    assert open_run(file).temperature.names == ("X", "air")
    recorder.close("aborted")
    run = open_run(file)
    handed_over_s = 1000.0 + 0.002 * (np.arange(4) * 50 + 49)
    np.testing.assert_allclose(run.temperature.time_s[:4], handed_over_s, atol=0.05)
    assert run.temperature.celsius[-1, 0] == 20.6
    assert np.isnan(run.temperature.celsius[-1, 1])


def corrected(tmp_path, header, light, name="run"):
    file = tmp_path / f"{name}.sqlite"
    first = choose_refraction(TrackerCapabilities(), light)
    record(file, replace(header, refraction=first))
    return open_run(file)


def test_ranges_are_corrected_once_however_often_they_are_read(tmp_path, header):
    raw_mm = block(0).position_mm[0]
    run = corrected(tmp_path, header, HENE)
    air = (np.array([v]) for v in (21.0, 1002.0, 45.0))
    index = float(compute_air_index(633.0, *air, is_group=False)[0])
    assert run.refraction.by == "truepath"
    assert run.refraction.index == pytest.approx(index, abs=1e-12)
    np.testing.assert_allclose(run.tracker.position_mm[0], raw_mm / index, rtol=1e-12)
    for number in range(3):
        write_bundle(run, tmp_path / str(number))
        again = read_bundle(tmp_path / str(number))
        assert again.refraction == run.refraction
        np.testing.assert_array_equal(
            again.tracker.position_mm, run.tracker.position_mm
        )
        run = again
    run = corrected(tmp_path, header, None, "left")
    assert run.refraction.by == "unknown"
    np.testing.assert_array_equal(run.tracker.position_mm[0], raw_mm)


@pytest.mark.parametrize("altitude_m", [None, 400.0])
def test_usual_air_corrects_ranges_if_none_was_measured(tmp_path, header, altitude_m):
    machine = replace(header.machine, altitude_m=altitude_m)
    header = replace(header, machine=machine, channels=("X_degC", "air_degC"))
    run = corrected(tmp_path, header, HENE)
    missing = {"pressure_hPa", "humidity_percent"}
    assert set(run.refraction.assumed) - {"altitude_m"} == missing
    assert ("altitude_m" in run.refraction.assumed) == (altitude_m is None)
    assert "pressure" in run.refraction.why
    hpa = 954.6 if altitude_m is None else 966.1
    air = (np.array([v]) for v in (21.0, hpa, 50.0))
    index = float(compute_air_index(633.0, *air, is_group=False)[0])
    raw_mm = block(0).position_mm[0]
    np.testing.assert_allclose(run.tracker.position_mm[0], raw_mm / index, rtol=1e-7)
    write_bundle(run, tmp_path / "bundle")
    assert read_bundle(tmp_path / "bundle").refraction == run.refraction


def test_live_estimates_see_ranges_in_usual_air(measure, order, journal, calm, sensors):
    settings = replace(calm, light=HENE)
    run = measure(sensors, replace(order, live=True), settings=settings)
    shown_mm = journal.of(messages.BlockRecorded)[0].block.position_mm[0]
    np.testing.assert_allclose(shown_mm, run.tracker.position_mm[0], rtol=10e-6)
    assert shown_mm[2] < 3.0 * (1.0 - 200e-6)


def test_the_light_is_that_of_the_settings_unless_the_instrument_corrects():
    able = TrackerCapabilities(corrects_air=True)
    assert choose_refraction(able, None).by == "instrument"
    with pytest.raises(BadInput, match="twice"):
        choose_refraction(able, HENE)
    unable = TrackerCapabilities(corrects_air=False, light=Light(780.0))
    assert choose_refraction(unable, None).light == Light(780.0)
    assert choose_refraction(unable, HENE).light == HENE


def test_live_points_bring_the_newest_readings_and_blocks_in_the_same_scale():
    """What shows nothing is forgotten; ranges are as if corrected for the air."""
    heard = []
    view = progress.LiveView(heard.append, reports_blocks=True, range_scale=0.9997)
    view.show_readings({"X_degC": 21.0, "air_degC": 20.0})
    view.show_readings({"X_degC": math.nan})
    none, place = np.zeros(1, np.int64), np.array([[2000.0, 0.0, 10.0]])
    view.show(TrackerSamples(none, np.array([1.0]), place, none))
    points, recorded = heard
    assert points.environment == {"air_degC": 20.0}
    assert np.allclose(points.tracker_mm, 0.9997 * place)
    assert np.allclose(recorded.block.position_mm, points.tracker_mm)
