"""Messages and measurements against bytes that are made here, not by the codec."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker_peers import one_sample, raw_samples
from truepath_drivers.tracker.streaming import codec
from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import FrameReader, encode_frame

PAGE = Path(__file__).parents[4] / "docs" / "tracker-protocol.md"

u8 = st.integers(0, 255)
u16 = st.integers(0, 0xFFFF)
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
    acks(st.builds(gst.StreamInfo, rates, u16, u64), "START"),
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
    return [gst.parse_message(body) for body in FrameReader().feed(data)]


def test_the_page_shows_the_bytes_that_are_sent_and_they_decode_to_the_positions():
    for frame, meaning in zip(page_frames().values(), EXAMPLES, strict=True):
        if isinstance(meaning, codec.RawSamples):
            assert codec.encode_measurements(meaning) == frame
        else:
            assert gst.encode_message(meaning) == frame
            assert read_messages(frame) == [meaning]
    decoder = StreamDecoder()
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
    decoded = StreamDecoder().feed(encode_frame(bytes.fromhex(body)))
    assert (len(decoded.samples), decoded.messages) == (0, ())


@given(st.binary(min_size=1, max_size=60))
def test_no_body_breaks_the_decoder(body):
    decoder = StreamDecoder()
    decoder.feed(encode_frame(body))
    assert decoder.health.frames == 1


def test_short_frames_keep_10_nm_and_3_nrad():
    position_mm = np.random.default_rng(6).normal(0, 1500, (200, 3))
    number = np.arange(200)
    raw = raw_samples(gst.Format.MEAS, number, 2000 * number, position_mm)
    decoded = StreamDecoder().feed(codec.encode_measurements(raw)).samples
    np.testing.assert_allclose(decoded.position_mm, position_mm, atol=20e-6)
