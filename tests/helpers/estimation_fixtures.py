"""Small recordings, and how far estimates are off the truth, motion by motion."""

import numpy as np
import pytest

import recorded
from truepath.kinematics.effects.error_motion import ErrorMotion


def _deviations(result, truth):
    """Estimate minus truth, in standard uncertainties, over tables and numbers."""
    known = {**truth.squareness_rad, **truth.locations()}
    motions = truth.error_motions()
    found = []
    for effect in result.model.effects:
        part = result.model.slices[effect.name]
        theta, covariance = result.theta[part], result.covariance[part, part]
        if isinstance(effect, ErrorMotion):
            s = np.linspace(effect.axis.low, effect.axis.high, 7)
            rows, true = effect.rows(s), motions[effect.symbol].at(s)
        elif effect.name in known:
            rows, true = np.eye(1), np.array([known[effect.name]])
        else:
            continue
        sigma = np.sqrt(np.einsum("np,pq,nq->n", rows, covariance, rows))
        told = sigma > 1e-8  # not where the gauge makes both nothing
        found.append(((rows @ theta - true) / np.maximum(sigma, 1e-12))[told])
    return np.concatenate(found)


@pytest.fixture(scope="session")
def deviations():
    return _deviations


@pytest.fixture(scope="session")
def record_small():
    return recorded.record_small
