"""The banded whitening equals the dense covariance it stands for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truepath.numerics.correlated_noise import (
    BandedFactor,
    build_ou_precision,
    extend,
    factorise,
)

TAU_S = 0.8


@pytest.fixture
def case(rng):
    return make_case(rng)


def make_case(rng, n=30):
    time_s = np.cumsum(rng.uniform(0.02, 0.6, n))
    root = rng.normal(size=(n, 3, 3))
    white = np.linalg.inv(root @ np.swapaxes(root, 1, 2) + np.eye(3))
    return time_s, white, rng.uniform(0.5, 2.0, (n, 3)), rng.normal(size=(n, 3, 4))


def dense(time_s, white, sigma):
    n = len(time_s)
    fade = np.exp(-np.abs(time_s[:, None] - time_s) / TAU_S)
    V = np.zeros((3 * n, 3 * n))
    for j in range(3):
        V[j::3, j::3] = fade * np.outer(sigma[:, j], sigma[:, j])
    for k in range(n):
        V[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += np.linalg.inv(white[k])
    return V


def summed(built, rows):
    return np.tensordot(rows, built.apply(rows), axes=((0, 1), (0, 1)))


def test_slow_and_white_noise_are_whitened_exactly(case):
    time_s, white, sigma, rows = case
    V, flat = dense(time_s, white, sigma), rows.reshape(-1, 4)
    built = factorise(time_s, white, sigma, TAU_S)
    expected = flat.T @ np.linalg.solve(V, flat)
    assert np.allclose(summed(built, rows), expected, rtol=1e-9)
    assert built.log_determinant == pytest.approx(np.linalg.slogdet(V)[1])


@pytest.mark.parametrize(("slow", "sees"), [(1.0, 3), (1.0, 2), (0.0, 3), (0.0, 2)])
def test_what_is_new_in_each_point_is_a_root_of_the_precision(case, slow, sees):
    time_s, white, sigma, rows = case
    white = white * (np.arange(3) < sees) * (np.arange(3) < sees)[:, None]
    built = factorise(time_s, white, slow * sigma, TAU_S)
    new = built.whiten(rows)
    assert np.allclose(new.T @ new, summed(built, rows), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("step_s", [1e-4, 1e-3])
def test_points_that_follow_at_once_are_whitened_to_many_digits(rng, step_s):
    time_s, white, sigma, rows = make_case(rng)
    time_s = step_s * np.arange(len(time_s))
    built = factorise(time_s, white, sigma, 60.0)
    new, expected = built.whiten(rows), summed(built, rows)
    assert np.abs(new.T @ new - expected).max() < 1e-7 * np.abs(expected).max()


def test_without_slow_noise_only_white_weights_remain_and_tell_more_and_no_tail(case):
    time_s, white, sigma, rows = case
    built = factorise(time_s, white, 0.0 * sigma, TAU_S)
    expected = np.einsum("kip,kij,kjq->pq", rows, white, rows)
    assert not built.factor.size
    assert np.allclose(summed(built, rows), expected)
    total, _, tail = extend(None, time_s, white, 0.0 * sigma, TAU_S, rows)
    assert tail is None
    assert np.allclose(total, summed(built, rows))
    gained = total - summed(factorise(time_s, white, sigma, TAU_S), rows)
    assert np.linalg.eigvalsh(gained).min() > 0.0


def test_a_direction_without_precision_carries_nothing(case, rng):
    time_s, white, sigma, rows = case
    blind = rng.normal(size=(len(time_s), 3))
    blind /= np.linalg.norm(blind, axis=1, keepdims=True)
    seen = np.eye(3) - blind[:, :, None] * blind[:, None, :]
    precision = seen @ white @ seen
    along = blind[:, :, None] * rng.normal(size=(len(time_s), 1, 4))
    built = factorise(time_s, precision, sigma, TAU_S)
    shifted = summed(built, rows + along)
    assert np.allclose(summed(built, rows), shifted, rtol=1e-9)


@given(cuts=st.sets(st.integers(1, 29), max_size=8))
@settings(deadline=None, max_examples=30)
def test_points_a_few_at_a_time_add_up_to_all_at_once(cuts):
    time_s, white, sigma, rows = make_case(np.random.default_rng(5))
    built = factorise(time_s, white, sigma, TAU_S)
    total, log_determinant, tail = np.zeros((4, 4)), 0.0, None
    for k in np.split(np.arange(30), sorted(cuts)):
        part = time_s[k], white[k], sigma[k], TAU_S, rows[k]
        gain, log_gain, tail = extend(tail, *part)
        total, log_determinant = total + gain, log_determinant + log_gain
    taken, log_taken = tail.marginalise()
    assert np.allclose(total - taken, summed(built, rows), rtol=1e-10, atol=1e-10)
    assert log_determinant + log_taken == pytest.approx(built.log_determinant)


def test_the_slow_covariance_and_its_inverse_undo_each_other(case, rng):
    time_s, _, sigma, _ = case
    ou = build_ou_precision(time_s, sigma, TAU_S)
    moved = rng.normal(size=sigma.shape)
    fade = np.exp(-np.abs(time_s[:, None] - time_s) / TAU_S)
    expected = np.einsum("kl,kj,lj,lj->kj", fade, sigma, sigma, moved)
    assert ou.solve(moved) == pytest.approx(expected)
    assert ou.multiply(expected) == pytest.approx(moved)


@pytest.mark.parametrize("size", [1, 3, 23, 24, 25, 48, 100])
@pytest.mark.parametrize("below", [1, 3])
def test_a_banded_factor_is_solved_as_the_dense_one(rng, size, below):
    factor = rng.uniform(-1.0, 1.0, (below + 1, size))
    factor[0] = rng.uniform(3.0, 5.0, size)
    dense = np.zeros((size, size))
    for i in range(min(below + 1, size)):
        dense += np.diag(factor[i, : size - i], -i)
    right = rng.normal(size=(size, 5))
    banded = BandedFactor.of(factor)
    half, whole = banded.solve_half(right), banded.solve(right)
    assert np.allclose(dense @ half, right, rtol=1e-12, atol=1e-12)
    assert np.allclose(dense @ (dense.T @ whole), right, rtol=1e-11, atol=1e-11)
