"""Errors of the tracker: a circle off its axis, and a wrong distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Role, columns_along
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from app.kinematics.effects.keys import choose_from
from app.kinematics.effects.sinusoid import find_amplitude_and_phase, sine_and_cosine

_USUAL_RAD = 2e-5
CIRCLES = ("azimuth", "elevation")


@dataclass(frozen=True)
class TrackerEccentricity(Effect):
    """The measured angle errs as sin and cos of itself, once a turn."""

    kind = "tracker-eccentricity"
    role = Role.MEASUREMENT
    units = {"sin": "rad", "cos": "rad"}
    circle: str

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return how the target seems to move in the frame the tracker stands on."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 2))
        x, y, z = at.recorded.tracker_mm.T
        flat = np.hypot(x, y)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, flat)
        if self.circle == "azimuth":
            angle = azimuth
            moved = np.stack([-y, x, np.zeros_like(x)], axis=1)
        else:
            angle = elevation
            moved = np.stack([-z * np.cos(azimuth), -z * np.sin(azimuth), flat], axis=1)
        return columns_along(moved @ at.recorded.rotation, sine_and_cosine(angle))


class TrackerEccentricityFamily(Family):
    """Both circles."""

    name = "tracker-eccentricity"
    role = Role.MEASUREMENT
    keys = {"circle": choose_from("({})", CIRCLES)}
    words = read_words("""
        [en]
        title = Eccentric circle of the tracker
        cause = The encoder circle of the tracker sits off its axis, or was shaken.
        looks_like = Points are turned about the tracker by an angle that follows a sine
            of the direction looked in, whatever axis moves.
        remedy = Run the tracker's own compensation (two-face and circle tests); measure
            from a second place to separate it from the machine.
        [de]
        title = Exzentrischer Teilkreis des Trackers
        cause = Der Teilkreis des Trackers sitzt neben seiner Achse oder hat einen Stoß
            bekommen.
        looks_like = Die Punkte sind um den Tracker um einen Winkel gedreht, der einem
            Sinus der Blickrichtung folgt, gleich welche Achse fährt.
        remedy = Die eigene Kompensation des Trackers durchführen (Zweilagen- und
            Kreistest); von einem zweiten Standort messen, um es von der Maschine zu
            trennen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one a circle."""
        if at.recorded is None:
            return []
        effects = map(TrackerEccentricity, CIRCLES)
        return [self.offer(effect, [_USUAL_RAD] * 2) for effect in effects]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return amplitude and phase."""
        amplitude, phase = find_amplitude_and_phase(found.theta, found.covariance)
        return {"amplitude_urad": amplitude.scale(1e6), "phase_rad": phase}


@dataclass(frozen=True)
class TrackerRangeOffset(Effect):
    """Every distance is too long by the same amount."""

    kind = "tracker-range-offset"
    role = Role.MEASUREMENT
    units = {"": "mm"}

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 1"]:
        """Return the unit beam in the frame the tracker stands on."""
        if at.recorded is None:
            return np.zeros((len(at), 3, 1))
        distance = np.linalg.norm(at.recorded.tracker_mm, axis=1, keepdims=True)
        beam = at.recorded.tracker_mm / distance
        return (beam @ at.recorded.rotation)[:, :, None]


class TrackerRangeOffsetFamily(Family):
    """One candidate."""

    name = "tracker-range-offset"
    role = Role.MEASUREMENT
    stated = {"offset_um": 1e3}
    words = read_words("""
        [en]
        title = Range offset of the tracker
        cause = The tracker's home distance, or the constant of the reflector in use, is
            wrong.
        looks_like = All points lie too far from the tracker by the same amount: the
            volume looks bent about it.
        remedy = Set the home distance again with the reflector in its nest; choose the
            right reflector in the tracker's software.
        [de]
        title = Distanzversatz des Trackers
        cause = Die Nulldistanz des Trackers oder die Konstante des verwendeten
            Reflektors ist falsch.
        looks_like = Alle Punkte liegen um denselben Betrag zu weit vom Tracker: Der
            Raum wirkt um ihn gebogen.
        remedy = Die Nulldistanz mit dem Reflektor in seiner Aufnahme neu setzen; in der
            Software des Trackers den richtigen Reflektor wählen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return the offset."""
        if at.recorded is None:
            return []
        return [self.offer(TrackerRangeOffset(), [4.0 * USUAL_MM])]
