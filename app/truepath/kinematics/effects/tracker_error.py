"""Errors of the tracker: eccentric circles, index error, range offset, and any other.

Averaging does not reduce them, and a tracker within its specification has all of them.
They move the target for the tracker alone. They need its pose, so they are 0 without a
recording.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64

from truepath.kinematics.conditions import Conditions, RecordedState
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    Family,
    read_words,
)
from truepath.kinematics.effects.free_form import FreeFormFamily, multiply_shares
from truepath.kinematics.effects.keys import choose_from
from truepath.kinematics.effects.sinusoid import (
    WaveFamily,
    sine_and_cosine,
)


class BeamEffect(Effect):
    """Apparent motion of the target along one arm, in the tracker's frame."""

    role = Role.MEASUREMENT

    @abstractmethod
    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        """Apparent motion of the target per unit, in the tracker's frame."""

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n p"]:
        """Size along the arm for each parameter; 1 by default."""
        return np.ones((len(at), 1))

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Arm in the frame that the tracker is mounted on, times the sizes."""
        recorded = at.recorded
        if recorded is None:
            return np.zeros((len(at), 3, len(self.units)))
        arm = self.arm(recorded) @ recorded.rotation
        return columns_along(arm, self.sizes(at, recorded))


class BeamFamily(Family):
    """Candidates that need the beam direction of a recording."""

    @abstractmethod
    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        """As `propose`, with a recording at hand."""

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        return [] if at.recorded is None else self.propose_for(at, at.recorded)


def raise_beam(recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
    """Motion of a target with its elevation, mm per rad."""
    x, y, z = recorded.tracker_mm.T
    azimuth = np.arctan2(y, x)
    across = [-z * np.cos(azimuth), -z * np.sin(azimuth), np.hypot(x, y)]
    return np.stack(across, axis=1)


_TYPICAL_RAD = 2e-5
CIRCLES = ("azimuth", "elevation")


@dataclass(frozen=True)
class TrackerEccentricity(BeamEffect):
    """The measured angle has an error of sin and cos of itself, once per turn."""

    kind = "tracker-eccentricity"
    units = {"sin": "rad", "cos": "rad"}
    circle: str

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        if self.circle == "elevation":
            return raise_beam(recorded)
        x, y, _ = recorded.tracker_mm.T
        return np.stack([-y, x, np.zeros_like(x)], axis=1)

    def sizes(
        self, at: Conditions, recorded: RecordedState
    ) -> Float64[np.ndarray, "n 2"]:
        x, y, z = recorded.tracker_mm.T
        sides = (y, x) if self.circle == "azimuth" else (z, np.hypot(x, y))
        return sine_and_cosine(np.arctan2(*sides))


class TrackerEccentricityFamily(BeamFamily, WaveFamily):
    name = "tracker-eccentricity"
    effect = TrackerEccentricity
    varies_with = "place"
    amplitude = ("amplitude_urad", 1e6)
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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        effects = map(TrackerEccentricity, CIRCLES)
        return [self.make_candidate(effect, [_TYPICAL_RAD] * 2) for effect in effects]


@dataclass(frozen=True)
class TrackerRangeOffset(BeamEffect):
    """Every distance is too long by the same amount."""

    kind = "tracker-range-offset"
    units = {"": "mm"}

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        beam = recorded.tracker_mm
        return beam / np.linalg.norm(beam, axis=1, keepdims=True)


class TrackerRangeOffsetFamily(BeamFamily):
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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        return [self.make_candidate(TrackerRangeOffset(), [4.0 * USUAL_MM])]


@dataclass(frozen=True)
class ElevationIndex(BeamEffect):
    """Every elevation is read too high by the same angle."""

    kind = "elevation-index"
    units = {"": "rad"}

    def arm(self, recorded: RecordedState) -> Float64[np.ndarray, "n 3"]:
        return raise_beam(recorded)


class ElevationIndexFamily(BeamFamily):
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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
        return [self.make_candidate(ElevationIndex(), [_TYPICAL_RAD])]


_PAIRS = [(i, j) for i, j in product(range(5), repeat=2) if 0 < i + j < 5]
_LOOKS = ("range", "azimuth", "elevation")


@dataclass(frozen=True)
class DirectionalTrackerError(BeamEffect):
    """Range, or an angle, has an error that depends on the direction of the beam.

    Smooth shapes of azimuth and elevation, without a known cause.

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


class LookErrorFamily(BeamFamily, FreeFormFamily):
    """One candidate each for range, azimuth and elevation."""

    name = "look-error"
    effect = DirectionalTrackerError
    ends_with_run = True
    varies_with = "place"
    keys = {"quantity": choose_from("of {}", _LOOKS)}
    covariates = ("azimuth", "elevation")
    mean_square = 0.15
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

    def propose_for(self, at: Conditions, recorded: RecordedState) -> list[Candidate]:
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


def _middle_and_half(values: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return 0.5 * (low + high), max(0.5 * (high - low), 1e-6)
