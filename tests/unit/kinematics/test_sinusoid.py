"""A sine and a cosine: over a cell, and stated as amplitude and phase."""

from dataclasses import replace

import numpy as np
import pytest

from mills import build_mill
from truepath.kinematics.conditions import RecordedState, make_standstill
from truepath.kinematics.effects.position_wave import PositionWave, ScrewCyclic
from truepath.kinematics.effects.setup_motion import TimeWave, Vibration
from truepath.kinematics.effects.sinusoid import compute_amplitude_and_phase
from truepath.kinematics.machine.machine import LinearAxis

SPAN_S = 0.08
RATE_MM_S = np.array([60.0, 0.0, 0.0])


def test_amplitude_and_phase_make_the_same_wave():
    theta = np.array([-0.003, 0.004])
    amplitude, phase = compute_amplitude_and_phase(theta, np.eye(2) * 1e-8)
    at = np.linspace(0.0, 2.0 * np.pi, 9)
    wave = amplitude.value * np.sin(at + phase.value)
    assert wave == pytest.approx(theta[0] * np.sin(at) + theta[1] * np.cos(at))


@pytest.mark.parametrize(
    ("root", "within"),
    [
        (np.array([[1e-4, 0.0], [6e-5, 5e-5]]), 0.02),
        # Known to 0.2 rad: the size leans with the phase, to second order.
        (np.array([[8e-4, 0.0], [-6e-4, 1e-4]]), 0.1),
    ],
    ids=["well known", "badly known phase"],
)
def test_the_uncertainties_are_the_spread_of_what_may_be_found(rng, root, within):
    theta = np.array([0.003, 0.004])
    drawn = theta + rng.standard_normal((20_000, 2)) @ root.T
    amplitude, phase = compute_amplitude_and_phase(theta, root @ root.T)
    spread = np.hypot(*drawn.T).std(), np.arctan2(drawn[:, 1], drawn[:, 0]).std()
    # A spread of 20 000 draws is known to half a per cent.
    assert amplitude.uncertainty == pytest.approx(spread[0], rel=within)
    assert phase.uncertainty == pytest.approx(spread[1], rel=within)


def moving(span_s, count):
    """A machine in motion along X: conditions of one cell, or of moments within it."""
    machine = build_mill((0.0, 0.0, -150.0), sides=("X", "YZ"))
    lag_s = ((np.arange(count) + 0.5) / count - 0.5) * SPAN_S
    position = np.array([[210.0, 40.0, 30.0]]) + lag_s[:, None] * RATE_MM_S
    rate_mm_s, seen_mm = (
        np.tile(v, (count, 1)) for v in (RATE_MM_S, [900.0, 0.0, 0.0])
    )
    since = np.full(count, span_s), np.full((count, 3), np.inf)
    recorded = RecordedState(rate_mm_s, *since, seen_mm, np.eye(3))
    at = make_standstill(machine, position)
    return replace(at, time_s=3.7 + lag_s, recorded=recorded)


@pytest.mark.parametrize(
    "effect",
    [
        Vibration("Y", 7.0, 3.0),
        TimeWave("Z", 0.4, 3.0),
        PositionWave(LinearAxis("X", 0.0, 500.0), "Z", 9.0),
        ScrewCyclic(LinearAxis("X", 0.0, 500.0), 10.0),
    ],
    ids=lambda effect: type(effect).__name__,
)
def test_a_wave_over_a_cell_is_the_mean_of_the_wave_at_its_moments(effect):
    cell = effect.jacobian(moving(SPAN_S, 1))[0]
    moments = effect.jacobian(moving(0.0, 4001))
    assert cell == pytest.approx(moments.mean(axis=0), abs=1e-5)
    assert np.abs(cell).max() < 0.99 * np.abs(moments).max()
