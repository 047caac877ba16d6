"""Figures that noise makes larger: the middle of the interval that it allows.

A range, or a repeatability, is the largest of many linear combinations a·m of the
measured m = t + e. So whatever the true t,

    f(m) − f(e) ≤ f(t) ≤ f(m) − a·e    with the a that is largest at t

The interval from f(m) less the 99 % quantile of f(e) to f(m) plus 1.96 times the
largest standard deviation of any a·e holds the true figure in 95 % of cases or more,
with some hundreds of draws of e as well. Its middle is stated, with half of it as
expanded uncertainty.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.special import ndtri

from truepath.answers.verification.places.matched_points import K

_BY_ERROR = 0.99
_SIDE = float(ndtri(0.975))


def enclose_largest(
    raw: float, by_error: Float64[np.ndarray, " e"], largest_sigma: float
) -> tuple[float, float]:
    """Middle of the interval, and its standard uncertainty (k = 1).

    raw : figure of the measurement; by_error : of draws of the error alone
    largest_sigma : largest standard deviation of the combinations a·e
    """
    more = float(np.quantile(by_error, _BY_ERROR))
    less = _SIDE * largest_sigma
    return raw - 0.5 * (more - less), 0.5 * (more + less) / K
