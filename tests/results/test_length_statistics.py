"""Mean, 95 % and largest length of noisy vectors, against lengths that are known."""

import numpy as np
import pytest

from truepath.answers.verification.places.length_statistics import NAMES, state_measured

PLACES, TRIALS, DRAWS = 120, 60, 300
SIGMA_MM = 1e-3


def draw_noise(rng, count):
    """Noise of which a part is common to ten places one after another."""
    slow = rng.standard_normal((PLACES // 10, 3, count)).repeat(10, axis=0)
    return SIGMA_MM * (0.8 * rng.standard_normal((PLACES, 3, count)) + 0.6 * slow)


def draw_field(rng, mean_mm):
    at = rng.uniform(-1.0, 1.0, (PLACES, 3))
    shapes = np.column_stack([at, at**2, np.sin(3.0 * at), at[:, [0]] * at[:, [1]]])
    field = shapes @ rng.standard_normal((shapes.shape[1], 3))
    field -= field.mean(axis=0)
    return field * (mean_mm / np.linalg.norm(field, axis=1).mean())


@pytest.mark.parametrize("times_the_noise", [8.0, 3.0, 0.6, 0.3])
def test_what_noise_hides_of_lengths_is_within_their_uncertainty(times_the_noise):
    rng = np.random.default_rng(8)
    inside = dict.fromkeys(NAMES, 0)
    for _ in range(TRIALS):
        true = draw_field(rng, times_the_noise * SIGMA_MM)
        length_um = 1e3 * np.linalg.norm(true, axis=1)
        known = (length_um.mean(), np.quantile(length_um, 0.95), length_um.max())
        seen = true + draw_noise(rng, 1)[:, :, 0]
        stated = state_measured(seen, draw_noise(rng, DRAWS), 60.0, np.zeros_like(seen))
        for name, value in zip(NAMES, known, strict=True):
            off = abs(stated[name].value_um - value)
            inside[name] += off <= 2.0 * stated[name].uncertainty_um
    # 95 % are stated; of 60 fewer than 52 would come with a chance of 0.4 %.
    assert all(count >= 52 for count in inside.values()), inside
