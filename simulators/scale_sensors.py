"""Temperature sensors of the axis scales."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truepath.simulators.hidden.effect import HiddenEffect
from truepath.simulators.machine_file import MachineFile
from truepath.simulators.randomness import generator
from truepath.simulators.recording import Temperatures
from truepath.simulators.tracker_head import TrackerClock

_USUAL_DEGC = 20.0
_SIGMA_K = 0.02
_PERIOD_S = 1.0


def read_sensors(
    machine: MachineFile,
    device_s: np.ndarray,
    clock: TrackerClock,
    seed: int,
    hidden: Sequence[HiddenEffect],
) -> Temperatures:
    """Return what they show during a recording: constant but for noise and effects."""
    rng = generator(seed, "environment")
    names = tuple(axis.name for axis in machine.linear_axes)
    time_s = np.arange(device_s[0], device_s[-1], _PERIOD_S)
    celsius = _USUAL_DEGC + rng.normal(0.0, _SIGMA_K, (len(time_s), len(names)))
    for effect in hidden:
        for column, name in enumerate(names):
            celsius[:, column] += effect.warming_degc(name, clock.true_s(time_s))
    return Temperatures(names, time_s, celsius)
