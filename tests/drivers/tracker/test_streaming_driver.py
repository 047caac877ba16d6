"""The streaming tracker's driver against peers on a pseudo-terminal and over TCP."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    Refused,
    WrongDevice,
)
from truepath_drivers.interfaces.records import Identity, LinkHealth, TrackerSamples
from truepath_drivers.tracker.streaming import driver, receiver
from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    Event,
    EventCode,
    NakCode,
    Ping,
    Start,
    Stop,
    Type,
)

TABLE = [
    # HELLO 1: version 1, 5000 Hz, Truepath, GST simulator, SIM-0001, 1.0
    (
        "00 09 01 20 01 01 4e ff a9 cf 00",
        "00 09 01 30 01 20 01 40 4b 4c 29 08 54 72 75 65 70 61 74 68 0d 47 53 54 20 73"
        "69 6d 75 6c 61 74 6f 72 08 53 49 4d 2d 30 30 30 31 03 31 2e 30 7a 5a 1f 07 00",
    ),
    ("00 08 01 22 02 29 94 3f b7 00", "00 09 01 30 02 22 8f 7e c5 5a 00"),  # STOP 2
]
START_3 = "00 07 01 21 03 20 a1 07 01 05 90 d8 8f 77 00"
STARTED_3 = "00 08 01 30 03 21 20 a1 07 06 02 01 40 42 0f 01 01 01 01 05 89 75 e2 c6 00"
REFUSED_3 = "00 12 01 31 03 21 05 07 6e 6f 20 62 65 61 6d a6 73 7d 57 00"
# Sample 258 at 1.002 s: 2.5 m, 0.5 rad, -0.25 rad
SAMPLE = (
    "00 08 01 14 02 01 10 4a 0f 01 01 01 01 01 01 01 01 01 01 03 04 40 01 01 01 01 01"
    "03 e0 3f 01 01 01 01 01 03 d0 bf 01 02 c8 05 85 5f 8b 5b 00"
)
STOP_4 = ("00 08 01 22 04 1c 31 5c 5e 00", "00 09 01 30 04 22 09 d9 9f 0c 00")
STOP_5 = ("00 08 01 22 05 8a 01 5b 29 00", "00 09 01 30 05 22 48 e8 84 15 00")


@pytest.fixture
def running_tracker(loopback_tracker):
    with StreamingTracker(**loopback_tracker.options) as tracker:
        tracker.start(500.0)
        yield tracker


def read_for(tracker: StreamingTracker, count: int) -> TrackerSamples:
    blocks: list[TrackerSamples] = []
    deadline = time.monotonic() + 10
    while sum(map(len, blocks)) < count:
        assert time.monotonic() < deadline
        blocks.append(tracker.read(0.5))
    return TrackerSamples.join(blocks)


def test_connect_start_read_stop_in_bytes(wire, scripted):
    table = [*TABLE, (START_3, STARTED_3 + SAMPLE), STOP_4, STOP_5]
    with scripted(wire, table) as peer:
        tracker = StreamingTracker(**peer.options)
        assert tracker.connect() == Identity(
            "Truepath", "GST simulator", "SIM-0001", "1.0"
        )
        tracker.start(500.0)
        samples = read_for(tracker, 1)
        tracker.stop()
        tracker.close()
        peer.halt()
        peer.finish()
    level = 2500 * np.cos(0.25)
    expected = [level * np.cos(0.5), level * np.sin(0.5), -2500 * np.sin(0.25)]
    np.testing.assert_allclose(samples.position_mm, [expected], atol=1e-9)
    assert samples.device_time_s.tolist() == [1.002]


def test_a_refusal_carries_the_reason_of_the_device(wire, scripted):
    with scripted(wire, [*TABLE, (START_3, REFUSED_3), STOP_4]) as peer:
        with StreamingTracker(**peer.options) as tracker:
            with pytest.raises(Refused, match=r"no beam \(code 5\)") as refusal:
                tracker.start(500.0)
            assert refusal.value.code == NakCode.NOT_READY
        peer.halt()
        peer.finish()


def test_every_sample_arrives_as_it_was_sent(loopback_tracker, running_tracker):
    samples = read_for(running_tracker, 300)
    expected = loopback_tracker.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=1e-9)
    assert samples.sequence.tolist() == list(range(len(samples)))
    np.testing.assert_allclose(np.diff(samples.device_time_s), 2e-3, atol=1e-9)
    assert running_tracker.health.lost_samples == 0
    assert running_tracker.health.crc_errors == 0


def test_short_frames_are_asked_for_and_read(loopback_tracker):
    with StreamingTracker(compact=True, **loopback_tracker.options) as tracker:
        tracker.start(500.0)
        samples = read_for(tracker, 50)
    expected = loopback_tracker.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=2e-5)


@pytest.mark.fault_row(1)
def test_damaged_frames_are_lost_and_never_wrong(
    loopback_tracker, running_tracker, measured
):
    rng = np.random.default_rng(1)

    def damage(frames: bytes) -> bytes:
        data = bytearray(frames)
        data[int(rng.integers(len(data)))] ^= 0x10
        return bytes(data)

    loopback_tracker.damage = damage
    samples = read_for(running_tracker, 60)
    expected = loopback_tracker.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=1e-9)
    assert running_tracker.health.lost_samples > 0
    assert running_tracker.health.crc_errors > 0
    measured(
        f"{running_tracker.health.crc_errors} bad frames refused, {len(samples)} right"
    )


def test_the_bytes_received_decode_to_the_same_samples(running_tracker):
    samples = read_for(running_tracker, 100)
    running_tracker.stop()
    samples = TrackerSamples.join([samples, running_tracker.read(0.0)])
    again = StreamDecoder().feed(running_tracker.take_link_bytes()).samples
    np.testing.assert_array_equal(again.sequence, samples.sequence)
    np.testing.assert_array_equal(again.position_mm, samples.position_mm)
    assert running_tracker.take_link_bytes() == b""


def test_bytes_that_nobody_takes_are_bounded(running_tracker, monkeypatch):
    monkeypatch.setattr(receiver, "KEPT_BYTES", 1000)
    read_for(running_tracker, 100)
    assert 0 < len(running_tracker.take_link_bytes()) <= 1000


def test_samples_that_nobody_reads_are_bounded_and_counted(
    loopback_tracker, monkeypatch, until
):
    monkeypatch.setattr(receiver, "QUEUED_FRAMES", 50)
    with StreamingTracker(**loopback_tracker.options) as tracker:
        tracker.start(2000.0)
        until(lambda: loopback_tracker.sent > 300)
        tracker.stop()
        samples = tracker.read(0.1)
        assert 48 <= len(samples) <= 50
        tracker.start(2000.0)
        after = read_for(tracker, 1).sequence[0]
        assert tracker.health.lost_samples == after - samples.sequence[-1] - 1 > 200


def test_silence_is_an_empty_block_within_the_timeout(
    loopback_tracker, running_tracker
):
    read_for(running_tracker, 10)
    loopback_tracker.silent = True
    running_tracker.read(0.1)
    begin = time.monotonic()
    assert len(running_tracker.read(0.2)) == 0
    assert 0.15 < time.monotonic() - begin < 1.0


def test_read_without_waiting_returns_at_once(running_tracker):
    begin = time.monotonic()
    running_tracker.read(0.0)
    assert time.monotonic() - begin < 0.1


def test_start_twice_is_one_start(loopback_tracker, running_tracker):
    read_for(running_tracker, 20)
    running_tracker.start(500.0)
    samples = read_for(running_tracker, 50)
    assert (np.diff(samples.sequence) == 1).all()
    assert running_tracker.health.lost_samples == 0
    assert loopback_tracker.rate_hz == 500.0


def test_start_at_another_rate_stops_first(loopback_tracker, running_tracker):
    running_tracker.start(250.0)
    kinds = [type(c) for c in loopback_tracker.commands if not isinstance(c, Ping)]
    assert kinds[-3:] == [Start, Stop, Start]
    assert loopback_tracker.rate_hz == 250.0


def test_after_stop_the_stream_goes_on_with_the_next_number(
    loopback_tracker, running_tracker
):
    before = read_for(running_tracker, 20)
    running_tracker.stop()
    rest = running_tracker.read(0.05)
    running_tracker.start(500.0)
    after = read_for(running_tracker, 20)
    sequence = TrackerSamples.join([before, rest, after]).sequence
    assert sequence.tolist() == list(range(len(sequence)))
    assert running_tracker.health.lost_samples == 0


def test_a_stream_left_behind_by_another_host_is_not_read(loopback_tracker):
    first = StreamingTracker(**loopback_tracker.options)
    first.connect()
    first.start(500.0)
    loopback_tracker.deaf_to = {Stop}
    first.close()
    loopback_tracker.deaf_to = set()
    with StreamingTracker(**loopback_tracker.options) as tracker:
        assert loopback_tracker.rate_hz is None
        assert len(tracker.read(0.05)) == 0
        assert tracker.take_link_bytes() == b""


def test_rates_beyond_the_instrument_are_refused_before_the_first_byte(
    loopback_tracker,
):
    with StreamingTracker(**loopback_tracker.options) as tracker:
        for rate_hz in (0.0, -1.0, 5000.5, float("nan")):
            with pytest.raises(Refused, match="up to 5000 Hz"):
                tracker.start(rate_hz)
        assert not any(isinstance(c, Start) for c in loopback_tracker.commands)


def test_a_rate_that_was_not_asked_for_is_refused(loopback_tracker):
    loopback_tracker.answered_rate_hz = 400.0
    with StreamingTracker(**loopback_tracker.options) as tracker:
        with pytest.raises(Refused, match="streams at 400 Hz, not at 500 Hz"):
            tracker.start(500.0)
        assert loopback_tracker.rate_hz is None


def test_a_line_too_slow_for_the_rate_is_warned_of(loopback_tracker, caplog):
    options = {"baudrate": 115_200, **loopback_tracker.options}
    with StreamingTracker(**options) as tracker:
        tracker.start(500.0)
    warned = "the line has 115200" in caplog.text
    assert warned == ("host" not in options)


def test_silence_is_a_timeout_within_half_a_second(wire, silent):
    with silent(wire) as peer:
        tracker = StreamingTracker(**peer.options)
        begin = time.monotonic()
        with pytest.raises(DeviceTimeout, match=r"no reply to HELLO in 0\.5 s"):
            tracker.connect()
        assert time.monotonic() - begin < 0.9


def test_a_device_of_another_kind_is_told_from_silence(wire, chatting):
    with (
        chatting(wire) as peer,
        pytest.raises(WrongDevice, match="check that this is the tracker's port"),
    ):
        StreamingTracker(**peer.options).connect()


def test_a_loop_back_plug_is_told_from_a_tracker(wire, echo):
    with echo(wire) as peer, pytest.raises(WrongDevice, match="own bytes come back"):
        StreamingTracker(**peer.options).connect()


@pytest.mark.fault_row(7)
def test_another_version_of_the_protocol_is_refused(loopback_tracker):
    loopback_tracker.info = replace(loopback_tracker.info, version=2)
    with pytest.raises(WrongDevice, match="does not speak GST/1"):
        StreamingTracker(**loopback_tracker.options).connect()


def test_a_device_that_refuses_the_version_is_the_wrong_one(loopback_tracker):
    loopback_tracker.nak = NakCode.VERSION_NOT_SPOKEN
    with pytest.raises(WrongDevice, match="another version"):
        StreamingTracker(**loopback_tracker.options).connect()


@pytest.mark.fault_row(7)
def test_another_serial_number_is_the_wrong_device(loopback_tracker):
    tracker = StreamingTracker(serial_number="LB-2", **loopback_tracker.options)
    with pytest.raises(WrongDevice, match="instrument LB-1 answers, LB-2"):
        tracker.connect()
    right = StreamingTracker(serial_number="LB-1", **loopback_tracker.options)
    assert right.connect().serial_number == "LB-1"
    right.close()


def test_a_lost_reply_is_asked_for_again_with_the_same_number(loopback_tracker, until):
    with StreamingTracker(**loopback_tracker.options) as tracker:
        loopback_tracker.deaf_to = {Start}
        starter = threading.Thread(target=tracker.start, args=(500.0,))
        starter.start()
        until(lambda: isinstance(loopback_tracker.commands[-1], Start))
        loopback_tracker.deaf_to = set()
        starter.join()
        starts = [c for c in loopback_tracker.commands if isinstance(c, Start)]
        assert len(starts) == 2
        assert starts[0] == starts[1]
        assert len(read_for(tracker, 10)) >= 10


def test_replies_to_other_transactions_are_ignored(loopback_tracker):
    with StreamingTracker(**loopback_tracker.options) as tracker:
        loopback_tracker.deaf_to = {Stop}
        for transaction in range(20, 25):
            loopback_tracker.send(Ack(transaction, Type.STOP))
        with pytest.raises(DeviceTimeout, match="no reply to STOP"):
            tracker.stop()
        loopback_tracker.deaf_to = set()


def test_pings_keep_coming_while_nothing_else_happens(
    loopback_tracker, monkeypatch, until
):
    monkeypatch.setattr(receiver, "PING_PERIOD_S", 0.05)
    with StreamingTracker(**loopback_tracker.options):
        until(lambda: sum(isinstance(c, Ping) for c in loopback_tracker.commands) > 3)


def test_events_and_status_are_no_samples(loopback_tracker, caplog):
    caplog.set_level("INFO")
    with StreamingTracker(**loopback_tracker.options) as tracker:
        loopback_tracker.send(loopback_tracker.status_frame())
        loopback_tracker.send(Event(EventCode.BEAM_BROKEN, 5))
        loopback_tracker.send(Event(EventCode.STREAM_STOPPED_NO_PING, 6))
        assert len(tracker.read(0.1)) == 0
    assert "event 1 at 5 µs" in caplog.text
    assert "event 3 at 6 µs" in caplog.text


@pytest.mark.fault_row(6)
def test_an_unplugged_port_is_a_lost_connection(
    loopback_tracker, running_tracker, measured
):
    read_for(running_tracker, 10)
    loopback_tracker.unplug()
    begin = time.monotonic()
    with pytest.raises(ConnectionLost, match="check cable and power, then connect"):
        read_for(running_tracker, 10_000)
    took_s = time.monotonic() - begin
    assert took_s < 1.0
    measured(f"told after {took_s:.2f} s")
    with pytest.raises(ConnectionLost):
        running_tracker.start(500.0)
    running_tracker.stop()
    running_tracker.close()
    with pytest.raises(ConnectionLost):
        running_tracker.connect()


def test_samples_before_the_loss_of_the_port_are_still_read(
    loopback_tracker, running_tracker, until
):
    until(lambda: loopback_tracker.sent > 30)
    loopback_tracker.halt()
    replies = 3  # to HELLO, STOP and START
    until(lambda: running_tracker.health.frames >= loopback_tracker.sent + replies)
    loopback_tracker.unplug()
    until(lambda: running_tracker._receiver.error is not None)
    assert len(running_tracker.read(0.1)) == loopback_tracker.sent
    with pytest.raises(ConnectionLost):
        running_tracker.read(0.1)


def test_a_port_that_does_not_exist_says_what_to_do():
    with pytest.raises(ConnectionLost, match="plug the cable in"):
        StreamingTracker("/dev/tty-that-is-not-there").connect()


@pytest.mark.parametrize("wire", ["serial"], indirect=True)
def test_a_serial_port_in_use_says_so(loopback_tracker):
    with (
        StreamingTracker(**loopback_tracker.options),
        pytest.raises(ConnectionLost, match="another program uses it"),
    ):
        StreamingTracker(**loopback_tracker.options).connect()


def test_a_host_that_nobody_answers_says_what_to_do(free_port):
    with pytest.raises(ConnectionLost, match="check address, port number"):
        StreamingTracker(host="127.0.0.1", port=free_port).connect()


def test_a_port_number_without_a_host_is_a_mistake():
    with pytest.raises(ValueError, match="give its host"):
        StreamingTracker(4711)


def test_verbs_before_connect():
    tracker = StreamingTracker("/dev/null")
    tracker.stop()
    tracker.close()
    assert tracker.take_link_bytes() == b""
    assert tracker.health == LinkHealth()
    for verb in (lambda: tracker.start(500.0), lambda: tracker.read(0.0)):
        with pytest.raises(ConnectionLost, match="connect first"):
            verb()


def test_a_device_that_has_gone_silent_can_still_be_closed(
    loopback_tracker, running_tracker, caplog
):
    loopback_tracker.silent = True
    running_tracker.close()
    assert "no reply to STOP" in caplog.text


def test_stop_from_another_thread_ends_the_stream(loopback_tracker, running_tracker):
    stopper = threading.Thread(target=running_tracker.stop)
    stopper.start()
    while len(running_tracker.read(0.2)):
        pass
    stopper.join()
    assert loopback_tracker.rate_hz is None


def test_health_stays_after_close(running_tracker):
    read_for(running_tracker, 20)
    running_tracker.close()
    assert running_tracker.health.frames >= 20


def test_the_driver_connects_again_after_a_loss(loopback_tracker, wire, monkeypatch):
    with StreamingTracker(**loopback_tracker.options) as tracker:
        tracker.start(500.0)
        read_for(tracker, 10)
        with monkeypatch.context() as patch:
            patch.setattr(type(tracker._port), "read", _fail)
            with pytest.raises(ConnectionLost, match="pulled"):
                read_for(tracker, 10_000)
        tracker.connect()
        assert tracker.health.lost_samples == 0
        tracker.start(500.0)
        assert read_for(tracker, 10).sequence[0] == 0


def _fail(port, timeout_s):
    raise ConnectionLost("pulled")


def test_a_keep_alive_that_cannot_be_sent_does_not_end_the_reading(
    loopback_tracker, running_tracker, monkeypatch, caplog, until
):
    def stuck(data):
        raise DeviceTimeout("takes no bytes")

    with monkeypatch.context() as patch:
        patch.setattr(receiver, "PING_PERIOD_S", 0.02)
        patch.setattr(running_tracker._port, "write", stuck)
        until(lambda: "keep-alive not sent" in caplog.text)
        assert len(read_for(running_tracker, 20)) >= 20
    running_tracker.stop()


def test_stop_on_a_port_lost_in_that_moment_is_quiet(
    running_tracker, monkeypatch, caplog
):
    def gone(data):
        raise ConnectionLost("it hung up")

    with monkeypatch.context() as patch:
        patch.setattr(running_tracker._port, "write", gone)
        running_tracker.stop()
    assert "stop not sent: it hung up" in caplog.text


def test_a_clock_that_falls_back_is_named_and_no_silence(
    loopback_tracker, running_tracker, monkeypatch
):
    read_for(running_tracker, 50)
    monkeypatch.setattr(driver, "_STALE_S", 0.2)
    monkeypatch.setattr(
        loopback_tracker, "_clock_us", lambda number: np.asarray(number) * 2000
    )
    with pytest.raises(ConnectionLost, match="clock has fallen back"):
        read_for(running_tracker, 1000)
    running_tracker.stop()
