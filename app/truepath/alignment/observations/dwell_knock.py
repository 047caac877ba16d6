"""A knock within a dwell, told from its own samples.

All samples of a dwell become one cell. Where tracker or reflector was knocked in it,
their mean is of neither place. A knock is sudden: two means, before and after it, leave
of either side no more than its noise, and the samples next to it differ as the sides
do. A swing, a settling or a drift leaves a quarter of what the sides differ by, or
more; air that wanders may leave less, but takes time.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from truepath.alignment.observations.reduction import beam_frame

_FEWEST, _SHORTEST = 5, 0.1  # samples of a side, at the least; share of the dwell
_QUARTERS = 4
_CLEARLY = 8.0  # times what a side varies by
_BESIDE, _AT_ONCE = 0.05, 0.7  # of the dwell; of the step
_LEAST_MM = 0.005  # less moves the mean by less than the air does


def find_knock(tracker_mm: Float64[np.ndarray, "n 3"]) -> tuple[int, float] | None:
    """The first sample after a knock and the size of the knock in mm.

    None where the target stood still.
    """
    n = len(tracker_mm)
    least = max(_FEWEST, round(_SHORTEST * n))
    first = np.arange(least, n - least + 1)
    if not len(first):
        return None
    middle_mm = tracker_mm.mean(axis=0)
    rest = (tracker_mm - middle_mm) @ beam_frame(middle_mm[None])[0].T
    noise = np.sqrt(np.mean(np.diff(rest, axis=0) ** 2, axis=0) / 2.0)
    before = np.cumsum(rest / np.maximum(noise, 1e-9), axis=0)[first - 1]
    gain = np.sum(before**2, axis=1) / (first * (n - first))
    knock = int(first[np.argmax(gain)])
    sides = rest[:knock], rest[knock:]
    by_noise = noise * np.sqrt(_QUARTERS / min(map(len, sides)))
    varies = np.max([by_noise, *map(_measure_variation, sides)], axis=0)
    step = sides[1].mean(axis=0) - sides[0].mean(axis=0)
    near = max(_FEWEST, round(_BESIDE * n))
    at_once = sides[1][:near].mean(axis=0) - sides[0][-near:].mean(axis=0)
    is_clear = np.abs(step) > np.maximum(_CLEARLY * varies, _LEAST_MM)
    is_sudden = at_once * np.sign(step) > _AT_ONCE * np.abs(step)
    if not (is_clear & is_sudden).any():
        return None
    return knock, float(np.linalg.norm(step))


def _measure_variation(side: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Root mean square of what its quarters are off its mean."""
    means = np.array([part.mean(axis=0) for part in np.array_split(side, _QUARTERS)])
    return np.sqrt(np.mean((means - side.mean(axis=0)) ** 2, axis=0))
