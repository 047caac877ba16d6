"""What one would write first: candidates on a grid, a dense posterior for each.

No closed forms, no roots, no rank-one shortcuts: the covariance after each candidate
is computed in full, and the best trace taken.
"""

from __future__ import annotations

import numpy as np


def best_of_grid(
    covariance: np.ndarray, gram: np.ndarray, rows: np.ndarray, variance: float
) -> tuple[int, float]:
    """Return the best of candidates' rows (n, r, p) and the J that it leaves."""
    identity = np.eye(rows.shape[1])
    left = np.empty(len(rows))
    for k, H in enumerate(rows):
        gain = (
            covariance @ H.T @ np.linalg.inv(H @ covariance @ H.T + variance * identity)
        )
        posterior = covariance - gain @ H @ covariance
        left[k] = np.trace(gram @ posterior)
    best = int(np.argmin(left))
    return best, float(left[best])


def dense_search(
    covariance: np.ndarray, gram: np.ndarray, rows: np.ndarray, variance: float
) -> float:
    """Return the largest fall of J among many rows (n, p), all at once."""
    moved = rows @ covariance
    gained = np.einsum("np,np->n", moved @ gram, moved)
    return float((gained / (variance + np.einsum("np,np->n", moved, rows))).max())
