"""When the machine was where on a line: a phase and a speed, no shared clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role


@dataclass(frozen=True)
class TimingLaw(Effect):
    """Along each line the machine is late by a constant, off its speed by another."""

    kind = "timing-law"
    role = Role.NUISANCE
    lines: tuple[int, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Phase and speed of the first line, of the second, ..."""
        return tuple(
            Parameter(f"line-{line}-{what}", unit)
            for line in self.lines
            for what, unit in (("phase", "mm"), ("speed", "mm/s"))
        )

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 p"]:
        """Return the direction of travel, and the same times the time from mid line."""
        columns = np.zeros((len(at), 3, 2 * len(self.lines)))
        speed = np.linalg.norm(at.velocity_mm_s, axis=1)
        moving = np.flatnonzero(speed)
        column = np.searchsorted(np.array(self.lines), at.line[moving])
        # On an arc the target's own speed changes along the line.
        usual = speed if at.line_speed_mm_s is None else at.line_speed_mm_s
        direction = at.velocity_mm_s[moving] / usual[moving, None]
        columns[moving, :, 2 * column] = direction
        columns[moving, :, 2 * column + 1] = direction * at.line_time_s[moving, None]
        return columns
