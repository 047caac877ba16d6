"""Drivers that talk in lines of text, over a link that does harm by a seed."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

from measuring import IN_PIECES, LOST_DOUBLED_OR_HIT, RATE_HZ, read_through
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError, DeviceTimeout
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy
from truepath_simulators.links.text_relay import TextRelay

NOISE_MM = 0.2
TURNS = {"geocom": {"turn_s": 0.4}, "t2sa": {}}
DRIVERS = {"geocom": GeoComTracker, "t2sa": T2saTracker}
LATE = Harm(latency_s=0.1, jitter_s=0.05)
SERIAL_HARM = Harm(drop=0.15, double=0.2, swap=0.1, noise=0.15, noise_bytes=40)


def write_line(samples, k):
    cells = [f"{samples.sequence[k]},{samples.device_time_s[k]:.6f}"]
    cells += [f"{value:.5f}" for value in samples.position_mm[k]]
    return ",".join([*cells, f"{samples.status[k]}"])


@pytest.fixture(scope="module")
def relay():
    with Bench(tracker="tcp", rtu=False) as bench:
        tracker = StreamingTracker(**bench.tracker_options)
        with TextRelay(tracker, write_line, link="pty") as started:
            yield started


def read_lines(relay, harm, seed):
    """Return what the driver reads, the lines that were sent, how often harm hit.

    Every sample that was read is a line that was sent, digit by digit and once.
    """
    with (
        LinkProxy(relay.options, seed=seed) as proxy,
        TextLineTracker(**proxy.options, rate_hz=RATE_HZ) as tracker,
    ):
        read = read_through(tracker, proxy, harm)
        steps = np.diff(read.sequence)
        harmed = proxy.harmed
        lines = bytes(proxy.sent_by_device).decode().split("\r\n")
    assert (steps > 0).all()
    assert {write_line(read, k) for k in range(len(read))} <= set(lines)
    return read, lines, harmed


@pytest.mark.parametrize("harm", LOST_DOUBLED_OR_HIT)
def test_lines_that_are_lost_doubled_or_hit_are_counted_and_never_wrong(relay, harm):
    read, lines, harmed = read_lines(relay, harm, seed=7)
    assert harmed > 2
    assert (np.diff(read.sequence) > 1).any()
    assert len(read) > 0.3 * len(lines)


@pytest.mark.parametrize(
    "harm", [IN_PIECES, pytest.param(LATE, marks=pytest.mark.fault_row(8), id="late")]
)
def test_lines_that_come_late_or_in_pieces_are_the_same(relay, harm):
    read, lines, _ = read_lines(relay, harm, seed=8)
    taken = [write_line(read, k) for k in range(len(read))]
    begin = lines.index(taken[0])
    assert taken == lines[begin : begin + len(taken)]


@pytest.fixture(
    scope="module", params=["geocom", pytest.param("t2sa", marks=pytest.mark.long)]
)
def polled(request):
    how = {"tracker": "pty" if request.param == "geocom" else "tcp", "speed": 20.0}
    with Bench(protocol=request.param, rtu=False, seed=3, **how) as bench:
        yield request.param, bench


@contextmanager
def linked(polled, seed):
    protocol, bench = polled
    waits = {"reply_timeout_s": 0.4, "shot_s": 0.4}
    with (
        LinkProxy(bench.tracker_options, seed=seed) as proxy,
        DRIVERS[protocol](**proxy.options, **waits, **TURNS[protocol]) as tracker,
    ):
        yield bench, proxy, tracker


def move_to(bench, x_mm):
    with ModbusController(**bench.motion_options) as controller:
        goal = list(controller.status().position)
        goal[0] = x_mm
        controller.move_to(tuple(goal), 20_000.0)
        while controller.status().state is MotionState.RUNNING:
            controller.send_heartbeat()
            time.sleep(0.02)


def measure_at_last(tracker):
    end_s = time.monotonic() + 4.0
    while True:
        try:
            tracker.connect()
            return tracker.measure(0.0).position_mm
        except DeviceError:
            assert time.monotonic() < end_s


def measure_by(tracker, bench, harm, proxy):
    """Return places in pairs, with and without harm, and how often it was an error."""
    pairs, errors = [], 0
    for x_mm in (90.0, 30.0):
        move_to(bench, x_mm)
        proxy.harm(to_host=harm)
        found = []
        for _ in range(3):
            try:
                tracker.connect()
                found.append(tracker.measure(0.0).position_mm)
            except DeviceError:
                errors += 1
        proxy.harm()
        place = measure_at_last(tracker)
        pairs += [(one, place) for one in found]
    return pairs, errors


def require_places(pairs):
    for harmed, clean in pairs:
        assert np.linalg.norm(harmed - clean) < NOISE_MM


@pytest.mark.parametrize(
    "harm",
    [
        IN_PIECES,
        pytest.param(
            LATE, marks=[pytest.mark.fault_row(8), pytest.mark.long], id="late"
        ),
    ],
)
def test_points_over_a_slow_link_are_those_of_now(polled, harm):
    with linked(polled, 9) as (bench, proxy, tracker):
        pairs, errors = measure_by(tracker, bench, harm, proxy)
    assert (errors, len(pairs)) == (0, 6)
    require_places(pairs)


@pytest.mark.fault_row(2)
@pytest.mark.parametrize("polled", ["geocom"], indirect=True)  # TCP loses nothing
def test_replies_that_are_lost_or_doubled_never_give_an_older_point(polled):
    with linked(polled, 10) as (bench, proxy, tracker):
        pairs, errors = measure_by(tracker, bench, SERIAL_HARM, proxy)
        assert proxy.harmed > 2
    assert errors > 0
    assert len(pairs) > 0
    require_places(pairs)


@pytest.mark.fault_row(5)
def test_a_silent_instrument_is_told_and_its_late_reply_is_no_later_point(polled):
    with linked(polled, 11) as (bench, proxy, tracker):
        tracker.measure(0.0)
        proxy.harm(to_host=Harm(latency_s=1.2))
        begin_s = time.monotonic()
        with pytest.raises(DeviceTimeout, match="no reply"):
            tracker.measure(0.0)
        assert time.monotonic() - begin_s < 1.5
        proxy.harm()
        move_to(bench, 60.0)
        late = measure_at_last(tracker)
        clean = tracker.measure(0.0).position_mm
    require_places([(late, clean)])
