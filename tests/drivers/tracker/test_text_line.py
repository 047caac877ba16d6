"""The text-line driver: any tracker whose software can send lines."""

import socket
import time

import numpy as np
import pytest

from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.errors import ConnectionLost, Refused
from truepath_drivers.interfaces.tracker_records import Clock
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.text_line import driver
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_drivers.transport.byte_port import BytePort
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.text_relay import TextRelay


def write_line(samples, k):
    cells = [samples.sequence[k], f"{samples.device_time_s[k]:.6f}"]
    cells += [f"{v:.5f}" for v in samples.position_mm[k]]
    return ",".join(map(str, [*cells, samples.status[k]]))


@pytest.fixture(scope="module")
def relay():
    with Bench(tracker="tcp", rtu=False) as bench:
        tracker = StreamingTracker(**bench.tracker_options)
        with TextRelay(tracker, write_line) as relay:
            yield relay


@pytest.mark.parametrize("check", TRACKER_CHECKS, ids=lambda check: check.__name__)
def test_text_line_conforms(relay, check):
    check(lambda: TextLineTracker(**relay.options, rate_hz=500.0))


@pytest.fixture
def datagrams():
    """Send datagrams to a driver that listens; its samples."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    sender, other = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))

    def receive(lines, senders=1, **options):
        with TextLineTracker(port, udp=True, host="127.0.0.1", **options) as tracker:
            tracker._streams = True  # the sender is this test: nobody to wait for
            for line in ["half a line", *lines]:
                sender.sendto(line.encode(), ("127.0.0.1", port))
            if senders > 1:
                other.sendto(b"3,1,2,3", ("127.0.0.1", port))
            time.sleep(0.05)
            blocks = [tracker.read(0.0) for _ in range(len(lines) + 2)]
            rows = [row for block in blocks for row in _list_rows(block)]
            return rows, tracker.health

    with sender, other:
        yield receive


def _list_rows(block):
    return list(
        zip(
            block.sequence.tolist(), block.device_time_s.tolist(),
            block.position_mm.tolist(), block.status.tolist(), strict=True,
        )
    )  # fmt: skip


def test_units_axes_and_decimal_commas_are_those_of_the_settings(datagrams):
    rows, _ = datagrams(
        ["1,5;2,0;3,0;1000;OK", "1,5;2,0;nan;1002;OK", "1,5;2,0;3,0;1004;BAD"],
        columns="x,y,z,time,status", delimiter="semicolon", decimal_comma=True,
        unit="m", time_unit="ms", axes="y,-x,z", valid="OK", rate_hz=500.0,
    )  # fmt: skip
    assert [row[0] for row in rows] == [0, 1, 2]
    np.testing.assert_allclose([row[1] for row in rows], [1.0, 1.002, 1.004])
    assert rows[0][2:] == ([2000.0, -1500.0, 3000.0], 0)
    assert [row[3] for row in rows] == [0, 0x80, 1]


def test_a_lost_line_is_counted_and_a_damaged_one_costs_itself(datagrams):
    rows, health = datagrams(
        ["254,1,2,3", "255,1,2,3", "1,1,2,3", "2,1,2", "3,1,x,3", "4,1,2,3"],
        columns="counter,x,y,z", counter_wraps=256, rate_hz=500.0,
    )  # fmt: skip
    assert [row[0] for row in rows] == [254, 255, 257, 260]
    assert (health.lost_samples, health.crc_errors) == (3, 2)
    np.testing.assert_allclose(rows[-1][1] - rows[0][1], 6 / 500)


@pytest.mark.parametrize("wraps", [0, 65_536])
def test_a_damaged_counter_does_not_end_the_stream(datagrams, wraps):
    lines = [f"{k},1,2,3" for k in (1, 2, 60_003, 4, 5)]
    rows, health = datagrams(
        lines, columns="counter,x,y,z", rate_hz=500.0, counter_wraps=wraps
    )
    assert [row[0] for row in rows] == [1, 2, 4, 5]
    assert health.crc_errors == 1


def test_a_counter_and_a_time_that_contradict_each_other_are_a_damaged_line(datagrams):
    times = [0.002, 0.004, 1.006, 0.008, 0.010]
    lines = [f"{k},{t},1,2,3" for k, t in enumerate(times, start=1)]
    rows, health = datagrams(lines, columns="counter,time,x,y,z", rate_hz=500.0)
    assert [row[0] for row in rows] == [1, 2, 4, 5]
    assert health.crc_errors == 1


class SentBytes(BytePort):
    """What a sender has sent, without a wire."""

    name = "wire"

    def __init__(self, data):
        self._data = data

    def open(self):
        pass

    def close(self):
        pass

    def write(self, data):
        pass

    def read(self, timeout_s):
        data, self._data = self._data, b""
        return data


SEMICOLON = {"columns": "time,x,y,z", "delimiter": "semicolon"}
UNREADABLE = {
    "another number of fields": (b"1,2,3,4,5", {}, "has 5 fields, columns 4"),
    "another separator": (b"1;2;3;4", {}, "has 1 fields"),
    "decimal commas": (b"1;2,5;3,5;4,5", SEMICOLON, "x is '2,5', no number"),
    "a time of day": (b"10:11:12.5;2;3;4", SEMICOLON, "time is '10:11:12.5'"),
    "swapped columns": (b"LASER;1;2;3", SEMICOLON, "time is 'LASER'"),
    "UTF-16": ("1,2,3,4".encode("utf-16-le"), {}, "UTF-16"),
    "half a line": (b"1,2", {}, "has 2 fields"),
    "a counter with decimals": (b"1.5,2,3,4", {}, "counter is '1.5'"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_a_stream_that_cannot_be_read_is_refused_with_a_line_of_it(case, monkeypatch):
    line, options, cause = UNREADABLE[case]
    monkeypatch.setattr("truepath_drivers.tracker.text_line.driver._FIRST_LINE_S", 0.0)
    options = {"columns": "counter,x,y,z", **options}
    tracker = TextLineTracker(1, host="h", rate_hz=500.0, **options)
    data = (line + b"\n") * 9
    monkeypatch.setattr(tracker, "_port", SentBytes(b""))
    tracker.connect()
    monkeypatch.setattr(tracker, "_drop_stale", lambda: None)
    monkeypatch.setattr(tracker, "_rest", data)
    with pytest.raises(Refused, match="can be read") as refused:
        tracker.start(500.0)
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


def test_a_second_sender_is_not_mixed_with_the_first(datagrams):
    with pytest.raises(ConnectionLost, match="both send here"):
        datagrams(["1,1,2,3", "2,1,2,3"], columns="counter,x,y,z", rate_hz=500.0,
                  senders=2)  # fmt: skip


def test_a_stream_that_begins_anew_is_told(datagrams):
    lines = [f"{k},1,2,3" for k in (100, 101, *range(1, 30))]
    with pytest.raises(ConnectionLost, match="begun anew"):
        datagrams(lines, columns="counter,x,y,z", rate_hz=10.0)


def test_lines_without_a_stamp_need_the_word_of_the_user():
    with pytest.raises(Refused, match="arrival_times"):
        TextLineTracker(1, host="h", columns="x,y,z", rate_hz=500.0)
    tracker = TextLineTracker(
        1, host="h", columns="x,y,z", rate_hz=500.0, arrival_times=True
    )
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
