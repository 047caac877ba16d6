"""Laws of the frames: COBS, CRC, resynchronisation, bounded memory."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truepath_drivers.tracker.bridge import gst_bridge
from truepath_drivers.tracker.streaming import framing

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
