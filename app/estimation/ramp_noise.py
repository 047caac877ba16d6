"""How far ramps scatter beyond the noise: a machine that swings after each jerk, say.

What is in proportion to the acceleration is solved for beside the error motions. What
else acceleration does has no model; the data of ramps then count by how far they are
off, so that they never count for more than they tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from truepath.app.alignment.observations import Observations
from truepath.app.estimation.noise import split_sigma_mm
from truepath.app.estimation.runs import RunInformation, RunInput

_TOLERATED = 0.3  # of the variance of noise: less is chance
_CLOSE = 0.1  # of the variance that ramps have already


def widen_ramps(
    inputs: Sequence[RunInput],
    runs: Sequence[RunInformation],
    across_mm: Sequence[Float64[np.ndarray, " _n"]],
    travel: Sequence[Float64[np.ndarray, "_n 3"]],
) -> tuple[RunInput, ...] | None:
    """Return the Runs with the scatter of their ramps; None where it is known already.

    runs : as they were solved; across_mm : what that leaves across the travel of cells
    """
    found: list[RunInput] = []
    for given, run, across, along in zip(inputs, runs, across_mm, travel, strict=True):
        sigma_mm = _find_scatter_mm(run, across, along)
        noise = replace(run.noise, ramp_sigma_mm=sigma_mm)
        found.append(replace(given, noise=noise))
    changes = [
        abs(new.noise.ramp_sigma_mm**2 - old.noise.ramp_sigma_mm**2)
        > _CLOSE * old.noise.ramp_sigma_mm**2
        for new, old in zip(found, runs, strict=True)
    ]
    return tuple(found) if any(changes) else None


def _find_scatter_mm(
    run: RunInformation,
    across_mm: Float64[np.ndarray, " n"],
    travel: Float64[np.ndarray, "n 3"],
) -> float:
    """Return the standard deviation of a ramp's cell beyond the noise.

    All cells of a ramp may be off together, and so each counts for less.
    """
    seen = run.observations
    ramp = seen.is_ramp
    if not ramp.any():
        return 0.0
    white, ou = split_sigma_mm(seen, replace(run.noise, ramp_sigma_mm=0.0))
    stated = ((white**2 + ou**2) * (1.0 - travel**2)).sum(axis=1)
    usual = max(1.0, float((across_mm[~ramp] ** 2).mean() / stated[~ramp].mean()))
    noise = usual * float(stated[ramp].mean())
    excess = float((across_mm[ramp] ** 2).mean()) - noise
    if excess < _TOLERATED * noise:
        return 0.0
    return float(np.sqrt(0.5 * excess * _count_cells_of_ramp(seen)))


def _count_cells_of_ramp(seen: Observations) -> float:
    ramp = seen.is_ramp
    begins = [first for first, _ in seen.stretches if ramp[first]]
    return float(np.count_nonzero(ramp)) / len(begins)
