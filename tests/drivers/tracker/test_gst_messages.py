"""Messages and measurements against bytes that are made here, not by the codec."""

import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truepath_drivers.tracker.streaming.codec import StreamDecoder
from truepath_drivers.tracker.streaming.framing import FrameReader, encode_frame
from truepath_drivers.tracker.streaming.measurements import (
    RawSamples,
    encode_measurements,
    spherical_to_cartesian_mm,
)
from truepath_drivers.tracker.streaming.message_codec import (
    encode_message,
    parse_message,
)
from truepath_drivers.tracker.streaming.messages import (
    Ack,
    Aim,
    AirInUse,
    DeviceInfo,
    Event,
    EventCode,
    Format,
    GetAir,
    Hello,
    Home,
    Nak,
    NakCode,
    Ping,
    Search,
    Select,
    SetAir,
    Start,
    Status,
    Stop,
    StreamInfo,
    Type,
)
from truepath_simulators.machine.tracker_head import to_spherical

METRES = np.array([1e-3, 1.0, 1.0])  # ranges are sent in m
PAGE = Path(__file__).parents[3] / "docs" / "tracker-protocol.md"

u8 = st.integers(0, 255)
u16 = st.integers(0, 0xFFFF)
u32 = st.integers(0, 0xFFFFFFFF)
u64 = st.integers(0, 2**64 - 1)
rates = st.integers(1, 10_000_000).map(lambda mhz: mhz / 1000)
texts = st.text(max_size=15)
angles = st.floats(-7.0, 7.0)
infos = st.builds(DeviceInfo, texts, texts, texts, texts, rates, u8)
messages = st.one_of(
    st.builds(Hello, u8, u8),
    st.builds(Start, u8, rates, st.sampled_from(Format)),
    st.builds(Stop, u8),
    st.builds(Home, u8),
    st.builds(Aim, u8, angles, angles),
    st.builds(Search, u8),
    st.builds(Select, u8, texts),
    st.builds(SetAir, u8, angles, angles, angles),
    st.builds(GetAir, u8),
    st.builds(
        Ack,
        u8,
        st.sampled_from([int(Type.SET_AIR), int(Type.GET_AIR)]),
        st.builds(AirInUse, angles, angles, angles),
    ),
    st.builds(Ping, u8),
    st.builds(Ack, u8, st.just(int(Type.HELLO)), infos),
    st.builds(
        Ack, u8, st.just(int(Type.START)), st.builds(StreamInfo, rates, u16, u64)
    ),
    st.builds(Ack, u8, st.sampled_from([int(Type.STOP), int(Type.PING)])),
    st.builds(Nak, u8, u8, u8, texts),
    st.builds(Status, u8, u64, u32, u32, u32),
    st.builds(Event, u8, u64),
)


def page_frames() -> dict[str, bytes]:
    section = PAGE.read_text().split("<!-- examples -->")[1]
    rows = re.findall(r"^\| (.+?) \| `([0-9a-f ]+)` \|$", section, flags=re.M)
    return {name: bytes.fromhex(digits) for name, digits in rows}


EXAMPLES = [
    Hello(1),
    Ack(
        1,
        Type.HELLO,
        DeviceInfo("Truepath", "GST simulator", "SIM-0001", "1.0", 5000.0),
    ),
    Start(2, 500.0),
    Ack(2, Type.START, StreamInfo(500.0, 258, 1_000_000)),
    RawSamples(
        Format.MEAS64,
        np.array([258]),
        np.array([1_002_000], np.uint64),
        np.array([2.5]),
        np.array([0.5]),
        np.array([-0.25]),
        np.array([0]),
        np.array([200]),
    ),
    RawSamples(
        Format.MEAS,
        np.array([259]),
        np.array([1_004_000], np.uint64),
        np.array([2.5]),
        np.array([np.pi / 4]),
        np.array([-np.pi / 8]),
        np.array([1]),
        np.array([7]),
    ),
    Ping(3),
    Event(EventCode.BEAM_BROKEN, 1_006_000),
    Status(1, 1_500_000, 250, 2, 47),
    Stop(4),
    Ack(4, Type.STOP),
    Nak(5, Type.START, NakCode.RATE_NOT_POSSIBLE, "up to 5000 Hz"),
]


def read_messages(data: bytes):
    return [parse_message(body) for body in FrameReader().feed(data)]


@pytest.mark.parametrize(
    ("frame", "meaning"), list(zip(page_frames().values(), EXAMPLES, strict=True))
)
def test_the_page_shows_the_bytes_that_are_sent(frame, meaning):
    if isinstance(meaning, RawSamples):
        assert encode_measurements(meaning) == frame
    else:
        assert encode_message(meaning) == frame
        assert read_messages(frame) == [meaning]


def test_frames_of_the_page_decode_to_the_positions_they_name():
    decoder = StreamDecoder()
    samples = decoder.feed(b"".join(page_frames().values())).samples
    level = 2500 * np.cos(0.25)
    first = [level * np.cos(0.5), level * np.sin(0.5), -2500 * np.sin(0.25)]
    short = 2500 * np.cos(np.pi / 8) * np.sqrt(0.5)
    second = [short, short, -2500 * np.sin(np.pi / 8)]
    np.testing.assert_allclose(samples.position_mm, [first, second], atol=1e-9)
    assert samples.sequence.tolist() == [0, 1]
    assert samples.device_time_s.tolist() == [1.002, 1.004]
    assert samples.status.tolist() == [0, 1]
    assert decoder.health.frames == len(EXAMPLES)


def test_a_meas64_frame_built_by_struct_alone_decodes():
    fields = struct.pack("<BBHQ3dHBB", 1, 0x14, 7, 2_000_000, 1.5, 0.0, 0.0, 0, 9, 0)
    crc = struct.pack("<I", zlib.crc32(fields))
    body = fields + crc
    # One code byte, then every zero becomes the distance to the next one.
    zeros = [i for i, byte in enumerate(body) if byte == 0] + [len(body)]
    stuffed = bytearray(b"\0" + body)
    for before, after in zip([-1, *zeros], zeros, strict=False):
        stuffed[before + 1] = after - before
    samples = StreamDecoder().feed(b"\0" + bytes(stuffed) + b"\0").samples
    np.testing.assert_array_equal(samples.position_mm, [[1500.0, 0.0, 0.0]])
    assert samples.device_time_s.tolist() == [2.0]


@given(messages)
def test_a_message_comes_back_as_it_was_sent(message):
    assert read_messages(encode_message(message)) == [message]


@given(st.text(min_size=61, max_size=80))
def test_a_text_that_is_too_long_is_cut_at_a_character(text):
    (nak,) = read_messages(encode_message(Nak(1, 2, 3, text)))
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
    ],
)
def test_bodies_that_are_not_known_are_skipped(body):
    assert parse_message(bytes.fromhex(body)) is None


@given(st.binary(min_size=1, max_size=60))
def test_no_body_breaks_the_decoder(body):
    decoder = StreamDecoder()
    decoder.feed(encode_frame(body))
    assert decoder.health.frames == 1


def test_a_measurement_of_the_wrong_length_is_skipped():
    decoder = StreamDecoder()
    decoded = decoder.feed(encode_frame(b"\x01\x14" + bytes(30)))
    assert len(decoded.samples) == 0
    assert decoded.messages == ()


@pytest.mark.parametrize(
    ("azimuth_rad", "elevation_rad", "direction"),
    [
        (0.0, 0.0, [1, 0, 0]),
        (np.pi / 2, 0.0, [0, 1, 0]),
        (np.pi, 0.0, [-1, 0, 0]),
        (0.0, np.pi / 2, [0, 0, 1]),
        (np.pi / 2, -np.pi / 2, [0, 0, -1]),
    ],
)
def test_angles_point_where_the_page_says(azimuth_rad, elevation_rad, direction):
    position = spherical_to_cartesian_mm([2.0], [azimuth_rad], [elevation_rad])
    np.testing.assert_allclose(position, [np.multiply(direction, 2000.0)], atol=1e-9)


def test_positions_are_those_whose_range_and_angles_were_sent():
    position_mm = np.random.default_rng(5).normal(0, 3000, (500, 3))
    back = spherical_to_cartesian_mm(*(METRES * to_spherical(position_mm)).T)
    np.testing.assert_allclose(back, position_mm, atol=1e-8)


def test_short_frames_keep_10_nm_and_3_nrad():
    position_mm = np.random.default_rng(6).normal(0, 1500, (200, 3))
    raw = raw_samples(Format.MEAS, position_mm)
    decoded = StreamDecoder().feed(encode_measurements(raw)).samples
    np.testing.assert_allclose(decoded.position_mm, position_mm, atol=20e-6)


def raw_samples(measured: Format, position_mm: np.ndarray) -> RawSamples:
    n = len(position_mm)
    return RawSamples(
        measured,
        np.arange(n),
        (np.arange(n) * 2000).astype(np.uint64),
        *(METRES * to_spherical(position_mm)).T,
        np.zeros(n, np.int64),
        np.full(n, 200),
    )
