"""What the scale that all lengths have in common makes of a statistic of them.

A mean length is least near the right scale: it grows with the square of what the scale
is off. Twice the standard uncertainty, each way, therefore tells what one contributes;
where the statistic is linear in the scale the two are the same.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

TWICE: tuple[float, float] = (-2.0, 2.0)


def state_scale_share(
    value: Float64[np.ndarray, " m"], at_twice: Float64[np.ndarray, "m 2"]
) -> Float64[np.ndarray, " m"]:
    """Return the standard uncertainty of statistics by the scale of their lengths.

    at_twice : the same with all lengths off by `TWICE` its standard uncertainty
    """
    return 0.5 * np.max(np.abs(at_twice - value[:, None]), axis=1)
