"""Effects that are a sine and a cosine of one coordinate: how both are stated."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import columns_along
from app.kinematics.effects.catalogue import (
    CandidateEstimate,
    Quantity,
    Wave,
    attenuate_wave,
)

_FEWEST_PLACES = 12  # of fewer, a wave makes whatever is wanted


def sine_and_cosine(angle: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Return sine and cosine."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def average_over_cells(
    angle: Float64[np.ndarray, " n"], rate: Float64[np.ndarray, " n"], at: Conditions
) -> Float64[np.ndarray, "n 2"]:
    """Return sine and cosine, averaged over each cell.

    angle : rad, in the middle of the cell; rate : its change, rad/s
    """
    if at.recorded is None:
        return sine_and_cosine(angle)
    return sine_and_cosine(angle) * attenuate_wave(rate, at.recorded.span_s)[:, None]


def make_time_wave(
    direction: str, at: Conditions, frequency_hz: Float64[np.ndarray, " v"]
) -> Wave:
    """Return waves in time of several frequencies, along X, Y or Z."""
    one = np.ones((len(at), 1))
    arm = columns_along(direction, one)[:, :, 0]
    return Wave(arm, at.time_s, one[:, 0], frequency_hz)


def is_resolved(at: Conditions, axis: str, longest_mm: float) -> bool:
    """Tell whether positions tell waves apart: travel enough, and places in it."""
    places = np.unique(np.round(at.axis_mm(axis)))
    travel = float(np.ptp(places))
    return len(places) >= _FEWEST_PLACES and travel > 2.0 * longest_mm


def list_wave_numbers(
    at: Conditions, axis: str, shortest_mm: float, longest_mm: float
) -> Float64[np.ndarray, " v"]:
    """Return waves a millimetre, four steps to one wave over the travel."""
    # In a further Run the axis may stand.
    travel = max(float(np.ptp(at.axis_mm(axis))), longest_mm)
    return np.arange(1.0 / longest_mm, 1.0 / shortest_mm, 0.25 / travel)


def find_amplitude_and_phase(
    theta: Float64[np.ndarray, "2"], covariance: Float64[np.ndarray, "2 2"]
) -> tuple[Quantity, Quantity]:
    """Return the size and phase of θ₀ sin + θ₁ cos = amplitude sin(… + phase).

    To second order (GUM 5.1.2, note): where the phase is known badly, so is the size.
    """
    amplitude = max(float(np.hypot(theta[0], theta[1])), 1e-300)
    along = theta / amplitude
    across = np.array([-along[1], along[0]])
    phase = float(np.mod(np.arctan2(theta[1], theta[0]), 2.0 * np.pi))
    radial, turned = along @ covariance @ along, across @ covariance @ across
    both = along @ covariance @ across
    bent = turned / amplitude
    size = np.sqrt(radial + 0.5 * bent**2)
    turn = np.sqrt(turned + (radial * turned + both**2) / amplitude**2) / amplitude
    return Quantity(amplitude, float(size)), Quantity(phase, float(turn))


def state_wave(scanned: str, found: CandidateEstimate) -> dict[str, Quantity]:
    """Return what files state of a wave: what was scanned, amplitude and phase.

    The first two parameters are sine and cosine, in mm.
    """
    amplitude, phase = find_amplitude_and_phase(
        found.theta[:2], found.covariance[:2, :2]
    )
    return {
        scanned: found.scanned,
        "amplitude_um": amplitude.scale(1e3),
        "phase_rad": phase,
    }
