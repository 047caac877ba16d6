"""What a fit leaves of a Run's data, the timing of each line estimated anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from app.estimation.elimination import fit_timing
from app.estimation.line_blocks import Line
from app.estimation.noise import NoiseModel
from app.estimation.run_data import RunData
from app.estimation.within_cells import Within
from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect


@dataclass(frozen=True)
class Residual:
    """Residual of a Run, mm, in the frame that the tracker stands on.

    residual_mm, weighted : (n, 3) r and V⁻¹ r, phase and speed of each line taken out
    precision : (n, 3, 3) of the white noise
    ou, ou_time_s : density of the Ornstein–Uhlenbeck noise over that of the white
        noise at frequency 0, and its correlation time
    within : samples within their cells, where fast effects show as well
    """

    at: Conditions
    residual_mm: Float64[np.ndarray, "n 3"]
    weighted: Float64[np.ndarray, "n 3"]
    precision: Float64[np.ndarray, "n 3 3"]
    ou: float
    ou_time_s: float
    within: Within | None = None

    def ou_density(
        self, frequency_hz: Float64[np.ndarray, " f"]
    ) -> Float64[np.ndarray, " f"]:
        """Return the density of the Ornstein–Uhlenbeck noise over the white noise's."""
        angle = 2.0 * np.pi * frequency_hz * self.ou_time_s
        return self.ou / (1.0 + angle**2)


def weight_residual(
    data: RunData,
    lines: Sequence[Line],
    effects: Sequence[Effect],
    theta: Float64[np.ndarray, " p"],
) -> Residual:
    """Return what machine, pose and effects leave of a Run.

    lines : of this Run; theta : of machine and poses, then of the effects
    """
    seen, base = data.observations, data.base
    residual_mm, weighted = np.zeros((2, len(seen), 3))
    precision = np.zeros((len(seen), 3, 3))
    moved = _displacement_mm(seen.at, effects, theta[base.size :])
    for line in lines:
        design, frame = line.design, line.design.frame
        left = design.residual - design.columns @ theta[: base.size]
        left = (left - np.einsum("nij,nj->ni", frame, moved[line.cells]))[:, :, None]
        late, timing = fit_timing(line.whitener, design.timing, left)
        solved = line.whitener.apply(left) - timing @ late
        left = left - design.timing @ late
        weighted[line.cells] = np.einsum("nij,nik->nj", frame, solved)
        residual_mm[line.cells] = np.einsum("nij,nik->nj", frame, left)
        root = np.matmul(line.whitener.root, frame)
        precision[line.cells] = np.matmul(np.swapaxes(root, 1, 2), root)
    noise, rate_hz = base.noise, seen.at.machine.tracker.rate_hz
    return Residual(
        seen.at,
        residual_mm,
        weighted,
        precision,
        _ou_over_white(noise, rate_hz),
        noise.ou_time_s,
        data.within,
    )


def _displacement_mm(
    at: Conditions, effects: Sequence[Effect], theta: Float64[np.ndarray, " q"]
) -> Float64[np.ndarray, "n 3"]:
    ends = np.cumsum([0, *(len(effect.parameters) for effect in effects)])
    moved = np.zeros((len(at), 3))
    for effect, (first, last) in zip(effects, pairwise(ends), strict=True):
        moved += effect.jacobian(at) @ theta[first:last]
    return moved


def _ou_over_white(noise: NoiseModel, rate_hz: float) -> float:
    """Return the ratio of densities of both parts of the noise at frequency 0."""
    ratio = np.mean(np.square(noise.ou)) / np.mean(np.square(noise.white))
    return float(ratio) * 2.0 * noise.ou_time_s * rate_hz
