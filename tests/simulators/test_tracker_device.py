from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import encode_frame
from truepath_drivers.tracker.streaming.measurements import StatusBit
from truepath_drivers.tracker.streaming.message_codec import encode_message
from truepath_drivers.tracker.streaming.messages import (
    VERSION,
    Ack,
    DeviceInfo,
    Event,
    EventCode,
    Format,
    Hello,
    Message,
    Nak,
    NakCode,
    Ping,
    Start,
    Status,
    Stop,
    StreamInfo,
)
from truepath_simulators.faults import Schedule, parse_fault
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air, TrackerClock, random_pose
from truepath_simulators.machine_file import MachineFile
from truepath_simulators.motion.driven_motion import follow
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.timeline import Timeline, standing
from truepath_simulators.tracker.tracker_device import BUFFER_BYTES, TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts

CLOCK = TrackerClock(100.0, 1e-5)


class Wire:
    """A device, its clocks and a host that decodes what comes."""

    def __init__(self, machine: MachineFile, *faults: str) -> None:
        self.parts = TrackerParts(
            random_machine(machine, 1), random_pose(machine, 1), CLOCK, Air(), 1
        )
        self.schedule = Schedule(map(parse_fault, faults))
        self.device = TrackerDevice(self.parts, self.schedule)
        self.timeline: Timeline = standing([100.0, 100.0, 100.0], 0.0, 0)
        self.decoder = StreamDecoder()
        self.now_s = 1.0
        self.samples: list[TrackerSamples] = []
        self.messages: list[Message] = []
        self.waiting_bytes = 0

    def ask(self, message: Message) -> Message | None:
        reply = self.device.receive(encode_message(message), self.now_s, self.now_s)
        answers = self._take(reply)
        return answers[-1] if answers else None

    def stream(self, duration_s: float, step_s: float = 0.02) -> TrackerSamples:
        end_s = self.now_s + duration_s
        first = len(self.samples)
        while self.now_s < end_s:
            self.now_s += step_s
            self.device.receive(encode_message(Ping(9)), self.now_s, self.now_s)
            self.tick()
        return TrackerSamples.join(self.samples[first:])

    def tick(self) -> None:
        self._take(
            self.device.due(self.timeline, self.now_s, self.now_s, self.waiting_bytes)
        )

    def _take(self, data: bytes) -> list[Message]:
        decoded = self.decoder.feed(data)
        self.samples.append(decoded.samples)
        self.messages += decoded.messages
        return list(decoded.messages)


@pytest.fixture
def wire(machine: MachineFile) -> Callable[..., Wire]:
    def wired(*faults: str) -> Wire:
        return Wire(machine, *faults)

    return wired


@pytest.fixture
def streaming(wire: Callable[..., Wire]) -> Callable[..., Wire]:
    def started(*faults: str) -> Wire:
        wired = wire(*faults)
        wired.ask(Start(1, 500.0))
        return wired

    return started


def test_it_says_who_it_is(wire: Callable[..., Wire]) -> None:
    match wire().ask(Hello(7)):
        case Ack(7, _, DeviceInfo(maker="Truepath", serial_number="SIM-000001")):
            pass
        case other:
            pytest.fail(f"got {other}")


def test_it_streams_from_start_to_stop(wire: Callable[..., Wire]) -> None:
    device = wire()
    assert len(device.stream(0.5)) == 0
    match device.ask(Start(1, 500.0)):
        case Ack(1, _, StreamInfo(500.0, 0)):
            pass
        case other:
            pytest.fail(f"got {other}")
    assert abs(len(device.stream(2.0)) - 1000) <= 10
    assert device.ask(Stop(2)) == Ack(2, 0x22)
    assert len(device.stream(0.5)) == 0


def test_samples_are_whole_and_evenly_timed(streaming: Callable[..., Wire]) -> None:
    samples = streaming().stream(3.0)
    np.testing.assert_array_equal(np.diff(samples.sequence), 1)
    np.testing.assert_allclose(np.diff(samples.device_time_s), 0.002, atol=1.1e-6)
    assert not samples.status.any()


def test_the_clock_has_its_own_epoch_and_rate(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    samples = device.stream(4.0)
    assert samples.device_time_s[0] == pytest.approx(CLOCK.device_s(1.0), abs=2e-6)
    assert samples.device_time_s[-1] <= CLOCK.device_s(device.now_s)
    assert CLOCK.device_s(device.now_s) - samples.device_time_s[-1] < 0.0021


def test_it_sees_the_machine_move(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    path = Program(np.array([[300.0, 200, 50]]), np.array([100.0]), np.zeros(1))
    device.timeline = follow(path, np.full(3, 100.0), 1.0, Limits())
    samples = device.stream(4.0)
    parts = device.parts
    moments = CLOCK.true_s(samples.device_time_s)
    seen = parts.truth.locate_target_mm(device.timeline.positions(moments))
    off = samples.position_mm - parts.pose.from_table(seen)
    assert 1e-3 < off.std() < 6e-3
    assert np.abs(off).max() < 0.03


def test_the_same_seed_and_times_give_the_same_bytes(
    streaming: Callable[..., Wire],
) -> None:
    first, again = streaming().stream(1.0), streaming().stream(1.0)
    np.testing.assert_array_equal(first.position_mm, again.position_mm)


def test_samples_do_not_depend_on_how_often_it_is_asked(
    streaming: Callable[..., Wire],
) -> None:
    often, seldom = streaming().stream(2.0, 0.004), streaming().stream(2.0, 0.5)
    n = min(len(often), len(seldom))
    np.testing.assert_allclose(often.position_mm[:n], seldom.position_mm[:n], atol=1e-9)


def test_starting_again_changes_nothing(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    before = device.stream(0.5)
    assert isinstance(device.ask(Start(2, 500.0)), Ack)
    after = device.stream(0.5)
    assert after.sequence[0] == before.sequence[-1] + 1
    assert device.decoder.health.lost_samples == 0


def test_each_stream_has_noise_of_its_own(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    first = device.stream(2.0).position_mm
    device.ask(Stop(2))
    device.ask(Start(3, 500.0))
    second = device.stream(2.0).position_mm
    off = [part[:900] - part[:900].mean(0) for part in (first, second)]
    # It stands: what is left of a mean is noise, with the correlation of its air.
    alike = (off[0] * off[1]).sum() / np.sqrt((off[0] ** 2).sum() * (off[1] ** 2).sum())
    assert abs(alike) < 0.3
    assert off[0].std() == pytest.approx(off[1].std(), rel=0.3)


def test_a_running_stream_is_not_changed_by_another_start(
    streaming: Callable[..., Wire],
) -> None:
    match streaming().ask(Start(2, 1000.0)):
        case Nak(2, _, NakCode.BUSY):
            pass
        case other:
            pytest.fail(f"got {other}")


@pytest.mark.parametrize("rate_hz", [0.0, 5001.0])
def test_an_impossible_rate_is_refused(
    wire: Callable[..., Wire], rate_hz: float
) -> None:
    match wire().ask(Start(2, rate_hz)):
        case Nak(2, _, NakCode.RATE_NOT_POSSIBLE):
            pass
        case other:
            pytest.fail(f"got {other}")


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (bytes([VERSION, 0x77, 5]), NakCode.UNKNOWN_COMMAND),
        (bytes([VERSION + 1, 0x20, 5]), NakCode.VERSION_NOT_SPOKEN),
        (bytes([VERSION, 0x20, 5, 9]), NakCode.VERSION_NOT_SPOKEN),
        (bytes([VERSION, 0x21, 5, 1]), NakCode.BAD_ARGUMENT),
        (bytes([VERSION, 0x21, 5, 0x20, 0xA1, 7, 0, 9]), NakCode.BAD_ARGUMENT),
    ],
)
def test_what_it_does_not_know_it_says_so(
    wire: Callable[..., Wire], body: bytes, code: NakCode
) -> None:
    device = wire()
    reply = device.device.receive(encode_frame(body), 1.0, 1.0)
    match device.decoder.feed(reply).messages:
        case (Nak(5, _, got),):
            assert got == code
        case other:
            pytest.fail(f"got {other}")


def test_short_frames_on_request(wire: Callable[..., Wire]) -> None:
    device = wire()
    device.ask(Start(1, 500.0, Format.MEAS))
    samples = device.stream(0.5)
    assert len(samples) > 200
    assert not samples.status.any()


def test_without_a_ping_the_stream_ends(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    for _ in range(300):
        device.now_s += 0.02
        device.tick()
    assert not device.device.streaming
    stopped = [m for m in device.messages if isinstance(m, Event)]
    assert [m.code for m in stopped] == [EventCode.STREAM_STOPPED_NO_PING]
    total = sum(len(block) for block in device.samples)
    assert total == pytest.approx(2500, abs=15)


def test_status_comes_twice_a_second(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    device.stream(3.0)
    told = [m for m in device.messages if isinstance(m, Status)]
    assert len(told) == 6
    assert told[-1].frames_sent == pytest.approx(1250, abs=30)


def test_an_overflow_is_told_with_the_next_sample(
    streaming: Callable[..., Wire],
) -> None:
    device = streaming()
    device.stream(0.5)
    device.waiting_bytes = BUFFER_BYTES + 1
    assert len(device.stream(0.2)) == 0
    device.waiting_bytes = 0
    samples = device.stream(0.5)
    assert len(samples) > 0
    health = device.decoder.health
    assert health.device_overflows == 1
    assert health.lost_samples == pytest.approx(100, abs=20)


def test_silence_loses_its_samples_and_no_more(streaming: Callable[..., Wire]) -> None:
    device = streaming("tracker:silence@1s+0.5s")
    samples = device.stream(3.0)
    steps = np.diff(samples.sequence)
    assert np.count_nonzero(steps > 1) == 1
    assert steps.max() == pytest.approx(251, abs=2)
    assert device.decoder.health.lost_samples == steps.max() - 1


def test_a_mute_device_answers_nothing(wire: Callable[..., Wire]) -> None:
    assert wire("tracker:silence").ask(Hello(1)) is None


def test_a_delay_loses_nothing(streaming: Callable[..., Wire]) -> None:
    device = streaming("tracker:delay@1s+0.5s")
    samples = device.stream(3.0)
    np.testing.assert_array_equal(np.diff(samples.sequence), 1)
    lengths = [len(block) for block in device.samples]
    assert max(lengths) > 240


@pytest.mark.parametrize(
    ("fault", "lost", "crc_errors"),
    [
        ("tracker:drop@1s", 1, 0),
        ("tracker:bit-flip@1s", 1, 1),
        ("tracker:lost-bytes@1s", 1, 1),
        ("tracker:duplicate@1s", 0, 0),
    ],
)
def test_one_bad_frame_costs_at_most_one_sample(
    streaming: Callable[..., Wire], fault: str, lost: int, crc_errors: int
) -> None:
    device = streaming(fault)
    samples = device.stream(2.0)
    health = device.decoder.health
    assert health.lost_samples <= lost
    assert health.crc_errors <= crc_errors
    if lost:
        assert health.lost_samples + health.crc_errors + health.skipped_bytes >= 1
    clean = streaming().stream(2.0)
    kept = np.isin(clean.sequence, samples.sequence)
    np.testing.assert_array_equal(clean.position_mm[kept], samples.position_mm)


def test_a_share_of_frames_is_damaged(streaming: Callable[..., Wire]) -> None:
    device = streaming("tracker:bit-flip@0s+4s*0.05")
    device.stream(6.0)
    assert 60 < device.decoder.health.lost_samples < 140


def test_noise_costs_the_neighbours_at_most(streaming: Callable[..., Wire]) -> None:
    device = streaming("tracker:noise@1s*2000")
    device.stream(2.0)
    assert device.decoder.health.lost_samples <= 1
    assert device.decoder.health.skipped_bytes > 1000


def test_a_broken_beam_makes_samples_invalid_and_is_told(
    streaming: Callable[..., Wire],
) -> None:
    device = streaming("tracker:beam-break@1s+0.5s")
    samples = device.stream(3.0)
    broken = samples.status == StatusBit.BEAM_BROKEN
    assert broken.sum() == pytest.approx(250, abs=2)
    events = [m.code for m in device.messages if isinstance(m, Event)]
    assert events == [EventCode.BEAM_BROKEN, EventCode.BEAM_LOCKED]


def test_a_spike_is_one_valid_sample_off(streaming: Callable[..., Wire]) -> None:
    clean = streaming().stream(2.0)
    spiky = streaming("tracker:spike@600n*0.3").stream(2.0)
    off = np.linalg.norm(spiky.position_mm - clean.position_mm, axis=1)
    assert np.flatnonzero(off > 1e-9).tolist() == [600]
    assert off[600] == pytest.approx(0.3)
    assert spiky.status[600] == 0


def test_another_device_speaks_another_version(wire: Callable[..., Wire]) -> None:
    match wire("tracker:wrong-identity").ask(Hello(1)):
        case Ack(_, _, DeviceInfo(maker="Nobody", version=version)):
            assert version != VERSION
        case other:
            pytest.fail(f"got {other}")


def test_an_added_fault_strikes_now(streaming: Callable[..., Wire]) -> None:
    device = streaming()
    device.stream(0.5)
    device.schedule.add(parse_fault("tracker:beam-break+0.1s"), device.now_s)
    samples: Any = device.stream(1.0)
    assert (samples.status != 0).sum() == pytest.approx(50, abs=2)
