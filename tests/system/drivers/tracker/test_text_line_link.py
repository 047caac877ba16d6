"""The text-line driver over TCP and datagrams."""

import re
import socket
import threading
import tomllib
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from tracker_peers import read_samples
from truepath.device_options import make_device
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.interfaces import errors, records
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
        with pytest.raises(errors.ConnectionLost, match="both send here"):
            tracker.read(1.0)


PAGE = Path(__file__).parents[4] / "docs" / "drivers.md"
PLACE = ("2255.5", "-2602.9", "-275.1")


def write_rows(row, k):
    """Of ten: the fifth without a beam, the seventh lost, the last two swapped."""
    rows = [row.replace("12.004", f"{12.004 + 0.01 * (k + j):.3f}") for j in range(10)]
    for word in PLACE:
        rows[4] = rows[4].replace(word, "0.0")
    return [*rows[:6], rows[7], rows[9], rows[8]]


@contextmanager
def sending(make_datagrams, place):
    """Send groups of datagrams, by number from 0, until the end of the block."""
    ended = threading.Event()

    def send():
        with socket.socket(type=socket.SOCK_DGRAM) as sender:
            for k in count():
                for line in make_datagrams(k):
                    sender.sendto(line.encode(), place)
                if ended.wait(0.1):
                    return

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_the_documented_stream_of_spatial_analyzer_is_read(free_port):
    page = PAGE.read_text(encoding="utf-8")
    section = page.partition("### SpatialAnalyzer's UDP stream\n")[2]
    row = re.search(r"`(X,.*?)`", section)[1]
    settings = tomllib.loads(re.search(r"```toml\n(.*?)```", section, re.DOTALL)[1])
    options = settings["tracker_options"] | {"host": "127.0.0.1", "port": free_port}
    tracker = make_device("tracker", settings["tracker_driver"], options)
    place = "127.0.0.1", free_port
    with tracker, sending(lambda k: write_rows(row, 10 * k), place):
        tracker.start(options["rate_hz"])
        first = read_samples(tracker, 10)
        late = tracker.health.late  # it may begin between two swapped ones
        samples = records.TrackerSamples.join([first, read_samples(tracker, 30)])
        health = tracker.health
    steps = np.rint((samples.device_time_s - 12.004) * 100.0).astype(int)
    assert (np.diff(steps) == np.diff(samples.sequence)).all()
    assert set(np.diff(steps)) == {1, 2}
    assert set(steps % 10) == {0, 1, 2, 3, 4, 5, 7, 8, 9}
    lost = steps % 10 == 4
    assert (samples.status != 0).tolist() == lost.tolist()
    assert (samples.position_mm[~lost] == [float(word) for word in PLACE]).all()
    assert health.late == late <= 1
    assert health.crc_errors == 0
