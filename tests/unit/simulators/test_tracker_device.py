"""Simulated trackers; faults and options of simulated devices."""

import numpy as np
import pytest

from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.tracker.streaming import codec, messages
from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import encode_frame
from truepath_drivers.tracker.streaming.messages import (
    VERSION,
    Start,
    Stop,
    encode_message,
)
from truepath_simulators import machine_file, processes, timeline
from truepath_simulators.bench.command import main
from truepath_simulators.errors import SimulatorError
from truepath_simulators.faults import Fault, Schedule, parse_fault
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import Air, TrackerClock, random_pose
from truepath_simulators.motion.planner import make_program_timeline
from truepath_simulators.motion.profile import Limits
from truepath_simulators.motion.program import Program
from truepath_simulators.tracker.tracker_device import BUFFER_BYTES, TrackerDevice
from truepath_simulators.tracker.tracker_sight import TrackerParts

MACHINE = machine_file.parse_machine(machine_file.load_machine("demo"))
CLOCK = TrackerClock(100.0, 1e-5)


class Wire:
    def __init__(self, *faults):
        truth, pose = random_machine(MACHINE, 1), random_pose(MACHINE, 1)
        self.parts = TrackerParts(truth, pose, CLOCK, Air(), 1)
        self.schedule = Schedule(map(parse_fault, faults))
        self.device = TrackerDevice(self.parts, self.schedule)
        self.timeline = timeline.standing([100.0, 100.0, 100.0], 0.0, 0)
        self.decoder = StreamDecoder()
        self.now_s, self.waiting_bytes = 1.0, 0
        self.samples, self.messages = [], []

    def ask(self, message):
        answers = self._take(self.receive(encode_message(message)))
        return answers[-1] if answers else None

    def receive(self, data):
        return self.device.receive(data, self.now_s, self.now_s)

    def stream(self, duration_s, step_s=0.05):
        first = len(self.samples)
        for _ in range(round(duration_s / step_s)):
            self.now_s += step_s
            self.receive(encode_message(messages.Ping(9)))
            self.tick()
        return TrackerSamples.join(self.samples[first:])

    def tick(self):
        now = self.now_s, self.now_s, self.waiting_bytes
        self._take(self.device.due(self.timeline, *now))

    def _take(self, data):
        decoded = self.decoder.feed(data)
        self.samples.append(decoded.samples)
        self.messages += decoded.messages
        return decoded.messages


def stream_of(*faults):

    wire = Wire(*faults)
    wire.ask(Start(1, 500.0))
    return wire


@pytest.fixture(scope="module")
def clean():

    return stream_of().stream(2.0)


def test_it_streams_long_or_short_frames_at_one_rate_at_a_time():
    device = stream_of()
    other_rate = device.ask(Start(2, 1000.0))  # is no restart
    assert isinstance(other_rate, messages.Nak)
    assert other_rate.code == messages.NakCode.BUSY
    assert device.ask(Stop(4)) == messages.Ack(4, 0x22)
    device.ask(Start(5, 500.0, messages.Format.MEAS))
    short = device.stream(0.5)
    assert len(short) > 200
    assert not short.status.any()


def test_it_sees_the_machine_move_evenly_timed_on_its_own_clock():
    device = stream_of()
    path = Program(np.array([[200.0, 150, 75]]), np.array([100.0]), np.zeros(1))
    device.timeline = make_program_timeline(path, np.full(3, 100.0), 1.0, Limits())
    samples = device.stream(1.5)
    np.testing.assert_array_equal(np.diff(samples.sequence), 1)
    np.testing.assert_allclose(np.diff(samples.device_time_s), 0.002, atol=1.1e-6)
    assert not samples.status.any()
    assert samples.device_time_s[0] == pytest.approx(CLOCK.device_s(1.0), abs=2e-6)
    assert samples.device_time_s[-1] <= CLOCK.device_s(device.now_s)
    assert CLOCK.device_s(device.now_s) - samples.device_time_s[-1] < 0.0021
    told = [m for m in device.messages if isinstance(m, messages.Status)]
    assert len(told) == 3  # twice a second
    assert told[-1].frames_sent == pytest.approx(500, abs=30)
    parts = device.parts
    moments = CLOCK.true_s(samples.device_time_s)
    seen = parts.truth.locate_target_mm(device.timeline.positions(moments))
    off = samples.position_mm - parts.pose.from_table(seen)
    assert 1e-3 < off.std() < 6e-3
    assert np.abs(off).max() < 0.03


@pytest.mark.parametrize("step_s", [0.05, 0.008, 0.5])
def test_samples_are_those_of_the_seed_however_often_it_is_asked(clean, step_s):
    again = stream_of().stream(1.0, step_s)
    n = len(again)
    assert n > 200
    np.testing.assert_allclose(again.position_mm, clean.position_mm[:n], atol=1e-9)
    if step_s == 0.05:
        np.testing.assert_array_equal(again.position_mm, clean.position_mm[:n])


def test_each_stream_has_noise_of_its_own():
    device = stream_of()
    first = device.stream(2.0).position_mm
    device.ask(Stop(2))
    device.ask(Start(3, 500.0))
    second = device.stream(2.0).position_mm
    off = [part[:900] - part[:900].mean(0) for part in (first, second)]
    # It stands: what is left of a mean is noise, with the correlation of its air.
    alike = (off[0] * off[1]).sum() / np.sqrt((off[0] ** 2).sum() * (off[1] ** 2).sum())
    assert abs(alike) < 0.3
    assert off[0].std() == pytest.approx(off[1].std(), rel=0.3)


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (bytes([VERSION, 0x77, 5]), messages.NakCode.UNKNOWN_COMMAND),
        (bytes([VERSION + 1, 0x20, 5]), messages.NakCode.VERSION_NOT_SPOKEN),
        (bytes([VERSION, 0x20, 5, 9]), messages.NakCode.VERSION_NOT_SPOKEN),
        (bytes([VERSION, 0x21, 5, 1]), messages.NakCode.BAD_ARGUMENT),
        (bytes([VERSION, 0x21, 5, 0x20, 0xA1, 7, 0, 9]), messages.NakCode.BAD_ARGUMENT),
        (Start(5, 0.0), messages.NakCode.RATE_NOT_POSSIBLE),
        (Start(5, 5001.0), messages.NakCode.RATE_NOT_POSSIBLE),
    ],
)
def test_what_it_does_not_know_or_cannot_do_it_says_so(body, code):
    device = Wire()
    frame = encode_frame(body) if isinstance(body, bytes) else encode_message(body)
    (nak,) = device.decoder.feed(device.receive(frame)).messages
    assert isinstance(nak, messages.Nak)
    assert (nak.transaction, nak.code) == (5, code)


def test_without_a_ping_the_stream_ends_and_an_overflow_is_told_with_the_next_sample():
    device = stream_of()
    device.stream(0.5)
    device.waiting_bytes = BUFFER_BYTES + 1
    assert len(device.stream(0.2)) == 0
    device.waiting_bytes = 0
    assert len(device.stream(0.5)) > 0
    assert device.decoder.health.device_overflows == 1
    assert TrackerSamples.join(device.samples).lost == pytest.approx(100, abs=20)
    begun = len(device.samples)
    for _ in range(60):
        device.now_s += 0.1
        device.tick()
    assert not device.device.streaming
    stopped = [m for m in device.messages if isinstance(m, messages.Event)]
    assert [m.code for m in stopped] == [messages.EventCode.STREAM_STOPPED_NO_PING]
    total = sum(len(block) for block in device.samples[begun:])
    assert total == pytest.approx(2500, abs=55)


def test_silence_a_delay_and_damage_lose_what_they_say():
    device = stream_of("tracker:silence@0.5s+0.5s")
    steps = np.diff(device.stream(1.2).sequence)
    assert (np.count_nonzero(steps > 1), steps.max()) == (1, pytest.approx(251, abs=2))
    late = stream_of("tracker:delay@0.5s+0.5s")
    np.testing.assert_array_equal(np.diff(late.stream(1.2).sequence), 1)
    assert max(len(block) for block in late.samples) > 240
    device = stream_of("tracker:bit-flip@0s+2s*0.05")
    assert 30 < device.stream(2.5).lost < 70
    noisy = stream_of("tracker:noise@0.5s*2000")
    assert noisy.stream(1.0).lost <= 1
    assert noisy.decoder.health.skipped_bytes > 1000


@pytest.mark.parametrize(
    ("fault", "lost", "crc_errors"),
    [
        ("tracker:drop@1s", 1, 0),
        ("tracker:bit-flip@1s", 1, 1),
        ("tracker:lost-bytes@1s", 1, 1),
        ("tracker:duplicate@1s", 0, 0),
    ],
)
def test_one_bad_frame_costs_at_most_one_sample(clean, fault, lost, crc_errors):
    device = stream_of(fault)
    samples = device.stream(1.3)
    health = device.decoder.health
    assert samples.lost <= lost
    assert health.crc_errors <= crc_errors
    if lost:
        assert samples.lost + health.crc_errors + health.skipped_bytes >= 1
    kept = np.isin(clean.sequence, samples.sequence)
    np.testing.assert_array_equal(clean.position_mm[kept], samples.position_mm)


def test_broken_beams_are_invalid_and_told_and_a_spike_is_one_valid_sample_off(clean):
    device = stream_of("tracker:beam-break@0.5s+0.2s")
    samples = device.stream(1.0)
    broken = samples.status == codec.StatusBit.BEAM_BROKEN
    assert broken.sum() == pytest.approx(100, abs=2)
    events = [m.code for m in device.messages if isinstance(m, messages.Event)]
    assert events == [messages.EventCode.BEAM_BROKEN, messages.EventCode.BEAM_LOCKED]
    added = parse_fault("tracker:beam-break+0.1s")  # strikes now
    device.schedule.add(added, device.now_s)
    assert (device.stream(0.5).status != 0).sum() == pytest.approx(50, abs=2)
    spiky = stream_of("tracker:spike@600n*0.3").stream(1.5)
    off = np.linalg.norm(spiky.position_mm - clean.position_mm[: len(spiky)], axis=1)
    assert np.flatnonzero(off > 1e-9).tolist() == [600]
    assert (off[600], spiky.status[600]) == (pytest.approx(0.3), 0)


def test_another_device_speaks_another_version_and_a_mute_one_answers_nothing():
    other = Wire("tracker:wrong-identity").ask(messages.Hello(1)).detail
    assert other.maker == "Nobody"
    assert other.version != VERSION
    assert Wire("tracker:silence").ask(messages.Hello(1)) is None


def test_a_device_counts_all_time_but_that_of_a_suspension(hand_clock):
    clock = processes.AwakeClock(0.1, lambda: hand_clock.time_s)
    begin_s = clock()
    for _ in range(300):
        hand_clock.time_s += 0.01
        clock()
    assert clock() - begin_s == pytest.approx(3.0)
    hand_clock.time_s += 3600.0
    for _ in range(2):
        assert clock() - begin_s == pytest.approx(3.1)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("tracker:silence@12s+0.5s", Fault("tracker", "silence", 12.0, "s", 0.5, 0.0)),
        ("tracker:bit-flip@5s+9s*.1", Fault("tracker", "bit-flip", 5.0, "s", 9.0, 0.1)),
        ("tracker:spike@800n*.3", Fault("tracker", "spike", 800.0, "n", None, 0.3)),
        ("cnc:alarm@row5", Fault("cnc", "alarm", 5.0, "row", None, 1001.0)),
        ("cnc:feed-hold+2s", Fault("cnc", "feed-hold", None, "s", 2.0, 0.0)),
        ("cnc:wrong-identity", Fault("cnc", "wrong-identity")),
    ],
)
def test_a_fault_is_read_from_its_text(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    "text", ["", "tracker", "tracker:explode", "cnc:spike", "tracker:silence@12", "x:y"]
)
def test_what_is_not_understood_is_said(text):
    with pytest.raises(SimulatorError, match="fault"):
        parse_fault(text)


def struck(schedule, kind, time_s):
    hits = schedule.struck(kind, time_s, np.arange(len(time_s)))
    return [float(t) for _, mask in hits for t in time_s[mask]]


def test_time_counts_from_the_begin_or_from_when_a_fault_is_added():
    schedule = Schedule([parse_fault("tracker:silence@2s+1s")])
    moments = np.arange(0.0, 10.0, 0.5)
    assert struck(schedule, "silence", moments) == []
    schedule.begin(3.0)
    assert struck(schedule, "silence", moments) == [5.0, 5.5]
    lasting = Schedule([parse_fault("cnc:wrong-identity")])
    assert lasting.strikes("wrong-identity", 0.0)
    assert not lasting.strikes("silence", 0.0)
    schedule = Schedule([])
    schedule.add(parse_fault("tracker:silence+1s"), 50.0)
    schedule.add(parse_fault("tracker:delay@5s+1s"), 50.0)
    assert schedule.strikes("silence", 50.0)
    assert not schedule.strikes("silence", 51.0)
    assert not schedule.strikes("delay", 54.0)
    assert schedule.strikes("delay", 55.0)


def test_a_fault_can_begin_with_a_sample_or_a_row_and_strikes_once_without_a_duration():
    schedule = Schedule([parse_fault("tracker:drop@1s")])
    schedule.begin(0.0)
    assert struck(schedule, "drop", np.arange(0.0, 1.0, 0.25)) == []
    assert struck(schedule, "drop", np.arange(1.0, 2.0, 0.25)) == [1.0]
    assert struck(schedule, "drop", np.arange(2.0, 3.0, 0.25)) == []
    schedule = Schedule(map(parse_fault, ["tracker:spike@3n", "cnc:alarm@row2+9s"]))
    schedule.begin(0.0)
    assert struck(schedule, "spike", np.array([0.1, 0.2, 0.3, 0.4])) == [0.4]
    assert not schedule.strikes("alarm", 1.0, 1)
    assert schedule.strikes("alarm", 2.0, 2)
    assert schedule.strikes("alarm", 10.9, 3)
    assert not schedule.strikes("alarm", 11.1, 3)


def test_time_counts_anew_for_what_has_not_struck_yet():
    schedule = Schedule(map(parse_fault, ["tracker:silence@5s", "tracker:delay@1s"]))
    schedule.add(parse_fault("tracker:beam-break@5s"), 0.0)
    schedule.begin(0.0)
    assert schedule.strikes("delay", 2.0)
    schedule.start_over()
    assert not schedule.strikes("silence", 6.0)
    schedule.begin(6.0)
    assert not schedule.strikes("silence", 10.0)
    assert schedule.strikes("silence", 11.0)
    assert schedule.strikes("delay", 6.0)
    assert schedule.strikes("beam-break", 5.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--machine", "nowhere.json"], "nowhere.json"),
        (["--fault", "tracker:explode"], "explode"),
        (["--speed", "0"], "speed"),
        (["--speed", "nan"], "speed"),
        (["--seed", "-1"], "seed"),
        (["--tracker-port", "99999"], "tracker-port"),
        (["--modbus-port", "-5"], "modbus-port"),
        (["--error-scale", "inf"], "error-scale"),
        (["--protocol", "t2sa"], "over TCP alone"),
        (["--replay", "run.sqlite", "--fault", "tracker:silence"], "only repeats"),
    ],
)
def test_bad_input_is_exit_status_2_and_a_clear_line(options, said, capsys):
    try:
        status = main(options)
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert said in capsys.readouterr().err


def test_a_file_of_somebody_else_is_not_touched(tmp_path, capsys):
    file = tmp_path / "tracker"
    file.write_text("kept")
    assert main(["--links", str(tmp_path)]) == 2
    assert "exists" in capsys.readouterr().err
    assert file.read_text() == "kept"
