"""Decodes the stream of a GST/1 tracker: bytes in, samples and messages out. No I/O.

Two stages, so that a reader thread can do the cheap one and leave the rest to others:
`FrameReader` cuts and checks frames as bytes come; `SampleDecoder` turns the bodies of
many frames into one block of samples. `StreamDecoder` is both in a row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from drivers.interfaces.records import LinkHealth, TrackerSamples
from drivers.tracker.streaming.framing import FrameReader
from drivers.tracker.streaming.measurements import (
    FORBIDS_USE,
    RawSamples,
    StatusBit,
    is_measurement,
    parse_measurements,
    spherical_to_cartesian_mm,
)
from drivers.tracker.streaming.messages import (
    Ack,
    Format,
    Message,
    StreamInfo,
    parse_message,
)
from drivers.tracker.streaming.unwrapping import Unwrapper

_CLOCK_BITS = {Format.MEAS64: 64, Format.MEAS: 32}


@dataclass(frozen=True, slots=True)
class Decoded:
    """What one call completed: samples of all measurements, other messages in order."""

    samples: TrackerSamples
    messages: tuple[Message, ...]


class SampleDecoder:
    """Turns bodies in order into samples with whole numbers and device seconds.

    lost_samples : samples that the device took and that are in no block
    device_overflows : samples that follow an overflow inside the device
    """

    def __init__(self) -> None:
        self.device_overflows = 0
        self._unwrapper = Unwrapper()

    @property
    def lost_samples(self) -> int:
        """Samples that the device took and that are in no block."""
        return self._unwrapper.lost

    def decode(self, bodies: Sequence[bytes]) -> Decoded:
        """Return the samples and the messages of bodies that `FrameReader` passed."""
        blocks: list[TrackerSamples] = []
        messages: list[Message] = []
        for measured, group in groupby(bodies, _measurement_type):
            if measured is not None:
                blocks.append(self._samples(parse_measurements(list(group))))
            else:
                messages += self._messages(group)
        return Decoded(TrackerSamples.join(blocks), tuple(messages))

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
        return TrackerSamples(
            sequence[keep],
            np.true_divide(clock_us[keep], 1e6, dtype=np.float64),
            position_mm[keep],
            status[keep],
        )


class StreamDecoder:
    """The whole way from bytes to samples; any split of the bytes gives the same."""

    def __init__(self) -> None:
        self._frames = FrameReader()
        self._decoder = SampleDecoder()

    def feed(self, data: bytes) -> Decoded:
        """Take bytes as they come; return what is complete now."""
        return self._decoder.decode(self._frames.feed(data))

    @property
    def health(self) -> LinkHealth:
        """Counts since construction."""
        return link_health(self._frames, self._decoder)


def link_health(frames: FrameReader, decoder: SampleDecoder) -> LinkHealth:
    """Return the counts of both stages as one record."""
    return LinkHealth(
        frames=frames.frames,
        lost_samples=decoder.lost_samples,
        crc_errors=frames.crc_errors,
        skipped_bytes=frames.skipped_bytes,
        device_overflows=decoder.device_overflows,
    )


def _measurement_type(body: bytes) -> int | None:
    return body[1] if is_measurement(body) else None


def _positions(raw: RawSamples) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in mm and the status in which 0 is valid.

    Where a device sends what is not finite the position is 0 and the status says so.
    """
    with np.errstate(invalid="ignore"):
        position_mm = spherical_to_cartesian_mm(
            raw.range_m, raw.azimuth_rad, raw.elevation_rad
        )
    finite = np.isfinite(position_mm).all(axis=1)
    position_mm[~finite] = 0.0
    status = raw.status & FORBIDS_USE
    return position_mm, np.where(finite, status, status | StatusBit.NOT_A_NUMBER)
