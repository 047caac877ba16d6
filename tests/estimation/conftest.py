"""How far estimates of five-axis machines are off the truth, by two measures."""

from __future__ import annotations

import numpy as np
import pytest

from truepath.kinematics.conditions import make_standstill
from truepath.kinematics.effects.error_motion import ErrorMotion
from truepath.kinematics.volumetric_map import build_volumetric_map


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
    """Estimate minus truth, in standard uncertainties, over tables and numbers."""
    return _deviations


@pytest.fixture(scope="session")
def share_left(rigid_free):
    """Share of the volumetric error that is left, and of it within two sigma."""

    def measured(result, truth):
        machine = truth.machine
        q = np.random.default_rng(1).uniform(machine.low, machine.high, (200, 5))
        at, maps = (
            make_standstill(result.model.machine, q),
            build_volumetric_map(result.model),
        )
        before = rigid_free(at.point_mm, truth.deviation_mm(q, "T1"))
        left = before - rigid_free(at.point_mm, maps.error_mm(at, result.theta))
        inside = np.abs(left) < 2 * maps.sigma_mm(at, result.covariance)
        return np.abs(left).mean() / np.abs(before).mean(), inside.mean()

    return measured
