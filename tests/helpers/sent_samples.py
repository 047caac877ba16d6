"""Samples as a tracker sends them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from truepath_drivers.tracker.streaming import messages as gst
from truepath_drivers.tracker.streaming.measurements import RawSamples
from truepath_simulators.machine.tracker_head import to_spherical

METRES = np.array([1e-3, 1.0, 1.0])  # ranges are sent in m


def raw_samples(
    measured: gst.Format,
    number: ArrayLike,
    clock_us: ArrayLike,
    position_mm: np.ndarray,
    status: int = 0,
    signal: ArrayLike = 200,
) -> RawSamples:
    """What a tracker sends of these places; all samples have this status."""
    n = len(position_mm)
    return RawSamples(
        measured,
        np.asarray(number),
        np.asarray(clock_us).astype(np.uint64),
        *(METRES * to_spherical(position_mm)).T,
        np.full(n, status),
        np.broadcast_to(signal, n),
    )


def one_sample(
    measured: gst.Format, number: int, clock_us: int, polar: Sequence[float], *told: int
) -> RawSamples:
    """A single sample: range in m, azimuth, elevation; status, signal."""
    columns = [np.array([value]) for value in (number, *polar, *told)]
    return RawSamples(
        measured, columns[0], np.array([clock_us], np.uint64), *columns[1:]
    )
