"""Score tests (Rao 1948): what a fit would gain if parameters were added to it.

Told by the residuals of the fit as it is, without another solve. With r = y − Aθ,
W = V⁻¹ (timing of the lines taken out), H = AᵀWA + prior and columns B of what might
be added, the gain is gᵀF⁻¹g with g = BᵀWr and F = BᵀWB − BᵀWA H⁻¹ AᵀWB.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

_UNSEEN = 1e-4  # of a column's information: the fit explains it all


def compute_score(
    left: Float64[np.ndarray, "l k k"],
    raw: Float64[np.ndarray, "l k k"],
    pulled: Float64[np.ndarray, "l k"],
) -> tuple[Float64[np.ndarray, "l k k"], Float64[np.ndarray, "l k"]]:
    """Return R and Rᵀ pulled, RRᵀ the inverse of the information that is left.

    raw : that before; directions of which the fit explains all have none
    """
    own = np.einsum("lii->li", raw)
    scale = np.where(own > 0.0, own, np.inf) ** -0.5
    scaled = left * scale[:, :, None] * scale[:, None, :]
    value, vector = np.linalg.eigh(scaled)
    seen = value > _UNSEEN
    size = np.where(seen, 1.0 / np.sqrt(np.where(seen, value, 1.0)), 0.0)
    root = scale[:, :, None] * vector * size[:, None, :]
    return root, np.einsum("lij,li->lj", root, pulled)
