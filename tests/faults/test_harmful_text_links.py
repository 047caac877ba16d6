"""Drivers that talk in lines of text, over a link that does harm by a seed."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError, DeviceTimeout
from truepath_drivers.interfaces.records import MotionState, TrackerSamples
from truepath_drivers.interfaces.tracker import PolledTracker
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy
from truepath_simulators.links.text_relay import TextRelay

RATE_HZ = 500.0
NOISE_MM = 0.2
TURNS = {"geocom": {"turn_s": 0.4}, "t2sa": {}}
DRIVERS = {"geocom": GeoComTracker, "t2sa": T2saTracker}
LATE = Harm(latency_s=0.1, jitter_s=0.05)
ONE_BYTE = Harm(most_bytes=1)
SERIAL_HARM = Harm(drop=0.15, double=0.2, swap=0.1, noise=0.15, noise_bytes=40)


def write_line(samples: TrackerSamples, k: int) -> str:
    cells = [f"{samples.sequence[k]},{samples.device_time_s[k]:.6f}"]
    cells += [f"{value:.5f}" for value in samples.position_mm[k]]
    return ",".join([*cells, f"{samples.status[k]}"])


@pytest.fixture(scope="module")
def relay() -> Iterator[TextRelay]:
    with Bench(tracker="tcp", rtu=False) as bench:
        tracker = StreamingTracker(**bench.tracker_options)
        with TextRelay(tracker, write_line, link="pty") as started:
            yield started


def read_through(proxy: LinkProxy, harm: Harm) -> TrackerSamples:
    """Return what the driver reads while harm is done for 0.6 s, and 0.4 s after."""
    with TextLineTracker(**proxy.options, rate_hz=RATE_HZ) as tracker:
        tracker.start(RATE_HZ)
        blocks = [tracker.read(1.0)]
        for now, seconds in ((harm, 0.6), (Harm(), 0.4)):
            proxy.harm(to_host=now)
            end_s = time.monotonic() + seconds
            while time.monotonic() < end_s:
                blocks.append(tracker.read(0.1))
        read = TrackerSamples.join(blocks)
        gaps = int((np.diff(read.sequence) - 1).sum())
        assert tracker.health.lost_samples == gaps
        tracker.stop()
    return read


def require_sent(read: TrackerSamples, sent: bytes) -> None:
    """Every sample that was read is a line that was sent, digit by digit and once."""
    lines = set(sent.decode().split("\r\n"))
    assert (np.diff(read.sequence) > 0).all()
    assert {write_line(read, k) for k in range(len(read))} <= lines


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(
            Harm(drop=0.15, double=0.15, swap=0.15),
            marks=pytest.mark.fault_row(2),
            id="drop-double-swap",
        ),
        pytest.param(
            Harm(noise=0.3, noise_bytes=20_000),
            marks=pytest.mark.fault_row(3),
            id="noise",
        ),
    ],
)
def test_lines_that_are_lost_doubled_or_hit_are_counted_and_never_wrong(relay, harm):
    with LinkProxy(relay.options, seed=7) as proxy:
        read = read_through(proxy, harm)
        assert proxy.harmed > 2
        sent = bytes(proxy.sent_by_device)
    require_sent(read, sent)
    assert (np.diff(read.sequence) > 1).any()
    assert len(read) > 0.3 * sent.count(b"\n")


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(ONE_BYTE, marks=pytest.mark.fault_row(4), id="one-byte"),
        pytest.param(LATE, marks=pytest.mark.fault_row(8), id="late"),
    ],
)
def test_lines_that_come_late_or_in_pieces_are_the_same(relay, harm):
    with LinkProxy(relay.options, seed=8) as proxy:
        read = read_through(proxy, harm)
        sent = bytes(proxy.sent_by_device)
    require_sent(read, sent)
    taken = [write_line(read, k) for k in range(len(read))]
    lines = sent.decode().split("\r\n")
    begin = lines.index(taken[0])
    assert taken == lines[begin : begin + len(taken)]


@pytest.fixture(scope="module", params=["geocom", "t2sa"])
def polled(request) -> Iterator[tuple[str, Bench]]:
    link = "pty" if request.param == "geocom" else "tcp"
    with Bench(
        protocol=request.param, tracker=link, speed=20.0, rtu=False, seed=3
    ) as bench:
        yield request.param, bench


def open_tracker(protocol: str, proxy: LinkProxy) -> PolledTracker:
    waits = {"reply_timeout_s": 0.4, "shot_s": 0.4}
    return DRIVERS[protocol](**proxy.options, **waits, **TURNS[protocol])


def move_to(bench: Bench, x_mm: float) -> None:
    with ModbusController(**bench.motion_options) as controller:
        goal = list(controller.status().position)
        goal[0] = x_mm
        controller.move_to(tuple(goal), 20_000.0)
        while controller.status().state is MotionState.RUNNING:
            controller.send_heartbeat()
            time.sleep(0.02)


def measure_at_last(tracker: PolledTracker):
    """Return the first place that is told within 4 s."""
    end_s = time.monotonic() + 4.0
    while True:
        try:
            tracker.connect()
            return tracker.measure(0.0).position_mm
        except DeviceError:
            assert time.monotonic() < end_s


def measure_by(tracker: PolledTracker, bench: Bench, harm: Harm, proxy: LinkProxy):
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


def require_places(pairs) -> None:
    for harmed, clean in pairs:
        assert np.linalg.norm(harmed - clean) < NOISE_MM


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(ONE_BYTE, marks=pytest.mark.fault_row(4), id="one-byte"),
        pytest.param(
            LATE, marks=[pytest.mark.fault_row(8), pytest.mark.long], id="late"
        ),
    ],
)
def test_points_over_a_slow_link_are_those_of_now(polled, harm):
    protocol, bench = polled
    with (
        LinkProxy(bench.tracker_options, seed=9) as proxy,
        open_tracker(protocol, proxy) as tracker,
    ):
        pairs, errors = measure_by(tracker, bench, harm, proxy)
    assert errors == 0
    assert len(pairs) == 6
    require_places(pairs)


@pytest.mark.fault_row(2)
def test_replies_that_are_lost_or_doubled_never_give_an_older_point(polled):
    protocol, bench = polled
    if protocol == "t2sa":
        pytest.skip("TCP alone, which neither loses nor doubles")
    with (
        LinkProxy(bench.tracker_options, seed=10) as proxy,
        open_tracker(protocol, proxy) as tracker,
    ):
        pairs, errors = measure_by(tracker, bench, SERIAL_HARM, proxy)
        assert proxy.harmed > 2
    assert errors > 0
    assert len(pairs) > 0
    require_places(pairs)


@pytest.mark.fault_row(5)
def test_a_silent_instrument_is_told_and_its_late_reply_is_no_later_point(polled):
    protocol, bench = polled
    with (
        LinkProxy(bench.tracker_options, seed=11) as proxy,
        open_tracker(protocol, proxy) as tracker,
    ):
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
