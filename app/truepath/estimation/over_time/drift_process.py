"""Change of a machine's errors with time and temperature, as a Gaussian process.

Each shape is a sum of states that start at the first Run: two that settle, each with a
time constant, a random walk, the daily cycle of the hall, and a part linear in
temperatures:

    d(t) = a exp(−t/τ₁) + b exp(−t/τ₂) + w(t) + h(t) − h(0) + Σ c_s T_s(t) / √n.

a, b and c are random constants, w is a Wiener process, h one of Matérn's of order 3/2
(Särkkä & Solin 2019, section 12.3). Runs of a few hours do not show the day that
follows, and its effect on all shapes has one cause: it is set to a typical share of the
settling parts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

# Logarithms: median and standard deviation of plausible sizes. A size of 1 is
# 10 µm or 20 µrad over the travel.
_USUAL = (
    (1.0, 1.2),  # size of the quick part
    (0.5, 1.2),  # of the slow part
    (0.5, 1.0),  # quick time constant, h
    (3.0, 0.7),  # how many times slower the slow one is, beyond 1.5
    (0.03, 1.2),  # walk in one hour
    (0.5, 0.3),  # daily cycle of the hall, of the settling parts
    (0.2, 1.0),  # for one K
)
SIZES = len(_USUAL)
_HOUR_S = 3600.0
_DAY_S = 6.0 * _HOUR_S  # in which air and foundations of a hall change


@dataclass(frozen=True, slots=True)
class Course:
    """Times in s since the first Run, with the temperatures then, (n, sensors)."""

    time_s: Float64[np.ndarray, " n"]
    celsius: Float64[np.ndarray, "n s"]


@dataclass(frozen=True, slots=True)
class DriftSizes:
    """Sizes of the states, relative to typical ones, and their time constants.

    walk : in one hour; per_kelvin : of all sensors together
    """

    quick: float
    slow: float
    quick_s: float
    slow_s: float
    walk: float
    day: float
    per_kelvin: float

    def compute_covariance(
        self, one: Course, other: Course
    ) -> Float64[np.ndarray, "n m"]:
        t, u = one.time_s[:, None], other.time_s[None, :]
        quick = self.quick**2 * np.exp(-(t + u) / self.quick_s)
        slow = self.slow**2 * np.exp(-(t + u) / self.slow_s)
        walk = self.walk**2 * np.minimum(t, u) / _HOUR_S
        day = self.day**2 * (
            _smooth(t - u) - _smooth(t) - _smooth(u) + _smooth(np.zeros((1, 1)))
        )
        sensors = max(one.celsius.shape[1], 1)
        warm = self.per_kelvin**2 * (one.celsius @ other.celsius.T) / sensors
        return quick + slow + walk + day + warm


def make_sizes(unit: Float64[np.ndarray, " s"]) -> DriftSizes:
    """From standard normal numbers to log-normal sizes."""
    quick, slow, hours, ratio, walk, day, warm = (
        median * float(np.exp(spread * z))
        for z, (median, spread) in zip(unit, _USUAL, strict=True)
    )
    quick_s = _HOUR_S * hours
    settles = float(np.hypot(quick, slow))
    slow_s = (1.5 + ratio) * quick_s
    return DriftSizes(quick, slow, quick_s, slow_s, walk, day * settles, warm)


def compute_prior_log(unit: Float64[np.ndarray, "n s"]) -> Float64[np.ndarray, " n"]:
    """Log density of the standard normal numbers, one for each row."""
    return -0.5 * (unit**2 + np.log(2.0 * np.pi)).sum(axis=1)


def _smooth(apart_s: Float64[np.ndarray, "n m"]) -> Float64[np.ndarray, "n m"]:
    share = np.sqrt(3.0) * np.abs(apart_s) / _DAY_S
    return (1.0 + share) * np.exp(-share)
