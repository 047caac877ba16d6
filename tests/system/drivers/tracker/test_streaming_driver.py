"""The streaming tracker's driver against peers on a pseudo-terminal and over TCP."""

import threading
import time
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from tracker_peers import AnsweringPeer, LoopbackTracker, ScriptedPeer, read_samples
from truepath_drivers.interfaces import errors
from truepath_drivers.interfaces.records import Identity, LinkHealth, TrackerSamples
from truepath_drivers.tracker.streaming import codec, driver, link
from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.driver import StreamingTracker
from wires import PtyWire, TcpWire

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


@pytest.fixture(params=[PtyWire, TcpWire], ids=["serial", "tcp"])
def wire(request):
    wire = request.param()
    yield wire
    wire.unplug()


@pytest.fixture
def peer(wire):
    with LoopbackTracker(wire) as peer:
        yield peer


@pytest.fixture
def running(peer):
    with StreamingTracker(**peer.options) as tracker:
        tracker.start(500.0)
        yield tracker


def test_connect_start_read_stop_in_bytes(wire):
    with ScriptedPeer(wire, [*TABLE, (START_3, STARTED_3 + SAMPLE), STOP_4, STOP_5]):
        tracker = StreamingTracker(**wire.options)
        assert (tracker.take_link_bytes(), tracker.health) == (b"", LinkHealth())
        names = "Truepath", "GST simulator", "SIM-0001", "1.0"
        assert tracker.connect() == Identity(*names)
        tracker.start(500.0)
        samples = read_samples(tracker, 1)
        tracker.stop()
        tracker.close()
    level = 2500 * np.cos(0.25)
    expected = [level * np.cos(0.5), level * np.sin(0.5), -2500 * np.sin(0.25)]
    np.testing.assert_allclose(samples.position_mm, [expected], atol=1e-9)
    assert samples.device_time_s.tolist() == [1.002]


def test_a_refusal_carries_the_reason_of_the_device(wire):
    with (
        ScriptedPeer(wire, [*TABLE, (START_3, REFUSED_3), STOP_4]),
        StreamingTracker(**wire.options) as tracker,
    ):
        with pytest.raises(errors.Refused, match=r"no beam \(code 5\)") as refusal:
            tracker.start(500.0)
        assert refusal.value.code == gst.NakCode.NOT_READY


def test_samples_arrive_as_sent_and_the_bytes_decode_to_them(peer, running):
    samples = read_samples(running, 300)
    running.stop()
    samples = TrackerSamples.join([samples, running.read(0.0)])
    expected = peer.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=1e-9)
    assert samples.sequence.tolist() == list(range(len(samples)))
    np.testing.assert_allclose(np.diff(samples.device_time_s), 2e-3, atol=1e-9)
    again = codec.StreamDecoder().feed(running.take_link_bytes()).samples
    np.testing.assert_array_equal(again.sequence, samples.sequence)
    np.testing.assert_array_equal(again.position_mm, samples.position_mm)
    assert running.take_link_bytes() == b""
    running.close()
    assert running.health.frames >= 300
    assert running.health.crc_errors == 0


def test_short_frames_are_read_and_too_slow_a_line_is_warned_of(peer, caplog):
    options = {"baudrate": 115_200, **peer.options}
    with StreamingTracker(compact=True, **options) as tracker:
        tracker.start(500.0)
        samples = read_samples(tracker, 50)
    expected = peer.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=2e-5)
    with StreamingTracker(**options) as tracker:
        caplog.clear()
        tracker.start(500.0)
    assert ("the line has 115200" in caplog.text) == ("host" not in options)


@pytest.mark.fault_row(1)
def test_damaged_frames_are_lost_and_never_wrong(peer, running, measured):
    rng = np.random.default_rng(1)

    def damage(frames: bytes) -> bytes:
        data = bytearray(frames)
        data[int(rng.integers(len(data)))] ^= 0x10
        return bytes(data)

    peer.damage = damage
    samples = read_samples(running, 60)
    expected = peer.position_mm(samples.sequence)
    np.testing.assert_allclose(samples.position_mm, expected, atol=1e-9)
    assert samples.lost > 0
    assert running.health.crc_errors > 0
    measured(f"{running.health.crc_errors} bad frames refused, {len(samples)} right")


def test_what_nobody_takes_is_bounded_and_counted(peer, monkeypatch, until):
    monkeypatch.setattr(link, "QUEUED_FRAMES", 50)
    monkeypatch.setattr(link, "KEPT_BYTES", 1000)
    with StreamingTracker(**peer.options) as tracker:
        tracker.start(2000.0)
        until(lambda: peer.sent > 300)
        tracker.stop()
        samples = tracker.read(0.1)
        assert 48 <= len(samples) <= 50
        assert 0 < len(tracker.take_link_bytes()) <= 1000
        tracker.start(2000.0)
        after = read_samples(tracker, 1).sequence[0]
        assert after - samples.sequence[-1] - 1 > 200


def test_another_rate_stops_the_stream_or_is_refused(peer, running):
    for rate_hz in (0.0, -1.0, 5000.5, float("nan")):
        with pytest.raises(errors.Refused, match="up to 5000 Hz"):
            running.start(rate_hz)
    running.start(500.0)
    running.start(250.0)
    kinds = [type(c) for c in peer.commands if not isinstance(c, gst.Ping)]
    assert kinds[-5:] == [gst.Stop, gst.Start, gst.Start, gst.Stop, gst.Start]
    assert peer.rate_hz == 250.0
    peer.answered_rate_hz = 400.0
    with pytest.raises(errors.Refused, match="streams at 400 Hz, not at 500 Hz"):
        running.start(500.0)
    assert peer.rate_hz is None


def test_a_stream_left_behind_by_another_host_is_not_read(peer):
    with StreamingTracker(**peer.options) as first:
        first.start(500.0)
        peer.deaf_to = {gst.Stop}
    peer.deaf_to = set()
    with StreamingTracker(**peer.options) as tracker:
        assert peer.rate_hz is None
        assert len(tracker.read(0.05)) == 0
        assert tracker.take_link_bytes() == b""


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (lambda data: b"", errors.DeviceTimeout, r"no reply to HELLO in 0\.5 s"),
        (
            lambda data: b"$GPGGA,0.0*00\r\n",
            errors.WrongDevice,
            "this is the tracker's port",
        ),
        (lambda data: data, errors.WrongDevice, "own bytes come back"),
    ],
    ids=["silence", "another device", "loop-back plug"],
)
def test_what_is_no_tracker_is_told_within_half_a_second(wire, answer, error, said):
    with AnsweringPeer(wire, answer):
        begin = time.monotonic()
        with pytest.raises(error, match=said):
            StreamingTracker(**wire.options).connect()
        assert time.monotonic() - begin < 0.9


@pytest.mark.fault_row(7)
def test_another_version_or_serial_number_is_the_wrong_device(peer):
    tracker = StreamingTracker(serial_number="LB-2", **peer.options)
    with pytest.raises(errors.WrongDevice, match="instrument LB-1 answers, LB-2"):
        tracker.connect()
    right = StreamingTracker(serial_number="LB-1", **peer.options)
    assert right.connect().serial_number == "LB-1"
    right.close()
    peer.info = replace(peer.info, version=2)
    with pytest.raises(errors.WrongDevice, match="does not speak GST/1"):
        StreamingTracker(**peer.options).connect()
    peer.nak = gst.NakCode.VERSION_NOT_SPOKEN
    with pytest.raises(errors.WrongDevice, match="another version"):
        StreamingTracker(**peer.options).connect()


def test_a_lost_reply_is_asked_for_again_and_another_one_ignored(peer, until):
    with StreamingTracker(**peer.options) as tracker:
        peer.deaf_to = {gst.Start}
        starter = threading.Thread(target=tracker.start, args=(500.0,))
        starter.start()
        until(lambda: isinstance(peer.commands[-1], gst.Start))
        peer.deaf_to = set()
        starter.join()
        starts = [c for c in peer.commands if isinstance(c, gst.Start)]
        assert (len(starts), starts[0]) == (2, starts[1])
        assert len(read_samples(tracker, 10)) >= 10
        peer.deaf_to = {gst.Stop}
        for transaction in range(20, 25):
            peer.send(gst.Ack(transaction, gst.Type.STOP))
        with pytest.raises(errors.DeviceTimeout, match="no reply to STOP"):
            tracker.stop()
        peer.deaf_to = set()


def test_pings_keep_coming_and_events_are_no_samples(peer, monkeypatch, until, caplog):
    caplog.set_level("INFO")
    monkeypatch.setattr(link, "PING_PERIOD_S", 0.05)
    with StreamingTracker(**peer.options) as tracker:
        peer.send(gst.Status(1, 0, peer.sent, 0, 0))
        peer.send(gst.Event(gst.EventCode.BEAM_BROKEN, 5))
        peer.send(gst.Event(gst.EventCode.STREAM_STOPPED_NO_PING, 6))
        assert len(tracker.read(0.1)) == 0
        until(lambda: sum(isinstance(c, gst.Ping) for c in peer.commands) > 3)
    assert "event 1 at 5 µs" in caplog.text
    assert "event 3 at 6 µs" in caplog.text


@pytest.mark.fault_row(6)
def test_an_unplugged_port_is_a_lost_connection(peer, running, measured):
    read_samples(running, 10)
    peer.unplug()
    begin = time.monotonic()
    remedy = "check cable and power, then connect"
    with pytest.raises(errors.ConnectionLost, match=remedy):
        read_samples(running, 10_000)
    took_s = time.monotonic() - begin
    assert took_s < 1.0
    measured(f"told after {took_s:.2f} s")
    with pytest.raises(errors.ConnectionLost):
        running.start(500.0)
    running.stop()
    running.close()
    with pytest.raises(errors.ConnectionLost):
        running.connect()


def test_samples_before_the_loss_of_the_port_are_still_read(peer, running, until):
    until(lambda: peer.sent > 30)
    peer.halt()
    replies = 3  # to HELLO, STOP and START
    until(lambda: running.health.frames >= peer.sent + replies)
    peer.unplug()
    until(lambda: running._receiver.error is not None)
    assert len(running.read(0.1)) == peer.sent
    with pytest.raises(errors.ConnectionLost):
        running.read(0.1)


def test_a_port_that_is_none_says_what_to_do(free_port):
    with pytest.raises(errors.ConnectionLost, match="plug the cable in"):
        StreamingTracker("/dev/tty-that-is-not-there").connect()
    with pytest.raises(errors.ConnectionLost, match="check address, port number"):
        StreamingTracker(host="127.0.0.1", port=free_port).connect()
    with pytest.raises(ValueError, match="give its host"):
        StreamingTracker(4711)


def test_the_driver_connects_again_after_a_loss(running, monkeypatch):
    read_samples(running, 10)
    with monkeypatch.context() as patch:
        pulled = Mock(side_effect=errors.ConnectionLost("pulled"))
        patch.setattr(type(running._port), "read", pulled)
        with pytest.raises(errors.ConnectionLost, match="pulled"):
            read_samples(running, 10_000)
    running.connect()
    running.start(500.0)
    assert read_samples(running, 10).sequence[0] == 0


def test_a_link_that_takes_no_bytes_ends_neither_reading_nor_stop_nor_close(
    peer, running, monkeypatch, caplog, until
):
    with monkeypatch.context() as patch:
        patch.setattr(link, "PING_PERIOD_S", 0.02)
        stuck = Mock(side_effect=errors.DeviceTimeout("takes no bytes"))
        patch.setattr(running._port, "write", stuck)
        until(lambda: "keep-alive not sent" in caplog.text)
        assert len(read_samples(running, 20)) >= 20
    with monkeypatch.context() as patch:
        hung_up = Mock(side_effect=errors.ConnectionLost("it hung up"))
        patch.setattr(running._port, "write", hung_up)
        running.stop()
    assert "stop not sent: it hung up" in caplog.text
    peer.silent = True
    running.close()
    assert "no reply to STOP" in caplog.text


def test_a_clock_that_falls_back_is_named_and_no_silence(peer, running, monkeypatch):
    read_samples(running, 50)
    monkeypatch.setattr(driver, "_STALE_S", 0.2)
    monkeypatch.setattr(peer, "_clock_us", lambda number: np.asarray(number) * 2000)
    with pytest.raises(errors.ConnectionLost, match="clock has fallen back"):
        read_samples(running, 1000)
    running.stop()
