"""A periodic behaviour along an axis, across it, that no cause explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
    Scan,
    Wave,
    Words,
    find_speed,
)
from app.kinematics.effects.keys import AXIS, DIRECTION
from app.kinematics.effects.sinusoid import (
    average_over_cells,
    is_resolved,
    list_wave_numbers,
    state_wave,
)
from app.kinematics.machine import LinearAxis
from app.kinematics.symbols import LINEAR

_SHORTEST_MM, _LONGEST_MM = 4.0, 60.0


@dataclass(frozen=True)
class PositionWave(Effect):
    """Sine and cosine of an axis' position, across the axis."""

    kind = "position-wave"
    role = Role.STRUCTURE
    units = {"sin": "mm", "cos": "mm"}
    axis: LinearAxis
    direction: str
    period_mm: float

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 2"]:
        """Return the direction times the waves."""
        turn = 2.0 * np.pi / self.period_mm
        angle = turn * at.axis_mm(self.axis.name)
        rate = turn * find_speed(at, self.axis.name)
        return columns_along(self.direction, average_over_cells(angle, rate, at))


class PositionWaveFamily(Family):
    """Every axis and direction across it, the period scanned."""

    name = "position-wave"
    role = Role.STRUCTURE
    scanned = "period_mm"
    numbers = ("period_mm",)
    makes = PositionWave
    keys = {"axis": replace(AXIS, phrase="({})"), "direction": DIRECTION}
    words = {
        "en": Words(
            title="Wave along an axis",
            cause="A guide, chain or rolling element that repeats with travel.",
            looks_like="The straightness of an axis waves with a steady period.",
            remedy="Check guide and rolling elements; compensate straightness finely.",
        ),
        "de": Words(
            title="Welle entlang einer Achse",
            cause="Eine Führung, eine Kette oder ein Wälzkörper, der sich mit dem Weg "
            "wiederholt.",
            looks_like="Die Geradheit der Achse schwankt mit fester Periode.",
            remedy="Führung und Wälzkörper prüfen; Geradheit fein kompensieren.",
        ),
    }

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each axis and direction across it."""
        return [
            self.offer(PositionWave(axis, d, 20.0), [USUAL_MM] * 2, 20.0)
            for axis in at.machine.linear_axes
            for d in LINEAR
            if d != axis.name and is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return periods at equal steps of waves, four to one over the travel."""
        axis = candidate.keys["axis"]
        waves = list_wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
        return Scan(self.scanned, 1.0 / waves[::-1])

    def find_wave(self, candidate: Candidate, at: Conditions) -> Wave:
        """Return the scan as a wave of the position."""
        axis = candidate.keys["axis"]
        one = np.ones((len(at), 1))
        return Wave(
            columns_along(candidate.keys["direction"], one)[:, :, 0],
            at.axis_mm(axis),
            find_speed(at, axis),
            1.0 / self.scan(candidate, at).values,
        )

    def state(self, found: CandidateEstimate) -> dict[str, Quantity]:
        """Return period and amplitude."""
        return state_wave(self.scanned, found)

    def list_covariates(self, candidate: Candidate) -> list[str]:
        """Return the axis."""
        return [candidate.keys["axis"]]

    def describe(self, candidate: Candidate, stated: Mapping[str, Quantity]) -> str:
        """Return axis, direction, period and amplitude."""
        axis, direction = candidate.keys["axis"], candidate.keys["direction"]
        return (
            f"a wave along {axis} in the direction of {direction} with "
            f"a period of {stated['period_mm'].value:.3g} mm and an amplitude of "
            f"{stated['amplitude_um'].value:.2g} µm"
        )
