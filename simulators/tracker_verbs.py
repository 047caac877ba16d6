"""What a tracker does beside streaming: it aims, seeks and chooses its target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from truepath.drivers.tracker.streaming.messages import (
    Ack,
    Aim,
    AirInUse,
    GetAir,
    Home,
    Message,
    Nak,
    NakCode,
    Search,
    Select,
    SetAir,
    Type,
    Verb,
)

_FIELD_RAD = 0.05  # off the sight, in which a target is found
_HIGHEST_RAD = math.radians(80.0)

_NOTHING = NakCode.NO_TARGET, "no target near the beam"

LocateTarget = Callable[[str, float], tuple[float, float]]
"""Returns azimuth and elevation of a target at a machine time."""


class TrackerVerbs:
    """Which target the beam is on, and since when; the first one at first.

    is_known : the host has said HELLO in the version that has these verbs
    """

    def __init__(self, names: Sequence[str], locate: LocateTarget) -> None:
        self._names, self._locate = tuple(names), locate
        self._since: list[tuple[float, str | None]] = [(-math.inf, self._names[0])]
        self._sight = (0.0, 0.0)
        self._air = AirInUse(20.0, 1013.25, 50.0)
        self.is_known = False

    def list_targets(self, moments_s: np.ndarray) -> np.ndarray:
        """Return the names at these moments, None where the beam has no target."""
        begins, names = zip(*self._since, strict=True)
        chosen = np.array(names, object)
        return chosen[np.searchsorted(begins, moments_s, "right") - 1]

    def lose(self, true_s: float) -> None:
        """Lose the target; the beam stays where it is, until a search."""
        self._sight = self._locate(self._since[-1][1] or self._names[0], true_s)
        self._since.append((true_s, None))

    def answer(self, verb: Verb, true_s: float, *, is_blocked: bool = False) -> Message:
        """Do it and reply; a beam that is blocked finds nothing."""
        kind = _TYPES[type(verb)]
        if not self.is_known:
            return Nak(
                verb.transaction, kind, NakCode.UNKNOWN_COMMAND, "not understood"
            )
        match verb:
            case Home():
                refusal = self._turn(0.0, 0.0, true_s)
            case Aim(_, azimuth_rad, elevation_rad):
                refusal = self._turn(azimuth_rad, elevation_rad, true_s)
            case Search():
                refusal = _NOTHING if is_blocked else self._search(true_s)
            case Select(_, name):
                refusal = self._select(name, true_s)
            case SetAir(_, temperature, pressure, humidity):
                self._air, refusal = AirInUse(temperature, pressure, humidity), None
            case GetAir():
                refusal = None
        if refusal is not None:
            return Nak(verb.transaction, kind, *refusal)
        air = self._air if isinstance(verb, SetAir | GetAir) else None
        return Ack(verb.transaction, kind, air)

    def _turn(
        self, azimuth_rad: float, elevation_rad: float, true_s: float
    ) -> tuple[NakCode, str] | None:
        if not (math.isfinite(azimuth_rad) and abs(elevation_rad) <= _HIGHEST_RAD):
            return NakCode.BAD_ARGUMENT, "no direction the beam can take"
        self._sight = azimuth_rad, elevation_rad
        self._since.append((true_s, None))
        return None

    def _search(self, true_s: float) -> tuple[NakCode, str] | None:
        away = {name: self._measure_away(name, true_s) for name in self._names}
        nearest = min(away, key=lambda name: away[name])
        if away[nearest] > _FIELD_RAD:
            return _NOTHING
        return self._select(nearest, true_s)

    def _select(self, name: str, true_s: float) -> tuple[NakCode, str] | None:
        if name not in self._names:
            known = ", ".join(self._names)
            return NakCode.BAD_ARGUMENT, f"knows {known}"
        self._sight = self._locate(name, true_s)
        if self._since[-1][1] != name:
            self._since.append((true_s, name))
        return None

    def _measure_away(self, name: str, true_s: float) -> float:
        azimuth, elevation = self._locate(name, true_s)
        aside = math.remainder(azimuth - self._sight[0], 2.0 * math.pi)
        return math.hypot(aside * math.cos(elevation), elevation - self._sight[1])


_TYPES: dict[type[Verb], Type] = {
    Home: Type.HOME,
    Aim: Type.AIM,
    Search: Type.SEARCH,
    Select: Type.SELECT,
    SetAir: Type.SET_AIR,
    GetAir: Type.GET_AIR,
}
