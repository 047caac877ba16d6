"""A displacement that depends on two axes at once: non-rigid behaviour in general.

Bicubic in the positions of two axes, without terms of one of them alone: error motions
contain these already (the surface that brunn-hanebeck-2005 leaves to future work).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.error_motion import find_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import DIRECTION, PLANE
from truepath.kinematics.effects.polynomials import multiply_shares
from truepath.kinematics.machine.machine import LinearAxis
from truepath.kinematics.machine.symbols import LINEAR

_DEGREE = 3
_PAIRS = [(i, j) for i in range(1, _DEGREE + 1) for j in range(1, _DEGREE + 1)]


@dataclass(frozen=True)
class PlaneError(Effect):
    """Products of Legendre polynomials of two positions, in one direction."""

    kind = "plane-error"
    role = Role.STRUCTURE
    units = {f"{i}{j}": "mm" for i, j in _PAIRS}
    first: LinearAxis
    second: LinearAxis
    direction: str

    @property
    def plane(self) -> str:
        """Names of both axes, as in files."""
        return self.first.name + self.second.name

    @property
    def axis_pair(self) -> tuple[str, str]:
        """Both axes of the plane."""
        return self.first.name, self.second.name

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 9"]:
        """Direction times the products."""
        shares = (at.axis_share(axis) for axis in (self.first, self.second))
        arm = find_arm(f"E{self.direction}{self.first.name}", at)
        return columns_along(arm, multiply_shares(shares, _PAIRS))


def _in_plane(plane: tuple[LinearAxis, LinearAxis], direction: str) -> PlaneError:
    return PlaneError(*plane, direction)


class PlaneErrorFamily(Family):
    """One candidate per plane and direction."""

    name = "plane-error"
    effect = PlaneError
    varies_with = "place"
    makes = _in_plane
    keys = {"plane": PLANE, "direction": DIRECTION}
    covariates = ("{plane[0]}", "{plane[1]}")
    sentence = (
        "a displacement along {direction} of {rms_um:.2g} µm (root mean square) that "
        "depends on {plane[0]} and {plane[1]} together"
    )
    words = read_words("""
        [en]
        title = Error of two axes at once
        cause = Structure that gives way under moving loads in a way no single beam
            explains.
        looks_like = An error that depends on where two axes stand at once.
        remedy = Compensate with a grid of the plane or volume instead of single axes.
        [de]
        title = Fehler zweier Achsen zugleich
        cause = Ein Aufbau, der unter bewegten Lasten so nachgibt, wie es kein einzelner
            Balken erklärt.
        looks_like = Ein Fehler, der davon abhängt, wo zwei Achsen zugleich stehen.
        remedy = Statt einzelner Achsen mit einem Gitter der Ebene oder des Raums
            kompensieren.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """One per pair of axes and direction."""
        falling = np.array([1.0 / (i * j) for i, j in _PAIRS])
        return [
            self.make_candidate(PlaneError(*plane, direction), USUAL_MM * falling)
            for plane in combinations(at.machine.linear_axes, 2)
            for direction in LINEAR
        ]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Root mean square over the plane, µm."""
        weight = np.array([1.0 / ((2 * i + 1) * (2 * j + 1)) for i, j in _PAIRS])
        return {"rms_um": found.root_mean_square(weight).scale(1e3)}
