"""Measured vectors, and samples of their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from truepath.files.units import UM_PER_MM

_SEED = 3


@dataclass(frozen=True, slots=True)
class SampledComponents:
    """Along given directions, µm; error_um : noise and common errors, sampled"""

    measured_um: Float64[np.ndarray, " k"]
    noise_um: Float64[np.ndarray, "k d"]
    error_um: Float64[np.ndarray, "k d"]


@dataclass(frozen=True, slots=True)
class SampledVectors:
    """Vectors at n positions, mm.

    noise_mm : sampled from the noise of measured_mm
    common_mm : by one standard uncertainty of each error that all positions share
    """

    measured_mm: Float64[np.ndarray, "n 3"]
    noise_mm: Float64[np.ndarray, "n 3 d"]
    common_mm: Float64[np.ndarray, "n 3 c"]

    def select(self, rows: Int64[np.ndarray, " r"]) -> SampledVectors:
        """By row number."""
        return SampledVectors(
            self.measured_mm[rows], self.noise_mm[rows], self.common_mm[rows]
        )

    def project(
        self, rows: Int64[np.ndarray, " k"], direction: Float64[np.ndarray, "k 3"]
    ) -> SampledComponents:
        """Components of some vectors, each along its own direction."""
        own = self.select(rows)
        noise_um = UM_PER_MM * np.einsum("ni,nie->ne", direction, own.noise_mm)
        common_um = UM_PER_MM * np.einsum("ni,nic->nc", direction, own.common_mm)
        # Common errors are the same at all positions: the same numbers per draw in
        # every call.
        size = own.common_mm.shape[2], own.noise_mm.shape[2]
        common = np.random.default_rng(_SEED).standard_normal(size)
        return SampledComponents(
            UM_PER_MM * np.einsum("ni,ni->n", direction, own.measured_mm),
            noise_um,
            noise_um + common_um @ common,
        )
