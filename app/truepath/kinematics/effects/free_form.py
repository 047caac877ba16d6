"""Free functions of what an error may depend on: structure without a known cause.

Each moves the point along one arm by a sum of smooth shapes of time, positions, or
direction of approach. They describe what no catalogued cause explains, and a cause has
to explain more than they do.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product
from typing import ClassVar

import numpy as np
from jaxtyping import Float64
from numpy.polynomial import legendre

from truepath.kinematics.conditions import Conditions
from truepath.kinematics.effects.base import Effect, Role, columns_along
from truepath.kinematics.effects.error_motion import compute_arm
from truepath.kinematics.effects.family import (
    USUAL_MM,
    Candidate,
    CandidateEstimate,
    Family,
    Quantity,
    read_words,
)
from truepath.kinematics.effects.keys import AXIS, DIRECTION, MOTION, PLANE
from truepath.kinematics.machine.machine import LinearAxis, Machine
from truepath.kinematics.machine.symbols import LINEAR, is_turn, list_error_motions

_HALF_WAVES = range(1, 13)
_HALF_TURNS = range(1, 9)
_SIDE_DEGREES = range(1, 6)
_PLANE_PAIRS = [(i, j) for i, j in product(range(1, 4), range(1, 4))]
_TURN_PAIRS = [(i, j) for i, j in product(range(3), range(1, 4)) if i + j < 5]


class FreeForm(Effect):
    """Shapes along one arm; θ in mm, at the typical length of the arm."""

    role = Role.STRUCTURE

    @abstractmethod
    def arm(self, at: Conditions) -> str | Float64[np.ndarray, "n 3"]:
        """Direction, of length about 1."""

    @abstractmethod
    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        """Shapes, each at most about 1."""

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        return columns_along(self.arm(at), self.shapes(at))


class FreeFormFamily(Family):
    """Structure reported by its root mean square over the variables it depends on.

    mean_square : of each shape, or of all
    """

    mean_square: ClassVar[float | Sequence[float]] = 0.5

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        weight = np.full(len(found.theta), self.mean_square)
        return {"rms_um": found.root_mean_square(weight).scale(1e3)}


@dataclass(frozen=True)
class TimeWander(FreeForm):
    """A cosine series over the Run in one direction; θ by number of half waves."""

    kind = "time-wander"
    units = {f"{k}": "mm" for k in _HALF_WAVES}
    direction: str
    first_s: float
    span_s: float

    def arm(self, at: Conditions) -> str:
        return self.direction

    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        angle = np.pi * (at.time_s - self.first_s) / self.span_s
        return np.cos(angle[:, None] * [*_HALF_WAVES])


class TimeWanderFamily(FreeFormFamily):
    """One candidate per direction; slower waves are typically larger."""

    name = "time-wander"
    effect = TimeWander
    ends_with_run = True
    varies_with = "time"
    keys = {"direction": DIRECTION}
    covariates = ("t",)
    sentence = "a slow wander along {direction} of {rms_um:.2g} µm (root mean square)"
    words = read_words("""
        [en]
        title = Slow wander in time
        cause = Mount, table or air that wanders: sun, draught, a hall that cools.
        looks_like = All points shift slowly to and fro with time, whatever axis moves.
        remedy = Let all settle, shield it from draught and sun, measure faster; repeat
            lines to see it.
        [de]
        title = Langsames Wandern mit der Zeit
        cause = Halterung, Tisch oder Luft wandert: Sonne, Zugluft, eine abkühlende
            Halle.
        looks_like = Alle Punkte verschieben sich mit der Zeit langsam hin und her,
            gleich welche Achse fährt.
        remedy = Alles zur Ruhe kommen lassen, vor Zugluft und Sonne schützen, schneller
            messen; Geraden wiederholen, um es zu sehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        first_s, span_s = float(at.time_s.min()), max(float(np.ptp(at.time_s)), 1.0)
        typical = USUAL_MM / np.array(_HALF_WAVES)
        return [
            self.make_candidate(TimeWander(d, first_s, span_s), typical) for d in LINEAR
        ]


@dataclass(frozen=True)
class TiltWander(FreeForm):
    """All points turn slowly to and fro about one direction: a cosine series of time.

    middle_mm : centre of the turn; reach_mm : typical distance of the points from it
    """

    kind = "tilt-wander"
    units = {f"{k}": "mm" for k in _HALF_TURNS}
    direction: str
    first_s: float
    span_s: float
    middle_mm: tuple[float, float, float]
    reach_mm: float

    def arm(self, at: Conditions) -> Float64[np.ndarray, "n 3"]:
        turn = np.eye(3)[LINEAR.index(self.direction)]
        return np.cross(turn, at.point_mm - self.middle_mm) / self.reach_mm

    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        angle = np.pi * (at.time_s - self.first_s) / self.span_s
        return np.cos(angle[:, None] * [*_HALF_TURNS])


class TiltWanderFamily(FreeFormFamily):
    """One candidate per direction to turn about; slower waves are typically larger."""

    name = "tilt-wander"
    effect = TiltWander
    ends_with_run = True
    varies_with = "time"
    keys = {"direction": replace(DIRECTION, phrase="about {}")}
    covariates = ("t",)
    sentence = (
        "everything turns slowly to and fro about {direction}, by {rms_um:.2g} µm at "
        "usual reach (root mean square)"
    )
    words = read_words("""
        [en]
        title = Slow tilt in time
        cause = The tracker's stand, the table or the floor tilts: it settles, or the
            hall warms it on one side.
        looks_like = All points turn slowly with time, whatever axis moves: the farther
            from the middle, the more they move.
        remedy = Let the stand settle, put it on firm floor, shield it from sun and
            draught; repeat lines to see it.
        [de]
        title = Langsames Kippen mit der Zeit
        cause = Stativ, Tisch oder Boden kippt: Er setzt sich, oder die Halle wärmt ihn
            einseitig.
        looks_like = Alle Punkte drehen sich mit der Zeit langsam, gleich welche Achse
            fährt: je weiter von der Mitte, desto mehr.
        remedy = Das Stativ sich setzen lassen, auf festen Boden stellen, vor Sonne und
            Zugluft schützen; Geraden wiederholen, um es zu sehen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        if at.recorded is None:
            return []
        first_s, span_s = float(at.time_s.min()), max(float(np.ptp(at.time_s)), 1.0)
        x, y, z = at.point_mm.mean(axis=0).tolist()
        off = at.point_mm - np.array([x, y, z])
        about = (first_s, span_s, (x, y, z), float(np.sqrt(3.0 * np.mean(off**2))))
        typical = USUAL_MM / np.array(_HALF_TURNS)
        return [self.make_candidate(TiltWander(d, *about), typical) for d in LINEAR]


@dataclass(frozen=True)
class PlaneTurn(FreeForm):
    """A turn of one axis that depends on its position and that of another.

    reach_mm : typical length of the turn's lever
    """

    kind = "plane-turn"
    units = {f"{i}{j}": "mm" for i, j in _TURN_PAIRS}
    symbol: str
    axis: LinearAxis
    by: LinearAxis
    reach_mm: float

    @property
    def axis_pair(self) -> tuple[str, str]:
        return self.axis.name, self.by.name

    def arm(self, at: Conditions) -> Float64[np.ndarray, "n 3"]:
        return compute_arm(self.symbol, at) / self.reach_mm

    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        shares = (at.axis_share(axis) for axis in (self.axis, self.by))
        return multiply_shares(shares, _TURN_PAIRS)


class PlaneTurnFamily(FreeFormFamily):
    """One candidate per turn of an axis and other axis."""

    name = "plane-turn"
    effect = PlaneTurn
    numbers = ("reach_mm",)
    varies_with = "place"
    keys = {"motion": MOTION, "by": replace(AXIS, phrase="with {}")}
    covariates = ("{motion[2]}", "{by}")
    mean_square = 0.2
    sentence = (
        "a turn in {motion} of {rms_um:.2g} µm at the point (root mean square) that "
        "depends on where {by} stands"
    )
    words = read_words("""
        [en]
        title = Turn of one axis by another
        cause = Column, ram or table twists or leans as another carriage loads it: no
            rigid body does it.
        looks_like = Pitch, yaw or roll of one axis differs with the place of another.
        remedy = Compensate with a grid of the volume; check levelling, counterbalance
            and the mounting of the bed.
        [de]
        title = Drehung einer Achse, die von einer anderen abhängt
        cause = Ständer, Ausleger oder Tisch verdreht oder neigt sich, wenn ein anderer
            Schlitten ihn belastet: kein starrer Körper tut das.
        looks_like = Nicken, Gieren oder Rollen einer Achse ist je nach Ort einer
            anderen verschieden.
        remedy = Mit einem Gitter des Raums kompensieren; Nivellierung,
            Gewichtsausgleich und Aufstellung des Betts prüfen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        if at.recorded is None:
            return []
        found: list[Candidate] = []
        for axis, by in permutations(at.machine.linear_axes, 2):
            for symbol in filter(is_turn, list_error_motions(axis.name)):
                lever = compute_arm(symbol, at)
                reach_mm = max(float(np.sqrt(3.0 * np.mean(lever**2))), 1.0)
                falling = [1.0 / ((i + 1) * j) for i, j in _TURN_PAIRS]
                typical = USUAL_MM * np.array(falling)
                keys = {"motion": symbol, "by": by.name}
                turn = PlaneTurn(symbol, axis, by, reach_mm)
                found.append(Candidate(self.name, keys, turn, typical))
        return found

    def restore(
        self, machine: Machine, keys: Mapping[str, str], numbers: Mapping[str, float]
    ) -> Effect:
        symbol, by = keys["motion"], machine.linear(keys["by"])
        axis = machine.linear(symbol[2])
        if symbol not in list_error_motions(axis.name):
            raise KeyError(symbol)
        return PlaneTurn(symbol, axis, by, numbers["reach_mm"])


@dataclass(frozen=True)
class SideShape(FreeForm):
    """A displacement by side of approach that varies along the axis, without mean."""

    kind = "side-shape"
    units = {f"{k}": "mm" for k in _SIDE_DEGREES}
    axis: LinearAxis
    direction: str

    def arm(self, at: Conditions) -> Float64[np.ndarray, "n 3"]:
        side = at.approach[:, at.machine.axis_names.index(self.axis.name)]
        return compute_arm(f"E{self.direction}{self.axis.name}", at) * side[:, None]

    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        return expand_share(at.axis_share(self.axis), _SIDE_DEGREES[-1])[:, 1:]


class SideShapeFamily(FreeFormFamily):
    name = "side-shape"
    effect = SideShape
    varies_with = "way"
    keys = {"axis": AXIS, "direction": DIRECTION}
    covariates = ("direction({axis})", "{axis}")
    mean_square = 0.2
    sentence = (
        "a displacement along {direction} of {rms_um:.2g} µm (root mean square) that "
        "changes side with the direction of {axis} and varies along it"
    )
    words = read_words("""
        [en]
        title = Lost motion that varies along an axis
        cause = A screw, nut or guide that is worn or tight in places.
        looks_like = Both directions of travel lie apart by more at some places of the
            axis than at others.
        remedy = Look for wear and tight places; enter tables of both directions.
        [de]
        title = Umkehrfehler, der sich entlang einer Achse ändert
        cause = Eine Spindel, Mutter oder Führung, die stellenweise verschlissen oder
            schwergängig ist.
        looks_like = Beide Fahrtrichtungen liegen an manchen Orten der Achse weiter
            auseinander als an anderen.
        remedy = Nach Verschleiß und schwergängigen Stellen suchen; Tabellen beider
            Richtungen eintragen.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        if at.recorded is None:
            return []
        typical = USUAL_MM / np.array(_SIDE_DEGREES)
        return [
            self.make_candidate(SideShape(axis, direction), typical)
            for axis in at.machine.linear_axes
            for direction in LINEAR
        ]


@dataclass(frozen=True)
class PlaneError(FreeForm):
    """A displacement that depends on two axes at once: non-rigid behaviour in general.

    Bicubic in both positions, without terms of one of them alone: error motions contain
    these already (the surface that brunn-hanebeck-2005 leaves to future work).
    """

    kind = "plane-error"
    units = {f"{i}{j}": "mm" for i, j in _PLANE_PAIRS}
    first: LinearAxis
    second: LinearAxis
    direction: str

    @property
    def plane(self) -> str:
        """Names of both axes, as in files."""
        return self.first.name + self.second.name

    @property
    def axis_pair(self) -> tuple[str, str]:
        return self.first.name, self.second.name

    def arm(self, at: Conditions) -> Float64[np.ndarray, "n 3"]:
        return compute_arm(f"E{self.direction}{self.first.name}", at)

    def shapes(self, at: Conditions) -> Float64[np.ndarray, "n p"]:
        shares = (at.axis_share(axis) for axis in (self.first, self.second))
        return multiply_shares(shares, _PLANE_PAIRS)


def _in_plane(plane: tuple[LinearAxis, LinearAxis], direction: str) -> PlaneError:
    return PlaneError(*plane, direction)


class PlaneErrorFamily(FreeFormFamily):
    """One candidate per plane and direction."""

    name = "plane-error"
    effect = PlaneError
    varies_with = "place"
    makes = _in_plane
    keys = {"plane": PLANE, "direction": DIRECTION}
    covariates = ("{plane[0]}", "{plane[1]}")
    mean_square = [1.0 / ((2 * i + 1) * (2 * j + 1)) for i, j in _PLANE_PAIRS]
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
        falling = np.array([1.0 / (i * j) for i, j in _PLANE_PAIRS])
        return [
            self.make_candidate(PlaneError(*plane, direction), USUAL_MM * falling)
            for plane in combinations(at.machine.linear_axes, 2)
            for direction in LINEAR
        ]


def expand_share(
    share: Float64[np.ndarray, " n"], degree: int
) -> Float64[np.ndarray, "n d"]:
    """Polynomials of degree 0 to `degree` at shares from 0 to 1."""
    return legendre.legvander(2.0 * share - 1.0, degree)


def multiply_shares(
    shares: Iterable[Float64[np.ndarray, " n"]], degrees: Sequence[tuple[int, int]]
) -> Float64[np.ndarray, "n p"]:
    """One product of polynomials of two shares per pair of degrees."""
    highest = max(map(max, degrees))
    one, two = (expand_share(share, highest) for share in shares)
    return np.stack([one[:, i] * two[:, j] for i, j in degrees], axis=1)
