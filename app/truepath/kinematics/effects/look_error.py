"""An error of the tracker that depends on its beam direction, without a known cause.

Smooth shapes of azimuth and elevation, of range or either angle. They describe what no
catalogued cause explains, and a cause has to explain more than they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.base import Role
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import choose_from
from truepath.kinematics.effects.polynomials import multiply_shares
from truepath.kinematics.effects.tracker_beam import BeamEffect, BeamFamily

_PAIRS = [(i, j) for i, j in product(range(5), repeat=2) if 0 < i + j < 5]
_MEAN_SQUARE = 0.15  # of a shape over the directions
_LOOKS = ("range", "azimuth", "elevation")


@dataclass(frozen=True)
class DirectionalTrackerError(BeamEffect):
    """Range, or an angle, has an error that depends on the direction of the beam.

    middle, half : (2,) of azimuth from the mean direction, and of elevation, rad
    turn_rad : the mean azimuth; reach_mm : typical length of the beam
    """

    kind = "look-error"
    role = Role.STRUCTURE
    units = {f"{i}{j}": "mm" for i, j in _PAIRS}
    quantity: str
    turn_rad: float
    middle: tuple[float, float]
    half: tuple[float, float]
    reach_mm: float

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Apparent displacement of the target, in the tracker's frame."""
        x, y, z = recorded.tracker_mm.T
        flat = np.hypot(x, y)
        if self.quantity == "range":
            return np.stack([x, y, z], axis=1) / np.hypot(flat, z)[:, None]
        if self.quantity == "azimuth":
            return np.stack([-y, x, 0.0 * z], axis=1) / self.reach_mm
        return np.stack([-z * x / flat, -z * y / flat, flat], axis=1) / self.reach_mm

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n p"]:
        """Products of polynomials of both angles."""
        del at
        angles = _look_angles(recorded, self.turn_rad)
        each = zip(angles, self.middle, self.half, strict=True)
        shares = (0.5 + 0.5 * (a - m) / h for a, m, h in each)
        return multiply_shares(shares, _PAIRS)


def _look_angles(
    recorded: RecordedState, turn_rad: float
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    x, y, z = recorded.tracker_mm.T
    azimuth = np.angle(np.exp(1j * (np.arctan2(y, x) - turn_rad)))
    return azimuth, np.arctan2(z, np.hypot(x, y))


class LookErrorFamily(BeamFamily):
    """One candidate each for range, azimuth and elevation."""

    name = "look-error"
    effect = DirectionalTrackerError
    ends_with_run = True
    varies_with = "place"
    keys = {"quantity": choose_from("of {}", _LOOKS)}
    covariates = ("azimuth", "elevation")
    sentence = (
        "the tracker's {quantity} errs by the direction it looks in, by {rms_um:.2g} "
        "µm at the target (root mean square)"
    )
    words = read_words("""
        [en]
        title = Error by the direction of the beam
        cause = The tracker's circles and axes, or air that is warmer on one side.
        looks_like = The error follows the direction that the tracker looks in, whatever
            axis moves.
        remedy = Compensate the tracker; keep warm air out of the beam; measure from a
            second place to separate it from the machine.
        [de]
        title = Fehler nach der Richtung des Strahls
        cause = Teilkreise und Achsen des Trackers, oder Luft, die auf einer Seite
            wärmer ist.
        looks_like = Der Fehler folgt der Richtung, in die der Tracker blickt, gleich
            welche Achse fährt.
        remedy = Den Tracker kompensieren; warme Luft vom Strahl fernhalten; von einem
            zweiten Standort messen, um es von der Maschine zu trennen.
        """)

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """One per quantity."""
        del at
        x, y, z = recorded.tracker_mm.mean(axis=0).tolist()
        turn_rad = float(np.arctan2(y, x))
        angles = _look_angles(recorded, turn_rad)
        (m1, h1), (m2, h2) = (_middle_and_half(angle) for angle in angles)
        reach_mm = float(np.hypot(np.hypot(x, y), z))
        about = (turn_rad, (m1, m2), (h1, h2), reach_mm)
        falling = USUAL_MM / np.array([i + j for i, j in _PAIRS])
        return [
            self.make_candidate(DirectionalTrackerError(look, *about), falling)
            for look in _LOOKS
        ]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Root mean square over the directions, µm."""
        even = np.full(len(_PAIRS), _MEAN_SQUARE)
        return {"rms_um": found.root_mean_square(even).scale(1e3)}


def _middle_and_half(values: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return 0.5 * (low + high), max(0.5 * (high - low), 1e-6)
