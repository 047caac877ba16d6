"""Samples as a tracker sends them."""

import numpy as np

from truepath_drivers.tracker.streaming.measurements import RawSamples
from truepath_simulators.machine.tracker_head import to_spherical

METRES = np.array([1e-3, 1.0, 1.0])  # ranges are sent in m


def raw_samples(measured, number, clock_us, position_mm, status=0, signal=200):
    """What a tracker sends of these places; all samples have this status."""
    n, polar = len(position_mm), (METRES * to_spherical(position_mm)).T
    number, clock_us = np.asarray(number), np.asarray(clock_us).astype(np.uint64)
    told = np.full(n, status), np.broadcast_to(signal, n)
    return RawSamples(measured, number, clock_us, *polar, *told)


def one_sample(measured, number, clock_us, polar, *told):
    """A single sample: range in m, azimuth, elevation; status, signal."""
    columns = [np.array([value]) for value in (number, *polar, *told)]
    return RawSamples(
        measured, columns[0], np.array([clock_us], np.uint64), *columns[1:]
    )
