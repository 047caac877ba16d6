"""Vectors at places as measured, and what their errors may be, drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.files.units import UM_PER_MM

_SEED = 3


@dataclass(frozen=True, slots=True)
class DrawnComponents:
    """Components along given directions, µm; error_um : noise and common scale."""

    measured_um: Float64[np.ndarray, " k"]
    noise_um: Float64[np.ndarray, "k d"]
    error_um: Float64[np.ndarray, "k d"]


@dataclass(frozen=True, slots=True)
class DrawnVectors:
    """Vectors at n places, mm.

    noise_mm : drawn from the noise of measured_mm
    scale_mm : what one standard uncertainty of the scale makes of each
    """

    measured_mm: Float64[np.ndarray, "n 3"]
    noise_mm: Float64[np.ndarray, "n 3 d"]
    scale_mm: Float64[np.ndarray, "n 3"]

    def select(self, rows: Int64[np.ndarray, " r"]) -> DrawnVectors:
        """Return some of the places."""
        return DrawnVectors(
            self.measured_mm[rows], self.noise_mm[rows], self.scale_mm[rows]
        )

    def project(
        self, rows: Int64[np.ndarray, " k"], direction: Float64[np.ndarray, "k 3"]
    ) -> DrawnComponents:
        """Return the components of some places, each along its own direction."""
        own = self.select(rows)
        noise_um = UM_PER_MM * np.einsum("ni,nie->ne", direction, own.noise_mm)
        scale_um = UM_PER_MM * np.einsum("ni,ni->n", direction, own.scale_mm)
        # All places err together: one number a draw, the same wherever it is asked for.
        draws = int(own.noise_mm.shape[2])
        common = np.random.default_rng(_SEED).standard_normal(draws)
        return DrawnComponents(
            UM_PER_MM * np.einsum("ni,ni->n", direction, own.measured_mm),
            noise_um,
            noise_um + scale_um[:, None] * common,
        )
