"""Effects that are a sine and a cosine of one coordinate: how both are stated."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Parameter, along
from app.kinematics.effects.catalogue import Candidate, Measured, Wave, averaged

_FEWEST_PLACES = 12  # of fewer, a wave makes whatever is wanted


def sine_and_cosine(effect: str, unit: str) -> tuple[Parameter, ...]:
    """Return the two parameters of an effect of the measurement."""
    return tuple(Parameter(f"{effect}-{p}", unit) for p in ("sin", "cos"))


def waves(angle: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    """Return sine and cosine."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def waves_of_cells(
    angle: Float64[np.ndarray, " n"], rate: Float64[np.ndarray, " n"], at: Conditions
) -> Float64[np.ndarray, "n 2"]:
    """Return sine and cosine, averaged over each cell.

    angle : rad, in the middle of the cell; rate : its change, rad/s
    """
    if at.recorded is None:
        return waves(angle)
    return waves(angle) * averaged(rate, at.recorded.span_s)[:, None]


def wave_of_time(
    direction: str, at: Conditions, frequency_hz: Float64[np.ndarray, " v"]
) -> Wave:
    """Return waves in time of several frequencies, along X, Y or Z."""
    one = np.ones(len(at))
    return Wave(along(direction, one[:, None])[:, :, 0], at.time_s, one, frequency_hz)


def is_resolved(at: Conditions, axis: str, longest_mm: float) -> bool:
    """Tell whether positions tell waves apart: travel enough, and places in it."""
    places = np.unique(np.round(at.axis_mm(axis)))
    travel = float(np.ptp(places))
    return len(places) >= _FEWEST_PLACES and travel > 2.0 * longest_mm


def wave_numbers(
    at: Conditions, axis: str, shortest_mm: float, longest_mm: float
) -> Float64[np.ndarray, " v"]:
    """Return waves a millimetre, four steps to one wave over the travel."""
    # In a further Run the axis may stand.
    travel = max(float(np.ptp(at.axis_mm(axis))), longest_mm)
    return np.arange(1.0 / longest_mm, 1.0 / shortest_mm, 0.25 / travel)


def amplitude_and_phase(
    theta: Float64[np.ndarray, "2"], covariance: Float64[np.ndarray, "2 2"]
) -> tuple[Measured, Measured]:
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
    return Measured(amplitude, float(size)), Measured(phase, float(turn))


def measured_wave(
    scanned: str,
    candidate: Candidate,
    theta: Float64[np.ndarray, "2"],
    covariance: Float64[np.ndarray, "2 2"],
    value_sigma: float,
) -> dict[str, Measured]:
    """Return what files state of a wave: what was scanned, amplitude and phase.

    theta, covariance : of sine and cosine, mm
    value_sigma : standard uncertainty of what was scanned
    """
    amplitude, phase = amplitude_and_phase(theta, covariance)
    return {
        scanned: Measured(candidate.value or 0.0, value_sigma),
        "amplitude_um": Measured(amplitude.value * 1e3, amplitude.uncertainty * 1e3),
        "phase_rad": phase,
    }
