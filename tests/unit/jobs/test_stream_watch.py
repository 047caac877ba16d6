"""What the events of a cell tell of beam, stream and temperatures."""

import numpy as np
import pytest

from truepath.machines.conditions import stream_status
from truepath.measurement import messages


@pytest.fixture
def watch(hand_clock):
    watch = stream_status.StreamStatus()
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    return watch


def progress(lost=0, damaged=0):
    return messages.MeasurementProgress(
        1, 4, "lines", "measuring", 1.0, 3.0, lost_samples=lost, crc_errors=damaged
    )


def seen(**readings):
    return messages.LivePoints([[1.0, 2.0, 3.0]], [0.0], 1.0, readings)


def test_a_lost_beam_is_told_until_the_machine_moves_and_points_come(watch, hand_clock):
    watch.follow(seen())
    assert watch.read().has_beam is True
    watch.follow(messages.FaultReported("beam-lost", "the beam is lost", "lock it"))
    watch.follow(messages.StateChanged(messages.CellState.PAUSED))
    assert watch.read().has_beam is False
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    watch.follow(seen())
    assert watch.read().has_beam is True
    hand_clock.time_s += 60.0
    assert watch.read().has_beam is None


@pytest.mark.fault_row(31)
def test_losses_of_the_last_seconds_of_one_measurement_are_counted(watch, hand_clock):
    for second, lost in enumerate((0, 0, 7, 7, 7, 7, 7, 7, 7, 7)):
        hand_clock.time_s = 200.0 + second
        watch.follow(progress(lost, damaged=lost // 7))
        if second == 3:
            assert (watch.read().lost_samples, watch.read().crc_errors) == (7, 1)
    assert (watch.read().lost_samples, watch.read().crc_errors) == (0, 0)
    hand_clock.time_s += 60.0
    assert watch.read().lost_samples is None
    watch.follow(progress(50))
    hand_clock.time_s += 1.0
    watch.follow(progress(0))  # of another measurement
    assert watch.read().lost_samples == 0


def test_the_thermometer_that_changes_most_is_named(watch, hand_clock):
    for step in range(20):
        hand_clock.time_s = 300.0 + 5.0 * step
        watch.follow(seen(X_degC=20.0 + 0.1 * step, Y_degC=21.0, air_hPa=990.0 + step))
        known = watch.read()
        assert (known.drift_degC is None) == (step < 12)
    assert known.drift_degC == pytest.approx(1.9)
    assert known.drifting == "X_degC"
    hand_clock.time_s += stream_status.COURSE_S + 1.0
    assert watch.read().drift_degC is None


def heard(samples=100, usable=100, lost=0, rate_hz=500.0, **told):
    return messages.TrackerTried(samples, usable, lost, 1000.0, rate_hz, **told)


@pytest.mark.parametrize(
    ("tried", "aims", "level"),
    [
        (heard(), False, {"has_beam": True, "rate_share": 1.0}),
        (heard(rate_hz=None), False, {"has_beam": True, "rate_share": None}),
        (heard(rate_hz=250.0), False, {"has_beam": True, "rate_share": 0.5}),
        (heard(usable=80), False, {"has_beam": True, "usable_share": 0.8}),
        (heard(usable=0), False, {"has_beam": False}),
        (heard(usable=0), True, {"has_beam": None}),
        (heard(samples=0), False, {"failure": "the tracker sends no samples"}),
        (heard(lost=1), False, {"lost_samples": 0}),
        (heard(lost=9), False, {"lost_samples": 9}),
        (heard(samples=0, streams=False), False, {"has_beam": None, "failure": ""}),
    ],
)
def test_a_moment_at_rest_tells_beam_and_samples(hand_clock, tried, aims, level):
    watch = stream_status.StreamStatus()
    watch.record_trial(tried, 500.0, aims=aims)
    read = watch.read()
    assert {name: getattr(read, name) for name in level} == level


def test_what_was_heard_is_believed_for_a_while_and_until_something_moves(hand_clock):
    watch = stream_status.StreamStatus()
    assert watch.read() == stream_status.StreamLevels()
    watch.record_failure("it is mute")
    assert watch.read().failure == "it is mute"
    hand_clock.time_s += stream_status.HEARD_S + 1.0
    assert watch.read() == stream_status.StreamLevels()
    watch.record_trial(heard(), 500.0, aims=False)
    assert watch.read().has_beam is True
    watch.follow(messages.StateChanged(messages.CellState.RUNNING))
    assert watch.read() == stream_status.StreamLevels()


def test_thermometers_at_rest_tell_temperature_and_change(hand_clock):
    watch = stream_status.StreamStatus()
    for n in range(10):
        readings = {"X_degC": 20.0 + 0.1 * n, "air_degC": np.nan}
        watch.follow(messages.TemperaturesRead(readings))
        hand_clock.time_s += 10.0
    (shown,) = watch.read().temperatures
    assert (shown.channel, shown.over_s) == ("X_degC", 90.0)
    assert (shown.value_degC, shown.change_degC) == pytest.approx((20.9, 0.9))
    assert watch.read().drift_degC == pytest.approx(0.9)
