"""Information on a machine before the next leg, and the information of a leg.

A leg is a motion from one stop to the next: a line that is measured on the way, or a
move to a point that is measured at rest. The criterion is the integrated variance J =
tr(G C) of the volumetric error over the travel (brunn-hanebeck-2005, eq. 34–36), C the
covariance of the error motions, G the Gram matrix.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from truepath.kinematics.conditions import Conditions, observe_targets
from truepath.kinematics.machine.machine import Machine, Target
from truepath.kinematics.model import MachineModel
from truepath.motion.configurations import Commanded
from truepath.motion.motion_times import Drive, Legs, Stops
from truepath.numerics.scaled_cholesky import ScaledCholesky


@dataclass(frozen=True, slots=True)
class ExpectedNoise:
    """Noise of the tracker, white and correlated together, as if it were white.

    density_s : (2,) along and across the beam: variance of the mean over a second, in
        units of the specified variance of one sample
    jitter_mm2_s : the same of the feed, along the travel of a line; infinite where only
        deviations across the path are used
    """

    density_s: tuple[float, float]
    jitter_mm2_s: float


@dataclass(frozen=True)
class DesignState(ABC):
    """Present information, and how legs are measured.

    model : effects of the machine, then the tracker's pose
    precision : (p, p) information so far, prior included
    gram : (p, p), θᵀ G θ is the mean square of the volumetric error, mm²
    station_mm : (3,) of the tracker, in the frame that it is mounted on
    drive : motion limits of the machine, and the dwell at stops
    order_is_free : stops may be permuted; only their approach depends on the order
    """

    model: MachineModel
    target: Target
    precision: Float64[np.ndarray, "p p"]
    gram: Float64[np.ndarray, "p p"]
    station_mm: Float64[np.ndarray, "3"]
    noise: ExpectedNoise
    drive: Drive
    order_is_free = False

    @abstractmethod
    def rows(self, legs: Legs) -> Float64[np.ndarray, "n r p"]:
        """Rows H of each leg with HᵀH its information."""

    @abstractmethod
    def fits(self, legs: Legs) -> Bool[np.ndarray, " n"]:
        """Mask of the legs that are long enough to be recognised and measured."""

    @abstractmethod
    def command(self, machine: Machine, stops: Stops) -> Commanded:
        """The stops as a path or as points for all axes of the machine."""

    def restrict_axes(
        self, ends: Float64[np.ndarray, "n a"], here: Float64[np.ndarray, " a"]
    ) -> Float64[np.ndarray, "n a"]:
        """Ends of legs from `here`; a design may keep some axes of some at rest."""
        return ends

    def find_better_positions(
        self,
        covariance: Float64[np.ndarray, "p p"],
        here: Float64[np.ndarray, " a"],
    ) -> Float64[np.ndarray, "n a"]:
        """Candidates that may improve a stop that is already good.

        covariance : of the parameters, without the legs that meet in the stop
        """
        return np.empty((0, len(here)))

    def _name_target(self, rows: int) -> tuple[str, ...]:
        return (self.target.name,) * rows if self.target.name else ()

    @property
    def integrated_variance(self) -> float:
        """J, mm² (brunn-hanebeck-2005, eq. 34)."""
        return float(np.sum(inverse(self.precision) * self.gram))

    def information(self, legs: Legs) -> Float64[np.ndarray, "p p"]:
        """Sum over all legs."""
        if not len(legs):
            return np.zeros_like(self.precision)
        rows = self.rows(legs)
        flat = rows.reshape(-1, rows.shape[2])
        return flat.T @ flat

    def add(self, precision: Float64[np.ndarray, "p p"]) -> DesignState:
        """Adds information."""
        return replace(self, precision=self.precision + precision)

    def conditions(
        self, position: Float64[np.ndarray, "n a"], approach: Float64[np.ndarray, "n a"]
    ) -> Conditions:
        """For the design's target, approached by motions of these signs."""
        at = observe_targets(self.model.machine, position, [self.target])
        return replace(at, approach=approach)

    def roots(
        self,
        at: Conditions,
        direction: Float64[np.ndarray, "n 3"] | None = None,
        jitter_mm2_s: float | Float64[np.ndarray, " n"] = 0.0,
    ) -> Float64[np.ndarray, "n 3 3"]:
        """W with WᵀW the information of one second at each position, 1/mm².

        direction : of travel, in which the jitter counts
        """
        beam = at.point_mm - self.station_mm
        distance = np.linalg.norm(beam, axis=1)
        beam = beam / distance[:, None]
        stated = at.machine.tracker.sigma_mm(distance) ** 2 * self.noise.density_s
        along, across = (stated**-0.5).T[:, :, None, None]
        root = across * np.eye(3)
        root = root + (along - across) * beam[:, :, None] * beam[:, None, :]
        if direction is None:
            return root
        # P − w P u uᵀ P is R (1 − w s sᵀ) R with s = R u, the root of P being R.
        seen = (root @ direction[:, :, None])[:, :, 0]
        total = np.maximum((seen**2).sum(axis=1), 1e-30)
        kept = 1.0 / (1.0 + np.asarray(jitter_mm2_s) * total)  # 1 − w sᵀ s
        cut = (1.0 - np.sqrt(kept)) / total
        pulled = (seen[:, None, :] @ root)[:, 0]
        return root - (cut[:, None] * seen)[:, :, None] * pulled[:, None, :]


def inverse(matrix: Float64[np.ndarray, "p p"]) -> Float64[np.ndarray, "p p"]:
    """Of a positive definite matrix of different units."""
    return ScaledCholesky.of(matrix).invert()
