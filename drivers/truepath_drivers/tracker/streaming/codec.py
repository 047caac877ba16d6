"""Measurements of a GST/1 tracker: bytes to samples and messages, and back. No I/O.

Two stages, so that a reader thread can do the cheap one and leave the rest to others:
`FrameReader` cuts and checks frames as bytes come; `SampleDecoder` turns the bodies of
many frames into one block of samples. `StreamDecoder` is both in a row.

Azimuth is the right-handed angle about +z, zero on +x; elevation rises from the xy
plane towards +z:

    x = r cos(el) cos(az)    y = r cos(el) sin(az)    z = r sin(el)

`Unwrapper` unwraps counters, u16 sequence numbers and device clocks, over any gap. The
sequence alone cannot distinguish a loss of n samples from one of n + 65 536 (131 s at
500 Hz); the device clock can. With period T, clock step Δt, sequence step d (mod 2¹⁶)

    step = d + 2¹⁶ · round((Δt / T − d) / 2¹⁶)

A step below 1, or a clock that runs backwards, is a repeated or late frame: omitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truepath_drivers.interfaces.records import LinkHealth, TrackerSamples
from truepath_drivers.tracker.streaming.framing import FrameReader, encode_frame
from truepath_drivers.tracker.streaming.messages import (
    VERSION,
    Ack,
    Format,
    Message,
    StreamInfo,
    Type,
    parse_message,
)

_STRONGEST = 255.0
_CLOCK_BITS = {Format.MEAS64: 64, Format.MEAS: 32}


@dataclass(frozen=True, slots=True)
class Decoded:
    """Output of one call: samples of all measurements, other messages in order.

    status : all bits that any of the samples had, informative ones included
    """

    samples: TrackerSamples
    messages: tuple[Message, ...]
    status: int = 0


class SampleDecoder:
    """Turns bodies in order into samples with unwrapped numbers and device seconds.

    device_overflows : samples that follow an overflow inside the device
    stale : repeated or late measurements since the last one that was kept
    """

    def __init__(self) -> None:
        self.device_overflows = self.stale = 0
        self._unwrapper = Unwrapper()

    def decode(self, bodies: Sequence[bytes]) -> Decoded:
        """Samples and messages of bodies that `FrameReader` passed."""
        blocks: list[TrackerSamples] = []
        messages: list[Message] = []
        status = 0
        for measured, group in groupby(bodies, _measurement_type):
            if measured is not None:
                raw = parse_measurements(list(group))
                status |= int(np.bitwise_or.reduce(raw.status))
                blocks.append(self._samples(raw))
            else:
                messages += self._messages(group)
        return Decoded(TrackerSamples.join(blocks), tuple(messages), status)

    def _messages(self, bodies: Iterator[bytes]) -> list[Message]:
        messages: list[Message] = []
        for body in bodies:
            message = parse_message(body)
            if message is None:
                continue
            match message:
                case Ack(detail=StreamInfo(rate_hz, sequence, clock_us)):
                    self._unwrapper.begin(sequence, rate_hz, clock_us)
                case _:
                    pass
            messages.append(message)
        return messages

    def _samples(self, raw: RawSamples) -> TrackerSamples:
        sequence, clock_us, keep = self._unwrapper.advance(
            raw.sequence, raw.clock_us, _CLOCK_BITS[raw.format]
        )
        position_mm, status = _positions(raw)
        overflown = keep & ((raw.status & StatusBit.OVERFLOW) != 0)
        self.device_overflows += int(np.count_nonzero(overflown))
        after_kept = len(keep) - int(np.max(np.flatnonzero(keep), initial=-1)) - 1
        self.stale = after_kept + (0 if keep.any() else self.stale)
        return TrackerSamples(
            sequence[keep],
            np.true_divide(clock_us[keep], 1e6, dtype=np.float64),
            position_mm[keep],
            status[keep],
            _find_quality(raw.signal[keep]),
        )


class StreamDecoder:
    """Bytes to samples; any split of the bytes gives the same."""

    def __init__(self) -> None:
        self._frames = FrameReader()
        self._decoder = SampleDecoder()

    def feed(self, data: bytes) -> Decoded:
        """Add received bytes; gives what they complete."""
        return self._decoder.decode(self._frames.feed(data))

    @property
    def health(self) -> LinkHealth:
        return link_health(self._frames, self._decoder)


def link_health(frames: FrameReader, decoder: SampleDecoder) -> LinkHealth:
    """Counts of both stages as one record."""
    return LinkHealth(
        frames=frames.frames,
        crc_errors=frames.crc_errors,
        skipped_bytes=frames.skipped_bytes,
        device_overflows=decoder.device_overflows,
    )


def _measurement_type(body: bytes) -> int | None:
    return body[1] if is_measurement(body) else None


def _positions(raw: RawSamples) -> tuple[np.ndarray, np.ndarray]:
    """mm, and a status in which 0 is valid. Numbers that are not finite become 0, with
    a status that indicates it.
    """
    with np.errstate(invalid="ignore"):
        position_mm = spherical_to_cartesian_mm(
            raw.range_m, raw.azimuth_rad, raw.elevation_rad
        )
    finite = np.isfinite(position_mm).all(axis=1)
    position_mm[~finite] = 0.0
    status = raw.status & FORBIDS_USE
    return position_mm, np.where(finite, status, status | StatusBit.NOT_A_NUMBER)


def _find_quality(signal: NDArray[np.int64]) -> NDArray[np.float32] | None:
    """Fraction of full strength; None where none is reported."""
    if not signal.any():
        return None
    return np.where(signal > 0, signal / _STRONGEST, np.nan).astype(np.float32)


_TURN = 1 << 16


class Unwrapper:
    """Continues sequence numbers and microseconds from block to block of one stream."""

    def __init__(self) -> None:
        self._sequence = -1  # last one, unwrapped
        self._wrapped: int | None = None  # last one, as on the wire
        self._clock_us = 0
        self._period_us = 0.0
        self._fresh = True

    def begin(self, next_sequence: int, rate_hz: float, clock_us: int) -> None:
        """Set next number, rate and clock from the reply to a START."""
        missed = 0
        if self._wrapped is not None and clock_us >= self._clock_us:
            missed = (next_sequence - self._wrapped - 1) % _TURN
        # An earlier clock is that of a device switched off and on: nothing was missed.
        self._sequence += missed
        self._wrapped = (next_sequence - 1) % _TURN
        self._clock_us = clock_us
        self._period_us = 1e6 / rate_hz
        self._fresh = True

    def advance(
        self, wrapped: NDArray[np.int64], clock_us: NDArray[np.uint64], clock_bits: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Unwrapped numbers and microseconds, which samples to keep, (n,) each.

        wrapped, clock_us : (n,), n >= 1, as on the wire
        """
        if self._wrapped is None:
            self._wrapped = (int(wrapped[0]) - 1) % _TURN
            self._clock_us = int(clock_us[0])
        steps = np.diff(wrapped, prepend=self._wrapped) % _TURN
        ticks = _find_signed_steps(clock_us, self._clock_us, clock_bits)
        if not self._period_us:
            self._learn_period(steps, ticks)
        if self._is_plain(steps, ticks):
            sequence = self._sequence + np.arange(1, len(steps) + 1)
            clock = self._clock_us + np.cumsum(ticks)
            keep = np.ones(len(steps), np.bool_)
        else:
            sequence, clock, keep = self._one_by_one(steps, ticks)
        self._remember(wrapped, sequence, clock, keep)
        return sequence, clock, keep

    def _learn_period(self, steps: NDArray[np.int64], ticks: NDArray[np.int64]) -> None:
        """Median clock step of neighbours, where no START has given the rate."""
        neighbours = ticks[(steps == 1) & (ticks > 0)]
        if len(neighbours):
            self._period_us = float(np.median(neighbours))

    def _is_plain(self, steps: NDArray[np.int64], ticks: NDArray[np.int64]) -> bool:
        first = 1 if self._fresh else 0
        shortest_turn_us = self._period_us * _TURN / 2
        return bool(
            np.all(steps == 1)
            and np.all(ticks[first:] > 0)
            and (not shortest_turn_us or np.all(ticks < shortest_turn_us))
        )

    def _one_by_one(
        self, steps: NDArray[np.int64], ticks: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        sequence = np.empty(len(steps), np.int64)
        clock = self._clock_us + np.cumsum(ticks)
        keep = np.zeros(len(steps), np.bool_)
        # Since the last one kept: steps and ticks of frames left out still count.
        step, tick = 0, 0
        for i in range(len(steps)):
            step, tick = (step + int(steps[i])) % _TURN, tick + int(ticks[i])
            whole = self._unwrapped_step(step, tick)
            sequence[i] = self._sequence + whole
            if whole < 1 or (tick < 0 and not self._fresh):
                continue
            keep[i], self._fresh = True, False
            self._sequence += whole
            step, tick = 0, 0
        return sequence, clock, keep

    def _unwrapped_step(self, step: int, tick_us: int) -> int:
        if not self._period_us:
            return step
        return step + _TURN * round((tick_us / self._period_us - step) / _TURN)

    def _remember(
        self,
        wrapped: NDArray[np.int64],
        sequence: NDArray[np.int64],
        clock: NDArray[np.int64],
        keep: NDArray[np.bool_],
    ) -> None:
        kept = np.flatnonzero(keep)
        if len(kept):
            last = kept[-1]
            self._sequence = int(sequence[last])
            self._wrapped = int(wrapped[last])
            self._clock_us = int(clock[last])
            self._fresh = False


def _find_signed_steps(
    clock_us: NDArray[np.uint64], before_us: int, bits: int
) -> NDArray[np.int64]:
    """Half a turn either side of zero, (n,)."""
    before = np.uint64(before_us % (1 << 64))
    steps = np.diff(clock_us, prepend=before)
    if bits == 64:
        return steps.view(np.int64)
    turn = np.uint64(1 << bits)
    half = np.uint64(1 << (bits - 1))
    return ((steps + half) % turn).astype(np.int64) - int(half)


_MEAS64 = np.dtype(
    [
        ("version", "u1"),
        ("type", "u1"),
        ("sequence", "<u2"),
        ("clock_us", "<u8"),
        ("range_m", "<f8"),
        ("azimuth_rad", "<f8"),
        ("elevation_rad", "<f8"),
        ("status", "<u2"),
        ("signal", "u1"),
        ("reserved", "u1"),
    ]
)
_MEAS = np.dtype(
    [
        ("version", "u1"),
        ("type", "u1"),
        ("sequence", "<u2"),
        ("clock_us", "<u4"),
        ("range_10nm", "<u4"),
        ("azimuth_turn", "<i4"),
        ("elevation_turn", "<i4"),
        ("status", "<u2"),
        ("signal", "u1"),
    ]
)
_DTYPES = {Type.MEAS64: _MEAS64, Type.MEAS: _MEAS}
_M_PER_10NM = 1e-8
_RAD_PER_COUNT = 2 * np.pi / 2**31


class StatusBit(IntFlag):
    """Status word of a sample. The low byte forbids its use, the high byte informs."""

    BEAM_BROKEN = 0x0001
    DISTANCE_INVALID = 0x0002
    OVER_SPEED = 0x0004
    OUT_OF_RANGE = 0x0008
    NOT_A_NUMBER = 0x0080  # set by the host where a value is not finite
    NOT_LEVELLED = 0x0100
    ENVIRONMENT_STALE = 0x0200
    TRIGGER = 0x0400
    AVERAGED = 0x0800
    OVERFLOW = 0x1000  # the device dropped samples since the frame before


FORBIDS_USE = 0x00FF


@dataclass(frozen=True, slots=True)
class RawSamples:
    """Columns of frames of one format, counters still wrapped, (n,) each."""

    format: Format
    sequence: NDArray[np.int64]
    clock_us: NDArray[np.uint64]
    range_m: NDArray[np.float64]
    azimuth_rad: NDArray[np.float64]
    elevation_rad: NDArray[np.float64]
    status: NDArray[np.int64]
    signal: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.sequence)


def is_measurement(body: bytes) -> bool:
    """Whether a body is a whole measurement of this version."""
    if len(body) == _MEAS64.itemsize:
        return body[0] == VERSION and body[1] == Type.MEAS64
    return len(body) == _MEAS.itemsize and body[0] == VERSION and body[1] == Type.MEAS


def parse_measurements(bodies: Sequence[bytes]) -> RawSamples:
    """Columns of bodies that pass `is_measurement`, all of one format."""
    kind = Type(bodies[0][1])
    rows = np.frombuffer(b"".join(bodies), _DTYPES[kind])
    if kind is Type.MEAS64:
        range_m = rows["range_m"]
        azimuth_rad, elevation_rad = rows["azimuth_rad"], rows["elevation_rad"]
    else:
        range_m = rows["range_10nm"] * _M_PER_10NM
        azimuth_rad = rows["azimuth_turn"] * _RAD_PER_COUNT
        elevation_rad = rows["elevation_turn"] * _RAD_PER_COUNT
    return RawSamples(
        Format[kind.name],
        rows["sequence"].astype(np.int64),
        rows["clock_us"].astype(np.uint64),
        range_m.astype(np.float64),
        azimuth_rad.astype(np.float64),
        elevation_rad.astype(np.float64),
        rows["status"].astype(np.int64),
        rows["signal"].astype(np.int64),
    )


def encode_measurements(samples: RawSamples) -> bytes:
    """Frames of a block of samples, as a device sends them.

    sequence and clock are taken modulo their width on the wire.
    """
    kind = Type[samples.format.name]
    rows = np.zeros(len(samples), _DTYPES[kind])
    rows["version"], rows["type"] = VERSION, kind
    rows["sequence"] = samples.sequence & 0xFFFF
    rows["status"], rows["signal"] = samples.status, samples.signal
    if kind is Type.MEAS64:
        rows["clock_us"] = samples.clock_us
        rows["range_m"] = samples.range_m
        rows["azimuth_rad"] = samples.azimuth_rad
        rows["elevation_rad"] = samples.elevation_rad
    else:
        rows["clock_us"] = samples.clock_us & np.uint64(0xFFFFFFFF)
        rows["range_10nm"] = np.rint(samples.range_m / _M_PER_10NM)
        rows["azimuth_turn"] = _counts(samples.azimuth_rad)
        rows["elevation_turn"] = _counts(samples.elevation_rad)
    return b"".join(encode_frame(row.tobytes()) for row in rows)


def _counts(angle_rad: NDArray[np.float64]) -> NDArray[np.int64]:
    """Counts of 2⁻³¹ turn, half a turn either side of zero."""
    half = np.pi
    wrapped = np.mod(angle_rad + half, 2 * half) - half
    return np.rint(wrapped / _RAD_PER_COUNT).astype(np.int64)


def spherical_to_cartesian_mm(
    range_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike
) -> NDArray[np.float64]:
    """(n, 3) positions in the tracker's frame."""
    range_mm = np.asarray(range_m, np.float64) * 1e3
    level_mm = range_mm * np.cos(elevation_rad)
    return np.stack(
        [
            level_mm * np.cos(azimuth_rad),
            level_mm * np.sin(azimuth_rad),
            range_mm * np.sin(elevation_rad),
        ],
        axis=-1,
    )
