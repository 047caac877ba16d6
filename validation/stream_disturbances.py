"""What goes wrong with a tracker's stream while it is recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from truepath_drivers.interfaces.records import TrackerSamples
from truepath_simulators.machine.tracker_head import to_cartesian, to_spherical
from truepath_simulators.worlds.synthetic import BEAM_BROKEN

Disturb = Callable[[TrackerSamples, np.random.Generator], TrackerSamples]


def move(stream: TrackerSamples, position_mm: np.ndarray) -> TrackerSamples:
    """Return a stream with its samples elsewhere."""
    return replace(stream, position_mm=position_mm)


def draw_stretch(
    stream: TrackerSamples, duration_s: float, rng: np.random.Generator
) -> slice:
    """Draw a stretch of the stream: on lines, ramps, at stops, across corners."""
    step_s = float(np.median(np.diff(stream.device_time_s)))
    samples = max(1, round(duration_s / step_s))
    first = int(rng.integers(len(stream) // 50, len(stream) - samples - 1))
    return slice(first, first + samples)


def draw_shift_mm(size_mm: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a shift of given size in any direction."""
    aside = rng.normal(size=3)
    return size_mm * aside / np.linalg.norm(aside)


def burst(size_mm: float, duration_s: float, times: int = 1) -> Disturb:
    """Set samples aside for a while."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        moved = stream.position_mm.copy()
        for _ in range(times):
            moved[draw_stretch(stream, duration_s, rng)] += draw_shift_mm(size_mm, rng)
        return move(stream, moved)

    return disturb


def flip(duration_s: float) -> Disturb:
    """Lose the sign of one coordinate for a while."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        moved = stream.position_mm.copy()
        moved[draw_stretch(stream, duration_s, rng), int(rng.integers(3))] *= -1.0
        return move(stream, moved)

    return disturb


def freeze(duration_s: float) -> Disturb:
    """Repeat one value for a while."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        moved = stream.position_mm.copy()
        part = draw_stretch(stream, duration_s, rng)
        moved[part] = moved[part.start]
        return move(stream, moved)

    return disturb


def stall(duration_s: float) -> Disturb:
    """Stamp what comes in a while with next to one time, as on arrival in a heap."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        time_s = stream.device_time_s.copy()
        part = draw_stretch(stream, duration_s, rng)
        late = 1e-5 * np.arange(part.stop - part.start)[::-1]
        time_s[part] = time_s[part.stop] - 1e-5 - late
        return replace(stream, device_time_s=time_s)

    return disturb


def jump_clock(step_s: float) -> Disturb:
    """Set the tracker's clock forward at one moment."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        time_s = stream.device_time_s.copy()
        time_s[draw_stretch(stream, 1.0, rng).start :] += step_s
        return replace(stream, device_time_s=time_s)

    return disturb


def knock(*size_um: float, drift_um: float = 0.0) -> Disturb:
    """Shift the tracker at even distances of time, and let it drift beside."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        time_s = stream.device_time_s
        share = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
        moved = stream.position_mm + 1e-3 * drift_um * share[:, None] / 3**0.5
        for number, size in enumerate(size_um, start=1):
            late = share > number / (len(size_um) + 1.0) + 0.013
            moved[late] += draw_shift_mm(1e-3 * size, rng)
        return move(stream, moved)

    return disturb


def shift(size_um: float) -> Disturb:
    """Shift the tracker at one moment."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        late = slice(int(rng.uniform(0.2, 0.8) * len(stream)), None)
        moved = stream.position_mm.copy()
        moved[late] += draw_shift_mm(1e-3 * size_um, rng)
        return move(stream, moved)

    return disturb


def turn(angle_urad: float) -> Disturb:
    """Turn the tracker about itself at one moment."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        late = slice(int(rng.uniform(0.2, 0.8) * len(stream)), None)
        moved = stream.position_mm.copy()
        moved[late] += np.cross(draw_shift_mm(1e-6 * angle_urad, rng), moved[late])
        return move(stream, moved)

    return disturb


def lock_again(offset_um: float, broken_s: float) -> Disturb:
    """Read every distance too long from one moment on, after so long without beam."""

    def disturb(stream: TrackerSamples, rng: np.random.Generator) -> TrackerSamples:
        first = int(rng.uniform(0.2, 0.8) * len(stream))
        back_s = stream.device_time_s[first] + broken_s
        late = stream.device_time_s >= back_s
        polar = to_spherical(stream.position_mm)
        polar[late, 0] += 1e-3 * offset_um
        status = stream.status.copy()
        status[first:][~late[first:]] = BEAM_BROKEN
        return replace(stream, position_mm=to_cartesian(polar), status=status)

    return disturb
