"""Between our drivers and their devices lies a link that does harm, by a seed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest

from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import MotionState, TrackerSamples
from truepath_drivers.tracker.streaming.codec import SampleDecoder
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy

RATE_HZ = 500.0


@pytest.fixture(scope="module", params=["pty", "tcp"])
def bench(request) -> Iterator[Bench]:
    with Bench(seed=9, tracker=request.param) as started:
        yield started


def stream_through(proxy: LinkProxy, harm: Harm, seconds: float) -> TrackerSamples:
    """Return what the driver reads while harm is done, and half a second after it."""
    blocks: list[TrackerSamples] = []
    tracker = StreamingTracker(**proxy.options)
    tracker.connect()
    try:
        tracker.start(RATE_HZ)
        blocks.append(tracker.read(1.0))
        proxy.harm(to_host=harm)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            blocks.append(tracker.read(0.2))
        proxy.harm()
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            blocks.append(tracker.read(0.2))
        tracker.stop()
    finally:
        tracker.close()
    return TrackerSamples.join(blocks)


def sent(proxy: LinkProxy) -> TrackerSamples:
    """Return the samples in the bytes that the device has sent."""
    reader, decoder = FrameReader(), SampleDecoder()
    return decoder.decode(reader.feed(bytes(proxy.sent_by_device))).samples


def require_true(read: TrackerSamples, truth: TrackerSamples) -> None:
    """Every sample that was read is one that was sent, bit by bit and once."""
    index = np.searchsorted(truth.device_time_s, read.device_time_s)
    assert (np.diff(index) > 0).all()
    np.testing.assert_array_equal(truth.device_time_s[index], read.device_time_s)
    np.testing.assert_array_equal(truth.position_mm[index], read.position_mm)
    np.testing.assert_array_equal(truth.status[index], read.status)
    lost = (np.diff(read.sequence) - 1).sum()
    assert lost == (np.diff(index) - 1).sum()


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(Harm(flip=0.3), marks=pytest.mark.fault_row(1), id="flip"),
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
def test_harm_costs_samples_and_makes_none_wrong(bench, harm, measured):
    with LinkProxy(bench.tracker_options, seed=4) as proxy:
        read = stream_through(proxy, harm, 0.8)
        assert proxy.harmed > 3
        truth = sent(proxy)
    require_true(read, truth)
    assert 0.3 * len(truth) < len(read) <= len(truth)
    measured(f"{len(read)} of {len(truth)} samples read, none wrong")


@pytest.mark.parametrize(
    "harm",
    [
        pytest.param(Harm(most_bytes=1), marks=pytest.mark.fault_row(4), id="one-byte"),
        pytest.param(
            Harm(latency_s=0.2, jitter_s=0.15),
            marks=pytest.mark.fault_row(8),
            id="late",
        ),
    ],
)
def test_what_comes_late_or_in_pieces_is_the_same(bench, harm, measured):
    with LinkProxy(bench.tracker_options, seed=5) as proxy:
        read = stream_through(proxy, harm, 0.8)
        truth = sent(proxy)
    require_true(read, truth)
    assert (np.diff(read.sequence) == 1).all()
    np.testing.assert_allclose(np.diff(read.device_time_s), 1 / RATE_HZ, rtol=1e-3)
    measured(f"{len(read)} samples, all as sent")


@pytest.fixture(scope="module")
def cnc() -> Iterator[Bench]:
    with Bench(seed=9, rtu=False) as started:
        yield started


@pytest.fixture
def driven(cnc) -> Iterator[tuple[LinkProxy, ModbusController]]:
    with LinkProxy(cnc.motion_options, seed=6) as proxy:
        controller = ModbusController(**proxy.options)
        controller.connect()
        yield proxy, controller
        proxy.harm()
        controller.close()


@pytest.mark.fault_row(16)
def test_a_reset_connection_is_opened_again_by_the_next_verb(driven):
    proxy, controller = driven
    before = controller.status().position
    for _ in range(3):
        proxy.reset()
        assert controller.status().position == before
    assert proxy.connections == 4


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
    end_s = time.monotonic() + 5.0
    state = None
    while state is not MotionState.IDLE:
        assert time.monotonic() < end_s
        with suppress(DeviceError):
            state = controller.status().state


@pytest.mark.fault_row(14)
def test_commands_over_a_line_that_loses_replies_run_once_each(driven):
    """Damaged replies in one of five: moves end where they were sent, none twice."""
    proxy, controller = driven
    proxy.harm(to_host=Harm(drop=0.2))
    low = np.array([axis[0] for axis in controller.travel])
    for step in (3.0, 6.0, 2.0):
        goal = tuple(low + step)
        moved = False
        while not moved:
            with suppress(DeviceError):
                controller.move_to(goal, 6000.0)
                moved = True
        end_s = time.monotonic() + 20.0
        while True:
            assert time.monotonic() < end_s
            with suppress(DeviceError):
                controller.send_heartbeat()
                status = controller.status()
                if status.state is not MotionState.RUNNING:
                    break
        assert status.position == pytest.approx(goal, abs=0.001)
