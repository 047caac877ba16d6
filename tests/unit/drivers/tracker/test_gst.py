"""GST/1: laws of its frames, messages against bytes, laws of the stream."""

import re
import struct
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracker_peers import one_sample, raw_samples
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker_records import TrackerEventKind
from truepath_drivers.tracker.bridge import gst_bridge
from truepath_drivers.tracker.streaming import codec, driver, framing
from truepath_drivers.tracker.streaming import messages as gst

bodies = st.binary(min_size=1, max_size=framing.MAX_BODY)


def reference_cobs(data: bytes) -> bytes:
    """Write the encoder of the 1999 paper byte by byte, unlike the code under test."""
    out = bytearray([0])
    code_at = 0
    for byte in data:
        if byte == 0:
            out[code_at] = len(out) - code_at
            code_at = len(out)
            out.append(0)
            continue
        out.append(byte)
        if len(out) - code_at == 255:
            out[code_at] = 255
            code_at = len(out)
            out.append(0)
    out[code_at] = len(out) - code_at
    return bytes(out)


@given(st.binary(max_size=2000))
def test_stuffing_is_that_of_the_paper_holds_no_zero_and_comes_back(data):
    stuffed = framing.cobs_encode(data)
    assert stuffed == reference_cobs(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + 1 + len(data) // 254
    assert framing.cobs_decode(stuffed) == data


@pytest.mark.parametrize("broken", ["05 11", "02", "02 11 00 01", "ff 01"])
def test_stuffing_that_ends_early_or_holds_a_zero_is_refused(broken):
    assert framing.cobs_decode(bytes.fromhex(broken)) is None


def test_the_crc_is_the_usual_one_over_a_body_that_readers_take():
    body = b"123456789"
    expected = b"\0" + reference_cobs(body + struct.pack("<I", 0xCBF43926)) + b"\0"
    assert framing.encode_frame(body) == expected
    with pytest.raises(ValueError, match="at most 500 bytes"):
        framing.encode_frame(bytes(framing.MAX_BODY + 1))


@pytest.mark.parametrize("size", [1, 3, 44, 253, 254, 255, 300, 496])
def test_frames_of_the_bridge_kit_are_those_of_the_driver(size, rng):
    for body in (rng.bytes(size), bytes(size), b"\x01" * size):
        frame = gst_bridge.encode_frame(body)
        assert framing.check_frame(frame.strip(b"\0")) == body
        assert len(frame) <= len(framing.encode_frame(body)) + 1


@given(
    st.lists(bodies, min_size=1, max_size=6),
    st.integers(0, 10_000),
    st.one_of(st.none(), st.integers(1, 255)),
)
def test_a_lost_or_damaged_byte_costs_at_most_one_frame(sent, place, damage):
    wire = bytearray(b"".join(map(framing.encode_frame, sent)))
    at = place % len(wire)
    wire[at : at + 1] = b"" if damage is None else bytes([wire[at] ^ damage])
    received = framing.FrameReader().feed(bytes(wire))
    rest = iter(sent)  # what was received is in it, in this order
    assert all(any(item == other for other in rest) for item in received)
    assert len(received) >= len(sent) - 1


@given(
    st.lists(bodies, min_size=1, max_size=5),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 7)), max_size=40),
)
@pytest.mark.fault_row(1)
def test_flipped_bits_never_make_a_body_that_was_not_sent(sent, flips):
    wire = bytearray(b"".join(map(framing.encode_frame, sent)))
    for place, bit in flips:
        wire[place % len(wire)] ^= 1 << bit
    assert set(framing.FrameReader().feed(bytes(wire))) <= set(sent)


@given(st.lists(bodies, min_size=1, max_size=4), st.binary(max_size=300))
def test_after_noise_the_next_frame_is_whole(sent, noise):
    reader = framing.FrameReader()
    wire = b"".join(map(framing.encode_frame, sent))
    received = reader.feed(wire + noise + wire)
    assert (received[: len(sent)], received[-len(sent) :]) == (sent, sent)
    assert len(received) == 2 * len(sent)


def test_joining_in_the_middle_of_a_frame_is_no_crc_error():
    wire = framing.encode_frame(b"first frame") + framing.encode_frame(b"second")
    reader = framing.FrameReader()
    assert reader.feed(wire[5:]) == [b"second"]
    assert reader.crc_errors == 0
    assert reader.skipped_bytes == len(wire[5:].split(b"\0")[0])


@pytest.mark.parametrize(("body", "flip"), [(b"a body", 1), (b"", 0)])
def test_a_frame_whose_crc_is_wrong_or_all_there_is_is_counted(body, flip):
    stuffed = framing.cobs_encode(body + struct.pack("<I", zlib.crc32(body) ^ flip))
    reader = framing.FrameReader()
    assert reader.feed(b"\0" + stuffed + b"\0") == []
    assert (reader.frames, reader.crc_errors) == (0, 1)
    assert reader.skipped_bytes == len(stuffed)


@pytest.mark.fault_row(3)
def test_a_megabyte_of_noise_without_a_delimiter_takes_no_memory(measured):
    noise = np.random.default_rng(3).integers(1, 256, 1 << 20, np.uint8).tobytes()
    reader = framing.FrameReader()
    reader.feed(b"\0")
    tracemalloc.start()
    for at in range(0, len(noise), 4096):
        assert reader.feed(noise[at : at + 4096]) == []
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 64 * 1024
    measured(f"at most {peak / 1024:.0f} kB held")
    assert reader.feed(framing.encode_frame(b"after it")) == [b"after it"]
    assert (reader.crc_errors, reader.skipped_bytes) == (1, len(noise))


@given(st.integers(1, 40), st.integers(0, 2 * framing.MAX_FRAME))
def test_counts_do_not_depend_on_how_noise_is_cut(step, length):
    noise = b"\x55" * (framing.MAX_FRAME - 5 + length % 11)
    wire = b"\0" + noise + b"\0" + framing.encode_frame(b"x")
    whole, pieces = framing.FrameReader(), framing.FrameReader()
    whole.feed(wire)
    for at in range(0, len(wire), step):
        pieces.feed(wire[at : at + step])
    counts = [(r.frames, r.crc_errors, r.skipped_bytes) for r in (whole, pieces)]
    assert counts[0] == counts[1]


PAGE = Path(__file__).parents[4] / "docs" / "tracker-protocol.md"

u8 = st.integers(0, 255)
u32 = st.integers(0, 0xFFFFFFFF)
u64 = st.integers(0, 2**64 - 1)
rates = st.integers(1, 10_000_000).map(lambda mhz: mhz / 1000)
texts = st.text("aZ 0é€😀", max_size=15)  # of one to four bytes
angles = st.floats(-7.0, 7.0)
infos = st.builds(gst.DeviceInfo, texts, texts, texts, texts, rates, u8)


def acks(told, *names: str):
    kinds = st.sampled_from([int(gst.Type[name]) for name in names])
    return st.builds(gst.Ack, u8, kinds, told)


messages = st.one_of(
    st.builds(gst.Hello, u8, u8),
    st.builds(gst.Start, u8, rates, st.sampled_from(gst.Format)),
    *(st.builds(k, u8) for k in (gst.Stop, gst.Home, gst.Search, gst.GetAir, gst.Ping)),
    st.builds(gst.Aim, u8, angles, angles),
    st.builds(gst.Select, u8, texts),
    st.builds(gst.SetAir, u8, angles, angles, angles),
    acks(st.builds(gst.AirInUse, angles, angles, angles), "SET_AIR", "GET_AIR"),
    acks(infos, "HELLO"),
    acks(st.builds(gst.StreamInfo, rates, st.integers(0, 0xFFFF), u64), "START"),
    acks(st.none(), "STOP", "PING"),
    st.builds(gst.Nak, u8, u8, u8, texts),
    st.builds(gst.Status, u8, u64, u32, u32, u32),
    st.builds(gst.Event, u8, u64),
)


def page_frames() -> dict[str, bytes]:
    section = PAGE.read_text().split("<!-- examples -->")[1]
    rows = re.findall(r"^\| (.+?) \| `([0-9a-f ]+)` \|$", section, flags=re.M)
    return {name: bytes.fromhex(digits) for name, digits in rows}


WHO = gst.DeviceInfo("Truepath", "GST simulator", "SIM-0001", "1.0", 5000.0)
EXAMPLES = [
    gst.Hello(1),
    gst.Ack(1, gst.Type.HELLO, WHO),
    gst.Start(2, 500.0),
    gst.Ack(2, gst.Type.START, gst.StreamInfo(500.0, 258, 1_000_000)),
    one_sample(gst.Format.MEAS64, 258, 1_002_000, (2.5, 0.5, -0.25), 0, 200),
    one_sample(gst.Format.MEAS, 259, 1_004_000, (2.5, np.pi / 4, -np.pi / 8), 1, 7),
    gst.Ping(3),
    gst.Event(gst.EventCode.BEAM_BROKEN, 1_006_000),
    gst.Status(1, 1_500_000, 250, 2, 47),
    gst.Stop(4),
    gst.Ack(4, gst.Type.STOP),
    gst.Nak(5, gst.Type.START, gst.NakCode.RATE_NOT_POSSIBLE, "up to 5000 Hz"),
]


def read_messages(data: bytes):
    return [gst.parse_message(body) for body in framing.FrameReader().feed(data)]


def test_the_page_shows_the_bytes_that_are_sent_and_they_decode_to_the_positions():
    for frame, meaning in zip(page_frames().values(), EXAMPLES, strict=True):
        if isinstance(meaning, codec.RawSamples):
            assert codec.encode_measurements(meaning) == frame
        else:
            assert gst.encode_message(meaning) == frame
            assert read_messages(frame) == [meaning]
    decoder = codec.StreamDecoder()
    samples = decoder.feed(b"".join(page_frames().values())).samples
    level = 2500 * np.cos(0.25)
    first = [level * np.cos(0.5), level * np.sin(0.5), -2500 * np.sin(0.25)]
    short = 2500 * np.cos(np.pi / 8) * np.sqrt(0.5)
    second = [short, short, -2500 * np.sin(np.pi / 8)]
    np.testing.assert_allclose(samples.position_mm, [first, second], atol=1e-9)
    assert samples.sequence.tolist() == [0, 1]
    assert samples.device_time_s.tolist() == [1.002, 1.004]
    assert (samples.status.tolist(), decoder.health.frames) == ([0, 1], len(EXAMPLES))


@given(messages)
def test_a_message_comes_back_as_it_was_sent(message):
    assert read_messages(gst.encode_message(message)) == [message]


@given(st.text(min_size=61, max_size=80))
def test_a_text_that_is_too_long_is_cut_at_a_character(text):
    (nak,) = read_messages(gst.encode_message(gst.Nak(1, 2, 3, text)))
    assert text.startswith(nak.text)
    assert 57 <= len(nak.text.encode()) <= 60


@pytest.mark.parametrize(
    "body",
    [
        "",
        "01",
        "02 23 03",  # another version
        "01 7f 03",  # an unknown type
        "01 23",  # too short
        "01 23 03 04",  # too long
        "01 21 02 20 a1 07 00 09",  # a format that nobody knows
        "01 30 01",  # half a reply
        "01 30 01 20 01 40 4b 4c 00 05 61",  # a text shorter than its length
        "01 30 01 20 01 40 4b 4c 00 00 00 00 00 00",  # bytes after the last text
        "01 30 01 20 01 40 4b 4c 00 01 ff 00 00 00",  # no UTF-8
        "01 30 01 21 00",  # an ACK of a START without its details
        "01 31 01 21",  # a NAK without a code
        "01 31 01 21 03",  # a NAK without a text
        "01 14" + 30 * " 00",  # a measurement of the wrong length
    ],
)
def test_bodies_that_are_not_known_are_skipped(body):
    decoded = codec.StreamDecoder().feed(framing.encode_frame(bytes.fromhex(body)))
    assert (len(decoded.samples), decoded.messages) == (0, ())


@given(st.binary(min_size=1, max_size=60))
def test_no_body_breaks_the_decoder(body):
    decoder = codec.StreamDecoder()
    decoder.feed(framing.encode_frame(body))
    assert decoder.health.frames == 1


def test_short_frames_keep_10_nm_and_3_nrad():
    position_mm = np.random.default_rng(6).normal(0, 1500, (200, 3))
    number = np.arange(200)
    raw = raw_samples(gst.Format.MEAS, number, 2000 * number, position_mm)
    decoded = codec.StreamDecoder().feed(codec.encode_measurements(raw)).samples
    np.testing.assert_allclose(decoded.position_mm, position_mm, atol=20e-6)


PERIOD_US = 2000
FORMATS = [gst.Format.MEAS64, gst.Format.MEAS]


def stream(number, *, measured=gst.Format.MEAS64, first_clock_us=5000000, status=0):
    """Return one frame for each whole sample number; its position tells the number."""
    number = np.asarray(number, np.int64)
    clock_us, place_mm = first_clock_us + number * PERIOD_US, positions(number)
    rows = raw_samples(measured, number, clock_us, place_mm, status, number % 251)
    frames = codec.encode_measurements(rows).strip(b"\0").split(b"\0\0")
    return [b"\0" + frame + b"\0" for frame in frames]


def positions(number):
    return np.stack([1000 + 0.5 * number, -200 + 0.25 * number, number % 97], axis=1)


def started(sequence=0, clock_us=4999000, rate_hz=500.0):
    info = gst.StreamInfo(rate_hz, sequence, clock_us)
    return gst.encode_message(gst.Ack(1, gst.Type.START, info))


def decoded(pieces):
    decoder = codec.StreamDecoder()
    return decoder.feed(b"".join(pieces)).samples, decoder


def assert_every_sample_is_the_one_sent(samples, offset=0):
    number = samples.sequence + offset
    np.testing.assert_allclose(samples.position_mm, positions(number), atol=1e-6)
    clock = 5.0 + number * PERIOD_US * 1e-6
    np.testing.assert_allclose(samples.device_time_s, clock, atol=1e-9)


@pytest.mark.parametrize("measured", FORMATS)
def test_numbers_go_on_over_the_wrap_of_sixteen_bits(measured):
    number = np.arange(65_400, 65_900)
    samples, _ = decoded(stream(number, measured=measured))
    assert samples.sequence.tolist() == list(range(500))
    np.testing.assert_allclose(samples.position_mm, positions(number), atol=1e-4)


def test_times_go_on_over_the_wrap_of_the_short_clock_and_keep_their_microseconds():
    short, first_us = {"measured": gst.Format.MEAS}, 2**32 - 50 * PERIOD_US
    samples, _ = decoded(stream(np.arange(100), first_clock_us=first_us, **short))
    np.testing.assert_allclose(np.diff(samples.device_time_s), PERIOD_US * 1e-6)
    clock_us = 3 * 2**32 + 5_000_000
    frames = stream(np.arange(3), first_clock_us=clock_us, **short)
    samples, _ = decoded([started(clock_us=clock_us - 1000), *frames])
    assert samples.device_time_s[0] == pytest.approx(clock_us * 1e-6, abs=1e-9)
    years_us = 3 * 365 * 86_400 * 1_000_000
    samples, _ = decoded(stream(np.arange(10), first_clock_us=years_us))
    np.testing.assert_allclose(np.diff(samples.device_time_s), 2e-3, atol=1e-7)


@given(
    st.lists(st.integers(0, 299), max_size=60, unique=True),
    st.lists(st.integers(1, 400), max_size=30),
    st.sampled_from(FORMATS),
)
@settings(max_examples=30)
@pytest.mark.fault_row(2)
def test_any_split_and_any_loss_gives_the_samples_sent(lost, cuts, measured):
    kept = np.setdiff1d(np.arange(300), lost)
    wire = started() + b"".join(stream(kept, measured=measured))
    decoder = codec.StreamDecoder()
    blocks, at = [], 0
    for size in cuts:
        blocks.append(decoder.feed(wire[at : at + size]).samples)
        at += size
    blocks.append(decoder.feed(wire[at:]).samples)
    samples = TrackerSamples.join(blocks)
    assert samples.sequence.tolist() == kept.tolist()
    np.testing.assert_allclose(samples.position_mm, positions(kept), atol=2e-4)


@pytest.mark.parametrize("gap", [1, 2, 500, 65_535, 65_536, 65_537, 200_000, 1_000_000])
@pytest.mark.parametrize("with_start", [True, False])
def test_gaps_of_any_length_are_counted_by_the_clock(gap, with_start):
    number = np.concatenate([np.arange(50), 50 + gap + np.arange(50)])
    samples, _ = decoded([started()] * with_start + stream(number))
    assert samples.lost == gap
    assert samples.sequence.tolist() == number.tolist()
    assert_every_sample_is_the_one_sent(samples)


@pytest.mark.fault_row(2)
def test_repeated_and_late_frames_are_left_out():
    frames = stream(np.arange(20))
    order = [0, 1, 2, 2, 3, 5, 4, 6, 6, 6, 7, 1, *range(8, 20)]
    samples, _ = decoded([started(), *(frames[i] for i in order)])
    assert samples.sequence.tolist() == [i for i in range(20) if i != 4]
    assert_every_sample_is_the_one_sent(samples)


def test_before_the_rate_is_known_gaps_are_told_by_the_number_and_late_ones_left_out():
    samples, _ = decoded(stream(np.array([0, 40, 80])))
    assert samples.sequence.tolist() == [0, 40, 80]
    frames = stream(np.arange(0, 40, 2))
    samples, _ = decoded([frames[i] for i in (0, 2, 1, 1, 3)])
    assert samples.sequence.tolist() == [0, 4, 6]


@pytest.mark.parametrize(("first", "last"), [(0, 100), (0, 90), (15, 100)])
def test_a_pause_is_no_loss_but_what_is_missing_beside_it_is(first, last):
    again = started(sequence=100, clock_us=600_199_000)
    frames = stream(np.arange(100, 200), first_clock_us=600_000_000)
    wire = [started(), *stream(np.arange(first, last)), again, *frames]
    samples, _ = decoded(wire)
    assert samples.sequence.tolist() == [*range(first, last), *range(100, 200)]


def test_a_device_switched_off_and_on_goes_on_without_a_loss():
    again = started(sequence=0, clock_us=1000)
    frames = stream(np.arange(50), first_clock_us=2000)
    samples, _ = decoded([started(), *stream(np.arange(100)), again, *frames])
    assert samples.sequence.tolist() == list(range(150))
    assert samples.device_time_s[100] == pytest.approx(0.002)


@pytest.mark.parametrize("clock_us", [4_999_000, 5_000_000])  # that of the first, too
def test_a_start_repeated_in_mid_stream_changes_nothing(clock_us):
    frames = stream(np.arange(100))
    again = started(sequence=50, clock_us=5_000_000 + 49 * PERIOD_US + 7)
    wire = [started(clock_us=clock_us), *frames[:50], again, *frames[50:]]
    samples, _ = decoded(wire)
    assert samples.sequence.tolist() == list(range(100))
    assert_every_sample_is_the_one_sent(samples)


@pytest.mark.fault_row(3)
def test_noise_bursts_cost_only_the_frames_they_hit():
    rng = np.random.default_rng(11)
    frames = stream(np.arange(2500))
    hit = rng.random(2500) < 0.03
    for k in np.flatnonzero(hit):
        at = int(rng.integers(2, len(frames[k]) - 4))
        burst = rng.integers(0, 256, 3, np.uint8).tobytes()
        frames[k] = frames[k][:at] + burst + frames[k][at + 3 :]
    samples, decoder = decoded([started(), *frames])
    assert samples.sequence.tolist() == np.flatnonzero(~hit).tolist()
    assert decoder.health.crc_errors >= hit.sum()
    assert_every_sample_is_the_one_sent(samples)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", range(3), ids=["range", "azimuth", "elevation"])
@pytest.mark.fault_row(12)
def test_what_is_not_a_number_is_no_valid_sample(field, value):
    polar = [1.0, 0.1, 0.1]
    polar[field] = value
    raw = one_sample(gst.Format.MEAS64, 0, 1, polar, 0, 0)
    samples, _ = decoded([codec.encode_measurements(raw)])
    assert samples.status.tolist() == [int(codec.StatusBit.NOT_A_NUMBER)]
    assert samples.position_mm.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bit", list(codec.StatusBit))
def test_only_the_low_byte_of_the_status_forbids_use(bit):
    frames = stream(np.arange(3), status=int(bit))
    samples, decoder = decoded(frames)
    expected = int(bit) if bit < 0x100 else 0
    assert samples.status.tolist() == [expected] * 3
    assert decoder.health.device_overflows == (
        3 if bit is codec.StatusBit.OVERFLOW else 0
    )
    assert codec.StreamDecoder().feed(b"".join(frames)).status == bit  # passed on, too


@pytest.mark.fault_row(10)
def test_events_and_warnings_are_kept_for_whoever_asks():
    log = driver.EventLog()
    log.note(gst.Event(gst.EventCode.BEAM_BROKEN, 1_500_000))
    log.note(gst.Event(gst.EventCode.TRIGGER, 1_600_000))
    log.note_status(codec.StatusBit.NOT_LEVELLED | codec.StatusBit.BEAM_BROKEN)
    log.note_status(codec.StatusBit.NOT_LEVELLED)
    events = log.take()
    kinds = [TrackerEventKind.BEAM_LOST, TrackerEventKind.WARNING]
    assert [e.kind for e in events] == kinds
    assert [bool(e.action) for e in events] == [False, True]
    assert events[0].text == "the beam was broken at 1.500000 s"
    assert log.take() == ()


def test_the_strength_of_the_return_is_the_quality_of_a_sample():
    number, signal = np.arange(3), np.array([255, 51, 0])
    place_mm = positions(number)
    raw = raw_samples(gst.Format.MEAS64, number, 2000 * number, place_mm, 0, signal)
    told = decoded([codec.encode_measurements(raw)])[0].quality
    np.testing.assert_allclose(told, [1.0, 0.2, np.nan], rtol=1e-6)
    silent = replace(raw, signal=np.zeros(3, np.int64))
    samples, _ = decoded([codec.encode_measurements(silent)])
    assert samples.quality is None
    joined = TrackerSamples.join([samples, replace(samples, quality=told)])
    np.testing.assert_array_equal(joined.quality, [*[np.nan] * 3, *told])
