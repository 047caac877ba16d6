"""The text-line driver: any tracker whose software can send lines."""

import numpy as np
import pytest

from truepath_drivers import host_clock
from truepath_drivers.interfaces.errors import ConnectionLost, Refused
from truepath_drivers.interfaces.tracker_records import Clock
from truepath_drivers.tracker.text_line import driver
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from wires import HandPort


class SentText(HandPort):
    """What a sender has sent comes to whoever waits."""

    def read(self, timeout_s):
        if timeout_s == 0.0 or not self.due:
            host_clock.sleep_s(timeout_s)
            return b""
        return super().read(timeout_s)


def read_lines(lines, rate_hz=500.0, **options):
    """Return the samples of lines after half a one, and the health."""
    tracker = TextLineTracker(1, host="h", rate_hz=rate_hz, **options)
    tracker._port = SentText("\n".join(["half a line", *lines, ""]).encode("latin-1"))
    tracker.connect()
    tracker.start(rate_hz)
    return tracker.read(0.0), tracker.health


def test_units_axes_and_decimal_commas_are_those_of_the_settings():
    samples, _ = read_lines(
        ["1,5;2,0;3,0;1000;OK", "1,5;2,0;nan;1002;OK", "1,5;2,0;3,0;1004;BAD"],
        columns="x,y,z,time,status",
        delimiter="semicolon",
        decimal_comma=True,
        unit="m",
        time_unit="ms",
        axes="y,-x,z",
        valid="OK",
    )
    assert samples.sequence.tolist() == [0, 1, 2]
    np.testing.assert_allclose(samples.device_time_s, [1.0, 1.002, 1.004])
    assert samples.position_mm[0].tolist() == [2000.0, -1500.0, 3000.0]
    assert samples.status.tolist() == [0, 0x80, 1]


def test_a_lost_line_is_counted_and_a_damaged_one_costs_itself():
    lines = ["254,1,2,3", "255,1,2,3", "1,1,2,3", "2,1,2", "3,1,x,3", "4,1,2,3"]
    samples, health = read_lines(lines, columns="counter,x,y,z", counter_wraps=256)
    assert samples.sequence.tolist() == [254, 255, 257, 260]
    assert (health.lost_samples, health.crc_errors) == (3, 2)
    np.testing.assert_allclose(np.ptp(samples.device_time_s), 6 / 500)


DAMAGED_COUNTER = [f"{k},1,2,3" for k in (1, 2, 60_003, 4, 5)]
OTHER_TIME = ["1,0.002,1,2,3", "2,0.004,1,2,3", "3,1.006,1,2,3", "4,0.008,1,2,3"]


@pytest.mark.parametrize(
    ("lines", "columns", "wraps"),
    [
        (DAMAGED_COUNTER, "counter,x,y,z", 0),
        (DAMAGED_COUNTER, "counter,x,y,z", 65_536),
        ([*OTHER_TIME, "5,0.010,1,2,3"], "counter,time,x,y,z", 0),
    ],
)
def test_a_counter_that_is_damaged_or_contradicts_its_time_costs_its_line_alone(
    lines, columns, wraps
):
    samples, health = read_lines(lines, columns=columns, counter_wraps=wraps)
    assert samples.sequence.tolist() == [1, 2, 4, 5]
    assert health.crc_errors == 1


SEMICOLON = {"columns": "time,x,y,z", "delimiter": "semicolon"}
UNREADABLE = {
    "another number of fields": ("1,2,3,4,5", {}, "has 5 fields, columns 4"),
    "another separator": ("1;2;3;4", {}, "has 1 fields"),
    "decimal commas": ("1;2,5;3,5;4,5", SEMICOLON, "x is '2,5', no number"),
    "a time of day": ("10:11:12.5;2;3;4", SEMICOLON, "time is '10:11:12.5'"),
    "swapped columns": ("LASER;1;2;3", SEMICOLON, "time is 'LASER'"),
    "UTF-16": ("1\0,\0002\0,\0003\0,\0004\0", {}, "UTF-16"),
    "half a line": ("1,2", {}, "has 2 fields"),
    "a counter with decimals": ("1.5,2,3,4", {}, "counter is '1.5'"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_a_stream_that_cannot_be_read_is_refused_with_a_line_of_it(case, clock):
    line, options, cause = UNREADABLE[case]
    with pytest.raises(Refused, match="can be read") as refused:
        read_lines([line] * 9, **{"columns": "counter,x,y,z", **options})
    assert cause in str(refused.value)


@pytest.mark.parametrize(
    ("rate", "told"), [(1.0, None), (2.0, 2.0), (0.5, 0.5), (1e-3, 1e-3)]
)
def test_a_clock_that_runs_at_another_pace_is_told(rate, told, hand_clock, rng):
    hand_clock.time_s = 100.0
    watch, found = driver.Pace(), []
    for k in range(1, 300):
        late_s = rng.uniform(0.0, 2.0) * (k % 7 == 0)  # this computer was busy
        hand_clock.time_s = 100.0 + 0.1 * k
        found.append(watch.look(rate * (0.1 * k - late_s)))
    first = next((each for each in found if each is not None), None)
    assert first == (told if told is None else pytest.approx(told, abs=0.1))


def test_a_stream_that_begins_anew_is_told():
    lines = [f"{k},1,2,3" for k in (100, 101, *range(1, 30))]
    with pytest.raises(ConnectionLost, match="begun anew"):
        read_lines(lines, columns="counter,x,y,z", rate_hz=10.0)


def test_lines_without_a_stamp_need_the_word_of_the_user():
    options = {"host": "h", "columns": "x,y,z", "rate_hz": 500.0}
    with pytest.raises(Refused, match="arrival_times"):
        TextLineTracker(1, **options)
    tracker = TextLineTracker(1, **options, arrival_times=True)
    assert tracker.capabilities.clock is Clock.HOST


@pytest.mark.parametrize(
    "wrong",
    [
        {"columns": "x,y,counter"}, {"columns": "x,y,z,z,counter"}, {"unit": "km"},
        {"decimal_comma": True}, {"axes": "x,x,z"}, {"arrival_times": True},
        {"udp": True, "start_command": "START"},
    ],
)  # fmt: skip
def test_settings_that_contradict_themselves_are_refused(wrong):
    with pytest.raises(Refused):
        TextLineTracker(1, rate_hz=500.0, **wrong)
