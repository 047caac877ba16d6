"""The text-line driver over TCP and datagrams."""

import socket

import pytest

from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces.errors import ConnectionLost
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
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


@pytest.mark.long
@pytest.mark.parametrize("check", TRACKER_CHECKS)
def test_text_line_conforms(relay, check):
    check(lambda: TextLineTracker(**relay.options, rate_hz=500.0))


def test_a_second_sender_of_datagrams_is_not_mixed_with_the_first(free_port):
    place = "127.0.0.1", free_port
    options = {"host": place[0], "columns": "counter,x,y,z", "rate_hz": 500.0}
    first, other = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
    with TextLineTracker(free_port, udp=True, **options) as tracker, first, other:
        tracker._streams = True  # the sender is this test: nobody to wait for
        for line in (b"half a line", b"1,1,2,3", b"2,1,2,3"):
            first.sendto(line, place)
        assert tracker.read(1.0).sequence.tolist() == [1, 2]
        other.sendto(b"3,1,2,3", place)
        with pytest.raises(ConnectionLost, match="both send here"):
            tracker.read(1.0)
