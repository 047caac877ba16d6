"""The text-line driver: any tracker whose software can send lines."""

import numpy as np
import pytest

from truepath.device_options import make_device
from truepath.errors import BadInput
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


def send(lines):
    return "".join(f"{line}\n" for line in lines).encode("latin-1")


def start_reading(lines, rate_hz=500.0, **options):
    """Return a tracker to which half a line has come, and these after it."""
    tracker = TextLineTracker(1, host="h", rate_hz=rate_hz, **options)
    tracker._port = SentText(send(["half a line", *lines]))
    tracker.connect()
    tracker.start(rate_hz)
    return tracker


def read_lines(lines, **options):
    tracker = start_reading(lines, **options)
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
    assert (samples.lost, health.crc_errors) == (3, 2)
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
def test_a_counter_that_cannot_be_costs_its_line_alone(lines, columns, wraps):
    samples, health = read_lines(lines, columns=columns, counter_wraps=wraps)
    assert (samples.sequence.tolist(), health.crc_errors) == ([1, 2, 4, 5], 1)


UNSTAMPED = {"columns": "x,y,z", "arrival_times": True}
BY_UDP = {"columns": "counter,x,y,z", "udp": True, "rate_hz": 100.0}


def count_lines(*counters):
    return [f"{counter},1,2,3" for counter in counters]


@pytest.mark.parametrize("reorder_s", [0.0, 0.05])
def test_a_doubled_line_is_dropped_and_counted_or_an_error(reorder_s):
    options, lines = {**BY_UDP, "reorder_s": reorder_s}, count_lines(1, 2, 2, 3)
    samples, health = read_lines(lines, **options)
    assert samples.sequence.tolist() == [1, 2, 3]
    assert (samples.lost, health.doubled) == (0, 1)
    assert (health.late, health.crc_errors) == (0, 0)
    with pytest.raises(ConnectionLost, match=r"line 2 .* came twice"):
        read_lines(lines, **options, duplicates="error")


STAMPED = {"columns": "counter,time,x,y,z"}
AFTER = ["1,1.0,1,2,3", "3,1.004,1,2,3", "2,1.002,1,2,3"]
BACK = ["8,1.0,1,2,3", "9,1.002,1,2,3", "1,1.004,1,2,3"]
COUNTED = {
    "late and doubled": (count_lines(1, 3, 2, 4, 3), {}, (1, 1, 0)),
    "late by its time too": (AFTER, STAMPED, (0, 1, 0)),
    "a counter that is damaged": (BACK, STAMPED, (0, 0, 1)),
    "far back": (count_lines(9001, 9002, 3, 9004), {}, (0, 0, 1)),
}


@pytest.mark.parametrize("case", COUNTED)
def test_doubled_late_and_damaged_lines_are_counted_each_as_what_it_is(case):
    lines, options, counts = COUNTED[case]
    _, health = read_lines(lines, **{"columns": "counter,x,y,z", **options})
    assert (health.doubled, health.late, health.crc_errors) == counts


def test_a_late_line_is_no_doubled_one_and_a_late_double_is():
    options = {**BY_UDP, "duplicates": "error"}
    samples, _ = read_lines(count_lines(1, 3, 2, 4), **options)
    assert samples.sequence.tolist() == [1, 3, 4]
    with pytest.raises(ConnectionLost, match="twice"):
        read_lines(count_lines(1, 2, 3, 2), **options, reorder_s=0.05)


SWAPPED = {
    "counters": (count_lines(254, 256, 255, 259, 257, 258), {}),
    "wrapped": (count_lines(254, 0, 255, 3, 1, 2), {"counter_wraps": 256}),
    "times": (
        [f"{t},1,2,3" for t in (9.0, 9.02, 9.01, 9.05, 9.03, 9.04)],
        {"columns": "time,x,y,z"},
    ),
}


@pytest.mark.parametrize("case", SWAPPED)
def test_lines_out_of_order_are_put_in_order(case):
    lines, more = SWAPPED[case]
    _, health = read_lines(lines, **BY_UDP | more)
    assert (health.late, health.crc_errors) == (3, 0)
    samples, health = read_lines(lines, **BY_UDP | more, reorder_s=0.05)
    assert (samples.sequence - samples.sequence[0]).tolist() == list(range(6))
    np.testing.assert_allclose(np.diff(samples.device_time_s), 0.01)
    assert (samples.lost, health.late) == (0, 0)


def test_a_line_is_held_for_a_missing_one_no_longer_than_said(hand_clock):
    tracker = start_reading(count_lines(1, 3), **BY_UDP, reorder_s=0.05)
    assert tracker.read(0.0).sequence.tolist() == [1]
    hand_clock.time_s += 0.04
    assert len(tracker.read(0.0)) == 0
    hand_clock.time_s += 0.02
    assert tracker.read(0.0).sequence.tolist() == [3]


def test_a_missing_line_that_waited_while_nobody_read_is_taken(hand_clock):
    tracker = start_reading(count_lines(1, 3), **BY_UDP, reorder_s=0.05)
    tracker.read(0.0)
    hand_clock.time_s += 1.0
    tracker._port.due = send(count_lines(4, 2, 5))
    assert tracker.read(0.01).sequence.tolist() == [2, 3, 4, 5]


@pytest.mark.parametrize("wraps", [0, 20])
def test_lines_held_are_no_more_than_come_in_that_time(wraps, hand_clock):
    lines, options = count_lines(1, *range(3, 9), 2), {"counter_wraps": wraps}
    tracker = start_reading(lines, **BY_UDP | options, reorder_s=0.05)
    assert tracker.read(0.0).sequence.tolist() == [1, *range(3, 9)]
    assert (tracker.health.late, tracker.health.crc_errors) == (1, 0)


def test_the_place_written_without_a_beam_is_a_lost_sample_in_its_place():
    lines = ["1,9.5,2,3", "2,0.0,-1.50,0", "3,0,0,0", "4,9.5,2,3"]
    options = {"columns": "counter,x,y,z", "unit": "m", "axes": "y,-x,z"}
    samples, _ = read_lines(lines, **options)
    assert samples.status.tolist() == [0, 0, 0, 0]
    samples, health = read_lines(lines, **options, invalid_place="0, -1.5, 0")
    assert samples.sequence.tolist() == [1, 2, 3, 4]
    assert samples.status.tolist() == [0, 0x80, 0, 0]
    assert (samples.lost, health.crc_errors) == (0, 0)


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
        found.append(watch.update(rate * (0.1 * k - late_s)))
    first = next((each for each in found if each is not None), None)
    assert first == (told if told is None else pytest.approx(told, abs=0.1))


def test_a_stream_that_begins_anew_is_told():
    lines = [f"{k},1,2,3" for k in (100, 101, *range(1, 30))]
    with pytest.raises(ConnectionLost, match="begun anew"):
        read_lines(lines, columns="counter,x,y,z", rate_hz=10.0)


WRONG_WORDS = {
    "no column is z": {"columns": "x,y,counter"},
    "column z is named twice": {"columns": "x,y,z,z,counter"},
    "unit 'km' is none of": {"unit": "km"},
    "commas cannot separate both": {"decimal_comma": True},
    "'x,x,z': write each of": {"axes": "x,x,z"},
    "leave arrival_times out": {"arrival_times": True},
    "leave the commands out": {"start_command": "START"},
    "say arrival_times": {"columns": "x,y,z"},
    "none of drop, error": {"duplicates": "ignore"},
    "is for udp": {"reorder_s": 0.05, "udp": False},
    "reorder_s is 0.3": {"reorder_s": 0.3},
    "reorder_s is -1": {"reorder_s": -1.0},
    "reorder_s is nan": {"reorder_s": float("nan")},
    "one period of rate_hz": {"reorder_s": 0.001},
    "quarter of counter_wraps": {"reorder_s": 0.05, "counter_wraps": 19},
    "port 1 is the number of a TCP or UDP port: say host": {"udp": False},
    "port '/dev/x' is no number of a TCP or UDP port": {"port": "/dev/x"},
    "duplicates and": {**UNSTAMPED, "duplicates": "error"},
    "reorder_s out": {**UNSTAMPED, "reorder_s": 0.05},
    "'0,0': write x": {"invalid_place": "0,0"},
    "'0,0,nan': write x": {"invalid_place": "0,0,nan"},
    "'0;0;0': write x": {"invalid_place": "0;0;0"},
}


@pytest.mark.parametrize("said", WRONG_WORDS)
def test_settings_that_cannot_be_are_refused_in_words(said):
    options = {"port": 1} | BY_UDP
    with pytest.raises(Refused, match=said):
        TextLineTracker(**options | WRONG_WORDS[said])
    by_arrival = TextLineTracker(**options | UNSTAMPED)
    assert by_arrival.capabilities.clock is Clock.HOST


def test_a_refusal_of_the_options_names_the_setting_and_blames_no_package():
    said = r"^tracker_options of driver text-line: port 10000 is the number"
    with pytest.raises(BadInput, match=said):
        make_device("tracker", "text-line", {"port": 10000, "rate_hz": 500.0})
