"""The curve of a target on a line on which rotary axes turn.

A cubic spline through exact places at equal shares of the line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

NODES = 8  # of a line, and one more a degree: then a spline is good to a nanometre
_STRAIGHT_MM = 1e-6  # off the chord: rounding
_BRANCH = 0.05  # weight of what was travelled against what is near


@dataclass(frozen=True)
class Bend:
    """Where the target should be over the share of the line that is done, 0 to 1.

    node_mm : (k, 3) places at equal shares
    """

    node_mm: Float64[np.ndarray, "k 3"]

    @cached_property
    def share(self) -> Float64[np.ndarray, " k"]:
        """Return the shares of the nodes."""
        return np.linspace(0.0, 1.0, len(self.node_mm))

    def point_mm(self, share: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """Return where the target should be."""
        return self._spline(share)

    def slope_mm(self, share: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """Return its derivative by the share."""
        return self._spline(share, 1)

    def is_straight(self) -> bool:
        """Tell whether the target goes straight and evenly all the same."""
        begin, end = self.node_mm[0], self.node_mm[-1]
        chord = begin + self.share[:, None] * (end - begin)
        return bool(np.abs(self.node_mm - chord).max() <= _STRAIGHT_MM)

    def length_mm(self) -> float:
        """Return the length of the curve: its mean slope by Simpson's rule."""
        finer = np.linspace(0.0, 1.0, 2 * len(self.node_mm) - 1)
        slope = np.linalg.norm(self.slope_mm(finer), axis=1)
        weight = np.full(len(slope), 2.0)
        weight[1::2] = 4.0
        weight[[0, -1]] = 1.0
        return float(weight @ slope / weight.sum())

    def nearest(
        self,
        point_mm: Float64[np.ndarray, "n 3"],
        travelled_mm: Float64[np.ndarray, " n"] | None = None,
    ) -> Float64[np.ndarray, " n"]:
        """Return the share nearest to each point.

        travelled_mm : way since the beginning of the line: a rough one tells the
            branches apart where the curve comes back to a place
        """
        share = self.share[self._nearest_node(point_mm, travelled_mm)]
        most = 1.5 * float(self.share[1])
        for _ in range(2):
            slope = self.slope_mm(share)
            off = np.einsum("ni,ni->n", point_mm - self.point_mm(share), slope)
            square = np.maximum(np.einsum("ni,ni->n", slope, slope), 1e-12)
            share = np.clip(share + np.clip(off / square, -most, most), 0.0, 1.0)
        return share

    def _nearest_node(
        self,
        point_mm: Float64[np.ndarray, "n 3"],
        travelled_mm: Float64[np.ndarray, " n"] | None,
    ) -> Int64[np.ndarray, " n"]:
        # Imported where a line is bent, as below: few are, and all would wait for it.
        from scipy.spatial import KDTree

        step = np.linalg.norm(np.diff(self.node_mm, axis=0), axis=1)
        run = np.concatenate([[0.0], np.cumsum(step)])
        if travelled_mm is None:
            travelled_mm, run = np.zeros(len(point_mm)), np.zeros(len(run))
        tree = KDTree(np.column_stack([self.node_mm, _BRANCH * run]))
        sought = np.column_stack([point_mm, _BRANCH * travelled_mm])
        return np.asarray(tree.query(sought)[1], np.int64)

    @cached_property
    def _spline(self) -> Callable[..., Float64[np.ndarray, "n 3"]]:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.share, self.node_mm)
