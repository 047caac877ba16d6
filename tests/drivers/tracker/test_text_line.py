"""The text-line driver: any tracker whose software can send lines."""

import socket
import time

import numpy as np
import pytest

from drivers.conformance.tracker import TRACKER_CHECKS
from drivers.interfaces.errors import ConnectionLost, Refused
from drivers.interfaces.tracker_records import Clock
from drivers.tracker.streaming.driver import StreamingTracker
from drivers.tracker.text_line.driver import TextLineTracker
from simulators.bench import Bench
from simulators.text_relay import TextRelay

COMMANDS = {"start_command": "START", "stop_command": "STOP"}


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
    options = {"port": relay.port, "host": "127.0.0.1", "rate_hz": 500.0, **COMMANDS}
    check(lambda: TextLineTracker(**options))


@pytest.fixture
def datagrams():
    """Send datagrams to a driver that listens; its samples."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def receive(lines, **options):
        with TextLineTracker(port, udp=True, host="127.0.0.1", **options) as tracker:
            tracker._streams = True  # the sender is this test: nobody to wait for
            for line in ["half a line", *lines]:
                sender.sendto(line.encode(), ("127.0.0.1", port))
            time.sleep(0.05)
            blocks = [tracker.read(0.0) for _ in range(len(lines) + 2)]
            rows = [row for block in blocks for row in _list_rows(block)]
            return rows, tracker.health

    with sender:
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


def test_a_damaged_counter_does_not_end_the_stream(datagrams):
    lines = [f"{k},1,2,3" for k in (1, 2, 9_000_003, 4, 5)]
    rows, health = datagrams(lines, columns="counter,x,y,z", rate_hz=500.0)
    assert [row[0] for row in rows] == [1, 2, 4, 5]
    assert health.crc_errors == 1


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
