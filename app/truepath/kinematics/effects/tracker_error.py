"""Errors of the tracker: eccentric circles, index error, range offset.

Averaging does not reduce them, and a tracker within its specification has all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import choose_from
from truepath.kinematics.effects.sinusoid import (
    find_amplitude_and_phase,
    sine_and_cosine,
)
from truepath.kinematics.effects.tracker_beam import (
    BeamEffect,
    BeamFamily,
    raise_beam,
)

_USUAL_RAD = 2e-5
CIRCLES = ("azimuth", "elevation")


@dataclass(frozen=True)
class TrackerEccentricity(BeamEffect):
    """The measured angle has an error of sin and cos of itself, once per turn."""

    kind = "tracker-eccentricity"
    units = {"sin": "rad", "cos": "rad"}
    circle: str

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Displacement of the target by a turn about the circle's axis."""
        if self.circle == "elevation":
            return raise_beam(recorded)
        x, y, _ = recorded.tracker_mm.T
        return np.stack([-y, x, np.zeros_like(x)], axis=1)

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n 2"]:
        """Sine and cosine of the angle."""
        del at
        x, y, z = recorded.tracker_mm.T
        sides = (y, x) if self.circle == "azimuth" else (z, np.hypot(x, y))
        return sine_and_cosine(np.arctan2(*sides))


class TrackerEccentricityFamily(BeamFamily):
    """One candidate per circle."""

    name = "tracker-eccentricity"
    effect = TrackerEccentricity
    varies_with = "place"
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
        cause = Der Teilkreis des Trackers sitzt neben seiner Achse oder hat sich
            verschoben.
        looks_like = Die Punkte sind um den Tracker um einen Winkel gedreht, der einem
            Sinus der Blickrichtung folgt, gleich welche Achse fährt.
        remedy = Die eigene Kompensation des Trackers durchführen (Zweilagen- und
            Kreistest); von einem zweiten Standort messen, um es von der Maschine zu
            trennen.
        """)

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """One per circle."""
        del at, recorded
        effects = map(TrackerEccentricity, CIRCLES)
        return [self.make_candidate(effect, [_USUAL_RAD] * 2) for effect in effects]

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Amplitude in µrad, and phase."""
        amplitude, phase = find_amplitude_and_phase(found.theta, found.covariance)
        return {"amplitude_urad": amplitude.scale(1e6), "phase_rad": phase}


@dataclass(frozen=True)
class TrackerRangeOffset(BeamEffect):
    """Every distance is too long by the same amount."""

    kind = "tracker-range-offset"
    units = {"": "mm"}

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Unit beam."""
        beam = recorded.tracker_mm
        return beam / np.linalg.norm(beam, axis=1, keepdims=True)


class TrackerRangeOffsetFamily(BeamFamily):
    """A single candidate, for any machine."""

    name = "tracker-range-offset"
    effect = TrackerRangeOffset
    varies_with = "place"
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

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """A single candidate."""
        del at, recorded
        return [self.make_candidate(TrackerRangeOffset(), [4.0 * USUAL_MM])]


@dataclass(frozen=True)
class ElevationIndex(BeamEffect):
    """Every elevation is read too high by the same angle."""

    kind = "elevation-index"
    units = {"": "rad"}

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Apparent rise of the target."""
        return raise_beam(recorded)


class ElevationIndexFamily(BeamFamily):
    """A single candidate, for any machine."""

    name = "tracker-index"
    effect = ElevationIndex
    varies_with = "place"
    stated = {"index_urad": 1e6}
    words = read_words("""
        [en]
        title = Index error of the tracker's elevation
        cause = The zero of the tracker's elevation circle is off.
        looks_like = All points seem raised by the same angle: the volume looks like
            part of a cone about the tracker.
        remedy = Run the tracker's own compensation (two-face test); measure in both
            faces.
        [de]
        title = Indexfehler der Trackerhöhe
        cause = Die Null des Höhenkreises des Trackers stimmt nicht.
        looks_like = Alle Punkte scheinen um denselben Winkel gehoben: Der Raum wirkt
            wie Teil eines Kegels um den Tracker.
        remedy = Die eigene Kompensation des Trackers durchführen (Zweilagentest); in
            beiden Lagen messen.
        """)

    def propose_for(
        self, at: Conditions, recorded: RecordedState
    ) -> Sequence[Candidate]:
        """A single candidate."""
        del at, recorded
        return [self.make_candidate(ElevationIndex(), [_USUAL_RAD])]
