"""A sine and a cosine, stated as amplitude and phase."""

import numpy as np
import pytest

from app.kinematics.effects.sinusoid import amplitude_and_phase


def test_amplitude_and_phase_make_the_same_wave():
    theta = np.array([-0.003, 0.004])
    amplitude, phase = amplitude_and_phase(theta, np.eye(2) * 1e-8)
    at = np.linspace(0.0, 2.0 * np.pi, 9)
    wave = amplitude.value * np.sin(at + phase.value)
    assert wave == pytest.approx(theta[0] * np.sin(at) + theta[1] * np.cos(at))


def test_the_uncertainties_are_the_spread_of_what_could_have_been_found(rng):
    theta = np.array([0.003, 0.004])
    root = np.array([[1e-4, 0.0], [6e-5, 5e-5]])
    drawn = theta + rng.standard_normal((20_000, 2)) @ root.T
    amplitude, phase = amplitude_and_phase(theta, root @ root.T)
    found = [amplitude_and_phase(one, np.eye(2)) for one in drawn]
    spread = np.std([[a.value, p.value] for a, p in found], axis=0)
    # A spread of 20 000 draws is known to half a per cent.
    assert amplitude.uncertainty == pytest.approx(spread[0], rel=0.02)
    assert phase.uncertainty == pytest.approx(spread[1], rel=0.02)
