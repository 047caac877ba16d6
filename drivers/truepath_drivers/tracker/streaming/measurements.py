"""Measurement frames in blocks: bodies to columns and back, angles to Cartesian.

Azimuth is the right-handed angle about +z, zero on +x; elevation rises from the xy
plane towards +z:

    x = r cos(el) cos(az)    y = r cos(el) sin(az)    z = r sin(el)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truepath_drivers.tracker.streaming.framing import encode_frame
from truepath_drivers.tracker.streaming.messages import VERSION, Format, Type

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
