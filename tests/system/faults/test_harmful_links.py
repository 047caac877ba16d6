"""Between our drivers and their devices lies a link that does harm, by a seed."""

import time
from contextlib import suppress

import numpy as np
import pytest

from measuring import IN_PIECES, LOST_DOUBLED_OR_HIT, RATE_HZ, read_through
from processes import until
from truepath_drivers.cnc.modbus.driver import ModbusController
from truepath_drivers.interfaces.errors import DeviceError
from truepath_drivers.interfaces.records import MotionState
from truepath_drivers.tracker.streaming import codec, driver, framing
from truepath_simulators.bench.bench import Bench
from truepath_simulators.links.link_proxy import Harm, LinkProxy


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
    require_true(read, truth)
    return read, len(truth), harmed


def require_true(read, truth):
    """Every sample that was read is one that was sent, bit by bit and once."""
    index = np.searchsorted(truth.device_time_s, read.device_time_s)
    assert (np.diff(index) > 0).all()
    np.testing.assert_array_equal(truth.device_time_s[index], read.device_time_s)
    np.testing.assert_array_equal(truth.position_mm[index], read.position_mm)
    np.testing.assert_array_equal(truth.status[index], read.status)
    assert (np.diff(read.sequence) - 1).sum() == (np.diff(index) - 1).sum()


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
