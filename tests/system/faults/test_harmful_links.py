"""Between our drivers and their devices lies a link that does harm, by a seed."""

import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from measuring import IN_PIECES, LOST_DOUBLED_OR_HIT, RATE_HZ, read_through
from processes import until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError, DeviceTimeout
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.geocom.driver import GeoComTracker
from truepath_drivers.tracker.streaming import codec, driver, framing
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.t2sa.driver import T2saTracker
from truepath_drivers.tracker.text_line.driver import TextLineTracker
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy
from truepath_simulators.links.text_relay import TextRelay


@pytest.fixture(
    scope="module", params=["tcp", pytest.param("pty", marks=pytest.mark.long)]
)
def bench(request):
    with Bench(seed=9, tracker=request.param) as started:
        yield started


def stream_through(bench, harm, seed):
    with LinkProxy(bench.tracker_options, seed=seed) as proxy:
        with driver.StreamingTracker(**proxy.options) as tracker:
            read = read_through(tracker, proxy, harm)
        harmed = proxy.harmed
        reader, decoder = framing.FrameReader(), codec.SampleDecoder()
        truth = decoder.decode(reader.feed(bytes(proxy.sent_by_device))).samples
    # Every sample that was read is one that was sent, bit by bit and once.
    index = np.searchsorted(truth.device_time_s, read.device_time_s)
    assert (np.diff(index) > 0).all()
    np.testing.assert_array_equal(truth.device_time_s[index], read.device_time_s)
    np.testing.assert_array_equal(truth.position_mm[index], read.position_mm)
    np.testing.assert_array_equal(truth.status[index], read.status)
    assert (np.diff(read.sequence) - 1).sum() == (np.diff(index) - 1).sum()
    return read, len(truth), harmed


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(Harm(flip=0.3), marks=pytest.mark.fault_row(1), id="flip"),
        *LOST_DOUBLED_OR_HIT,
    ],
)
def test_harm_costs_samples_and_makes_none_wrong(bench, harm, measured):
    read, sent, harmed = stream_through(bench, harm, seed=4)
    assert harmed > 3
    assert 0.3 * sent < len(read) <= sent
    measured(f"{len(read)} of {sent} samples read, none wrong")


@pytest.mark.parametrize(
    "harm",
    [
        IN_PIECES,
        pytest.param(
            Harm(latency_s=0.2, jitter_s=0.15),
            marks=pytest.mark.fault_row(8),
            id="late",
        ),
    ],
)
def test_what_comes_late_or_in_pieces_is_the_same(bench, harm, measured):
    read, _, _ = stream_through(bench, harm, seed=5)
    assert (np.diff(read.sequence) == 1).all()
    np.testing.assert_allclose(np.diff(read.device_time_s), 1 / RATE_HZ, rtol=1e-3)
    measured(f"{len(read)} samples, all as sent")


over_tcp = pytest.mark.parametrize("bench", ["tcp"], indirect=True)


@pytest.fixture
def driven(bench):
    with (
        LinkProxy(bench.motion_options, seed=6) as proxy,
        ModbusController(**proxy.options) as controller,
    ):
        yield proxy, controller
        proxy.harm()


@over_tcp
@pytest.mark.fault_row(16)
def test_a_reset_connection_is_opened_again_by_the_next_verb(driven):
    proxy, controller = driven
    before = controller.status().position
    for _ in range(3):
        proxy.reset()
        assert controller.status().position == before
    assert proxy.connections == 4


@over_tcp
@pytest.mark.fault_row(16)
@pytest.mark.parametrize(
    "harm", [Harm(is_hole=True), Harm(pause_s=0.05)], ids=["black-hole", "byte-by-byte"]
)
def test_a_hold_that_cannot_be_confirmed_says_so_in_time(driven, harm):
    proxy, controller = driven
    proxy.harm(to_host=harm)
    begun_s = time.monotonic()
    with pytest.raises(DeviceError):
        controller.hold()
    assert time.monotonic() - begun_s < 1.0


@over_tcp
@pytest.mark.fault_row(16)
def test_a_link_that_is_away_is_not_stormed_and_comes_back(driven):
    proxy, controller = driven
    proxy.harm(to_host=Harm(is_hole=True))
    begun_s, tries = time.monotonic(), 0
    while time.monotonic() - begun_s < 2.0:
        tries += 1
        with suppress(DeviceError):
            controller.status()
    assert proxy.connections <= 1 + tries
    assert proxy.connections < 15
    proxy.harm()

    def is_back():
        with suppress(DeviceError):
            return controller.status().state is MotionState.IDLE

    until(is_back, 5.0)


@over_tcp
@pytest.mark.fault_row(14)
def test_commands_over_a_line_that_loses_replies_run_once_each(driven):
    """Damaged replies in one of five: moves end where they were sent, none twice."""
    proxy, controller = driven
    proxy.harm(to_host=Harm(drop=0.2))
    low = np.array([axis[0] for axis in controller.travel])

    def is_sent():
        with suppress(DeviceError):
            controller.move_to(goal, 6000.0)
            return True

    def stands():
        with suppress(DeviceError):
            controller.send_heartbeat()
            status = controller.status()
            return status.state is not MotionState.RUNNING and status

    for step in (3.0, 6.0, 2.0):
        goal = tuple(low + step)
        until(is_sent)
        assert until(stands, 20.0).position == pytest.approx(goal, abs=0.001)


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
