"""A periodic behaviour along an axis, across it, that no cause explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Role, columns_along
from app.kinematics.effects.catalogue import USUAL_MM, Candidate, Wave, read_words
from app.kinematics.effects.keys import AXIS, DIRECTION
from app.kinematics.effects.sinusoid import (
    Sinusoid,
    SinusoidFamily,
    is_resolved,
    list_wave_numbers,
)
from app.kinematics.machine import LinearAxis
from app.kinematics.symbols import LINEAR

_SHORTEST_MM, _LONGEST_MM = 4.0, 60.0


@dataclass(frozen=True)
class PositionWave(Sinusoid):
    """Sine and cosine of an axis' position, across the axis."""

    kind = "position-wave"
    role = Role.STRUCTURE
    axis: LinearAxis
    direction: str
    period_mm: float

    @property
    def wave_number(self) -> float:
        """Waves a millimetre."""
        return 1.0 / self.period_mm

    def make_wave(self, at: Conditions, waves: Float64[np.ndarray, " v"]) -> Wave:
        """Return the wave of the axis' position."""
        name = self.axis.name
        arm = columns_along(self.direction, np.ones(len(at)))[:, :, 0]
        return Wave(arm, at.axis_mm(name), np.abs(at.axis_rate(name)), waves)


class PositionWaveFamily(SinusoidFamily):
    """Every axis and direction across it, the period scanned."""

    name = "position-wave"
    role = Role.STRUCTURE
    value_name = "period_mm"
    numbers = ("period_mm",)
    makes = PositionWave
    keys = {"axis": replace(AXIS, phrase="({})"), "direction": DIRECTION}
    covariates = ("{axis}",)
    sentence = (
        "a wave along {axis} in the direction of {direction} with a period of "
        "{period_mm:.3g} mm and an amplitude of {amplitude_um:.2g} µm"
    )
    words = read_words("""
        [en]
        title = Wave along an axis
        cause = A guide, chain or rolling element that repeats with travel.
        looks_like = The straightness of an axis waves with a steady period.
        remedy = Check guide and rolling elements; compensate straightness finely.
        [de]
        title = Welle entlang einer Achse
        cause = Eine Führung, eine Kette oder ein Wälzkörper, der sich mit dem Weg
            wiederholt.
        looks_like = Die Geradheit der Achse schwankt mit fester Periode.
        remedy = Führung und Wälzkörper prüfen; Geradheit fein kompensieren.
        """)

    def propose(self, at: Conditions) -> Sequence[Candidate]:
        """Return one for each axis and direction across it."""
        return [
            self.offer(PositionWave(axis, d, 20.0), [USUAL_MM] * 2)
            for axis in at.machine.linear_axes
            for d in LINEAR
            if d != axis.name and is_resolved(at, axis.name, _LONGEST_MM)
        ]

    def list_waves(
        self, candidate: Candidate, at: Conditions
    ) -> Float64[np.ndarray, " v"]:
        """Return waves, four steps to one over the travel."""
        axis = candidate.keys["axis"]
        return list_wave_numbers(at, axis, _SHORTEST_MM, _LONGEST_MM)
