"""Decoder of the stream of a GST/1 tracker: bytes to samples and messages. No I/O.

Two stages, so that a reader thread can do the cheap one and leave the rest to others:
`FrameReader` cuts and checks frames as bytes come; `SampleDecoder` turns the bodies of
many frames into one block of samples. `StreamDecoder` is both in a row.

`Unwrapper` unwraps counters, u16 sequence numbers and device clocks, over any gap. The
sequence alone cannot distinguish a loss of n samples from one of n + 65 536 (131 s at
500 Hz); the device clock can. With period T, clock step Δt, sequence step d (mod 2¹⁶)

    step = d + 2¹⁶ · round((Δt / T − d) / 2¹⁶)

A step below 1, or a clock that runs backwards, is a repeated or late frame: omitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from truepath_drivers.interfaces.records import LinkHealth, TrackerSamples
from truepath_drivers.tracker.streaming.framing import FrameReader
from truepath_drivers.tracker.streaming.measurements import (
    FORBIDS_USE,
    RawSamples,
    StatusBit,
    is_measurement,
    parse_measurements,
    spherical_to_cartesian_mm,
)
from truepath_drivers.tracker.streaming.message_codec import parse_message
from truepath_drivers.tracker.streaming.messages import Ack, Format, Message, StreamInfo

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
        """Counts since construction."""
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
            whole = self._whole_step(step, tick)
            sequence[i] = self._sequence + whole
            if whole < 1 or (tick < 0 and not self._fresh):
                continue
            keep[i], self._fresh = True, False
            self._sequence += whole
            step, tick = 0, 0
        return sequence, clock, keep

    def _whole_step(self, step: int, tick_us: int) -> int:
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
