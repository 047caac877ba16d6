"""Error parameters over time, from what Runs tell: constructed answers."""

import numpy as np
import pytest

from truepath.estimation.problem.information import Information
from truepath.estimation.solve.drift import (
    CommonBasis,
    Course,
    DriftData,
    DriftPosterior,
    DriftSizes,
    build_drift_shapes,
    estimate_drift,
)
from truepath.files.bundle.machine_file import machine_from_json
from truepath.kinematics.effects.error_motion import make_error_motion
from truepath.kinematics.model import MachineModel
from truepath_simulators.machine_file import load_machine

HOUR_S = 3600.0
SIGMA = 0.02  # of a shape, in usual sizes, as one Run tells it


@pytest.fixture(scope="module")
def model():
    machine = machine_from_json({**load_machine("demo")}, file="machine.json")
    axes = {axis.name: axis for axis in machine.axes}
    symbols = ("EXX", "EYX", "ECX", "EYY", "EXY")
    motions = tuple(make_error_motion(s, axes[s[2]], 6) for s in symbols)
    return MachineModel(machine, motions)


def course_of(*hours, celsius=None):
    degc = np.zeros((len(hours), 0)) if celsius is None else celsius
    return Course(HOUR_S * np.array(hours, float), degc)


def tell(model, theta, rng):
    usual = [1e-2 if p.unit == "mm" else 2e-5 for p in model.parameters]
    sigma = SIGMA * np.array(usual)
    measured = theta + sigma * rng.standard_normal(len(theta))
    matrix = np.diag(sigma**-2.0)
    return Information(matrix, matrix @ measured, 0.0, 0.0)


def basis_of(model, truth, rng):
    told = tuple(tell(model, theta, rng) for theta in truth)
    return CommonBasis(model, np.zeros((model.size, model.size)), told)


def settle(model, hours, rng, tau_h=1.0, size=1.0):
    B = build_drift_shapes(model)
    amplitude = size * rng.standard_normal(B.shape[1])
    still = B @ rng.standard_normal(B.shape[1])
    return np.array([still + B @ amplitude * np.exp(-h / tau_h) for h in hours])


def test_smoothing_all_runs_at_once_equals_a_kalman_filter_and_rts_smoother(model):
    rng, hours = np.random.default_rng(1), (0.0, 0.5, 1.5, 4.0)
    basis = basis_of(model, settle(model, hours, rng), rng)
    B, size = build_drift_shapes(model), model.size
    sizes = DriftSizes(1.0, 0.5, HOUR_S, 3 * HOUR_S, 0.2, 0.0, 0.0)
    at = course_of(*hours)
    found = DriftPosterior.of(DriftData.of(basis, at, B), sizes)
    # States: parameters, which walk, and the two settling parts at the first Run.
    wide = np.array([1.0 if p.unit == "mm" else 2e-3 for p in model.parameters])
    scale = np.concatenate([wide, np.ones(2 * B.shape[1])])
    m, P = np.zeros(len(scale)), np.eye(len(scale))
    P[size:, size:] *= np.repeat([1.0, 0.25], B.shape[1])
    before, after, previous = [], [], 0.0
    for hour, told in zip(hours, basis.told, strict=True):
        step = np.zeros_like(P)
        walked = B / wide[:, None]
        step[:size, :size] = 0.2**2 * (hour - previous) * walked @ walked.T
        P, previous = P + step, hour
        before.append((m, P))
        settled = B * np.exp(-hour), B * np.exp(-hour / 3.0)
        F = np.hstack([np.eye(size), *settled]) * scale
        root = np.sqrt(np.diag(told.matrix))
        H, y = root[:, None] * F, told.vector / root
        K = np.linalg.solve(H @ P @ H.T + np.eye(size), H @ P).T
        left = np.eye(len(m)) - K @ H
        m, P = m + K @ (y - H @ m), left @ P @ left.T + K @ K.T
        after.append((m, P))
    for k in range(len(hours) - 2, -1, -1):
        (mean, cov), (ahead, wider) = after[k], before[k + 1]
        gain = np.linalg.solve(wider, cov).T
        m, P = mean + gain @ (m - ahead), cov + gain @ (P - wider) @ gain.T
    F = np.hstack([np.eye(size), B, B]) * scale
    theta, covariance = found.predict(course_of(0.0))
    sigma = np.sqrt(np.diag(covariance))
    assert np.abs(theta - F @ m).max() < 1e-3 * sigma.min()
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(F @ P @ F.T)), rtol=1e-3)


def test_stated_intervals_hold_a_machine_that_settles_now_and_later(model):
    inside = {"at the last Run": [], "later": []}
    hours, times = np.array([0.0, 0.3, 0.8, 1.5, 2.5, 4.0]), (4.0, 8.0)
    for seed in range(4):
        rng = np.random.default_rng([seed, 5])
        truth = settle(model, [*hours, 8.0], rng, tau_h=rng.uniform(0.5, 2.0))
        drift = estimate_drift(basis_of(model, truth[:-1], rng), course_of(*hours))
        for name, hour, true in zip(inside, times, truth[-2:], strict=True):
            theta, covariance = drift.predict(course_of(hour))
            sigma = np.sqrt(np.diag(covariance))
            inside[name] += list(np.abs(theta - true) < 2 * sigma)
    assert 0.9 < np.mean(inside["at the last Run"]) < 0.995
    assert np.mean(inside["later"]) > 0.93


def test_all_runs_tell_more_of_each_than_it_does_alone(model):
    rng, hours = np.random.default_rng(3), np.linspace(0.0, 4.0, 8)
    basis = basis_of(model, settle(model, hours, rng), rng)
    drift = estimate_drift(basis, course_of(*hours))
    sigma = np.sqrt(np.diag(drift.predict(course_of(hours[4]))[1]))
    alone = np.diag(basis.told[4].matrix) ** -0.5
    assert (sigma < alone).all()
    assert np.mean(sigma / alone) < 0.75


def test_two_runs_leave_the_future_wide(model):
    rng, hours = np.random.default_rng(4), (0.0, 0.4, 1.0, 2.0, 3.0)
    truth = settle(model, hours, rng, tau_h=0.7)
    spread = []
    for some in (slice(0, 2), slice(None)):
        basis = basis_of(model, truth[some], rng)
        drift = estimate_drift(basis, course_of(*hours[some]))
        spread.append(np.sqrt(np.diag(drift.predict(course_of(6.0))[1])))
    changes = build_drift_shapes(model).any(axis=1)
    assert np.median((spread[0] / spread[1])[changes]) > 3.0


def test_what_follows_the_temperature_is_predicted_at_another_temperature(model):
    rng, hours = np.random.default_rng(6), np.arange(7.0)
    B = build_drift_shapes(model)
    per_kelvin = 0.3 * rng.standard_normal(B.shape[1])
    kelvin = np.array([0.0, 1.0, -1.0, 2.0, -0.5, 1.5, 0.5])[:, None]
    truth = kelvin * (B @ per_kelvin)
    course = course_of(*hours, celsius=kelvin)
    drift = estimate_drift(basis_of(model, truth, rng), course)
    theta, covariance = drift.predict(course_of(7.0, celsius=np.array([[4.0]])))
    change = 4.0 * (B @ per_kelvin)
    off, sigma = theta - change, np.sqrt(np.diag(covariance))
    assert (np.abs(off) < 2 * sigma).mean() > 0.85
    assert np.linalg.norm(off) < 0.2 * np.linalg.norm(change)
