"""Laws of the stream: numbers, clocks, gaps, losses; never a wrong sample."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracker_peers import one_sample, raw_samples
from truepath_drivers.interfaces.records import TrackerSamples
from truepath_drivers.interfaces.tracker_records import TrackerEventKind
from truepath_drivers.tracker.streaming import codec, driver, messages
from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.codec import (
    StatusBit,
    encode_measurements,
)

PERIOD_US = 2000
FORMATS = [gst.Format.MEAS64, gst.Format.MEAS]


def stream(number, *, measured=gst.Format.MEAS64, first_clock_us=5000000, status=0):
    """Return one frame for each whole sample number; its position tells the number."""
    number = np.asarray(number, np.int64)
    clock_us, place_mm = first_clock_us + number * PERIOD_US, positions(number)
    rows = raw_samples(measured, number, clock_us, place_mm, status, number % 251)
    frames = encode_measurements(rows).strip(b"\0").split(b"\0\0")
    return [b"\0" + frame + b"\0" for frame in frames]


def positions(number):
    return np.stack([1000 + 0.5 * number, -200 + 0.25 * number, number % 97], axis=1)


def started(sequence=0, clock_us=4999000, rate_hz=500.0):
    info = gst.StreamInfo(rate_hz, sequence, clock_us)
    return messages.encode_message(gst.Ack(1, gst.Type.START, info))


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
    samples, _ = decoded([encode_measurements(raw)])
    assert samples.status.tolist() == [int(StatusBit.NOT_A_NUMBER)]
    assert samples.position_mm.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bit", list(StatusBit))
def test_only_the_low_byte_of_the_status_forbids_use(bit):
    frames = stream(np.arange(3), status=int(bit))
    samples, decoder = decoded(frames)
    expected = int(bit) if bit < 0x100 else 0
    assert samples.status.tolist() == [expected] * 3
    assert decoder.health.device_overflows == (3 if bit is StatusBit.OVERFLOW else 0)
    assert codec.StreamDecoder().feed(b"".join(frames)).status == bit  # passed on, too


@pytest.mark.fault_row(10)
def test_events_and_warnings_are_kept_for_whoever_asks():
    log = driver.EventLog()
    log.note(gst.Event(gst.EventCode.BEAM_BROKEN, 1_500_000))
    log.note(gst.Event(gst.EventCode.TRIGGER, 1_600_000))
    log.note_status(StatusBit.NOT_LEVELLED | StatusBit.BEAM_BROKEN)
    log.note_status(StatusBit.NOT_LEVELLED)
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
    told = decoded([encode_measurements(raw)])[0].quality
    np.testing.assert_allclose(told, [1.0, 0.2, np.nan], rtol=1e-6)
    silent = replace(raw, signal=np.zeros(3, np.int64))
    samples, _ = decoded([encode_measurements(silent)])
    assert samples.quality is None
    joined = TrackerSamples.join([samples, replace(samples, quality=told)])
    np.testing.assert_array_equal(joined.quality, [*[np.nan] * 3, *told])
