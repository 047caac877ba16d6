"""Contribution of the common scale of all lengths to a statistic of them.

A mean length is least near the right scale: it grows with the square of the error of
the scale. Half the change at twice the standard uncertainty, the larger of both signs,
is therefore stated; where the statistic is linear in the scale it is the same as that
at once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

TWICE: tuple[float, float] = (-2.0, 2.0)


def compute_scale_uncertainty(
    value: Float64[np.ndarray, " m"], at_twice: Float64[np.ndarray, "m 2"]
) -> Float64[np.ndarray, " m"]:
    """Standard uncertainty of statistics by the scale of their lengths.

    at_twice : the same with all lengths off by `TWICE` its standard uncertainty
    """
    return 0.5 * np.max(np.abs(at_twice - value[:, None]), axis=1)
