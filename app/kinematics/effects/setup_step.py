"""The tracker or the target was knocked: one shift at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from app.kinematics.conditions import Conditions
from app.kinematics.effects.base import Effect, Parameter, Role
from app.kinematics.effects.catalogue import (
    USUAL_MM,
    Candidate,
    Family,
    Measured,
    Scan,
    Signature,
)

_STEP_S = 2.0
_MOST = 80
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class SetupStep(Effect):
    """All points shift from a moment on; as far before it as after it on average."""

    at_s: float

    @property
    def name(self) -> str:
        """Name in the provenance of an estimate."""
        return f"setup-step-{self.at_s:.2f}"

    @property
    def role(self) -> Role:
        """What it belongs to."""
        return Role.MEASUREMENT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The step along x, y and z, in mm."""
        return tuple(Parameter(f"{self.name}-{a}", "mm") for a in _AXES)

    def jacobian(self, at: Conditions) -> Float64[np.ndarray, "n 3 3"]:
        """Return half a unit after the moment and minus half before."""
        side = np.where(at.time_s >= self.at_s, 0.5, -0.5)
        return side[:, None, None] * np.eye(3)


class SetupStepFamily(Family):
    """One candidate, its moment scanned."""

    name = "setup-step"
    in_machine = False
    is_smooth = False
    happens_once = True
    signature = Signature(
        cause="Tracker, its stand, the target's nest or the workpiece was knocked or "
        "slipped.",
        looks_like="From one moment on all lines are shifted by the same amount.",
        remedy="Measure again; until then, use the data with the step taken out.",
    )

    def candidates(self, at: Conditions) -> Sequence[Candidate]:
        """Return the step in the middle of the run."""
        middle = 0.5 * float(at.time_s.min() + at.time_s.max())
        return [
            Candidate(self.name, {}, SetupStep(middle), np.full(3, USUAL_MM), middle)
        ]

    def scan(self, candidate: Candidate, at: Conditions) -> Scan:
        """Return moments, none so early or late that one line would decide.

        Between lines above all: a step elsewhere tears a line in two.
        """
        first, last = float(at.time_s.min()), float(at.time_s.max())
        margin = 0.02 * (last - first)
        count = int(min(_MOST, max(8, (last - first) / _STEP_S)))
        even = np.linspace(first + margin, last - margin, count)
        between = _between_lines(at)
        inside = (between > even[0]) & (between < even[-1])
        return Scan("t_s", np.union1d(even, between[inside]))

    def at_value(self, candidate: Candidate, at: Conditions, value: float) -> Candidate:
        """Return the candidate of another moment."""
        return replace(candidate, effect=SetupStep(value), value=value)

    def parameters(
        self,
        candidate: Candidate,
        theta: Float64[np.ndarray, "3"],
        covariance: Float64[np.ndarray, "3 3"],
        value_sigma: float,
    ) -> dict[str, Measured]:
        """Return the moment and the step."""
        sigma = np.sqrt(np.diag(covariance))
        steps = {
            f"step_um[{a}]": Measured(float(t) * 1e3, float(s) * 1e3)
            for a, t, s in zip(_AXES, theta, sigma, strict=True)
        }
        return {"t_s": Measured(candidate.value or 0.0, value_sigma), **steps}


def _between_lines(at: Conditions) -> Float64[np.ndarray, " l"]:
    """Return the middle of each pause between lines or standstills, in order."""
    order = np.argsort(at.time_s, kind="stable")
    time_s, line = at.time_s[order], at.line[order]
    last = np.flatnonzero((np.diff(line) != 0) | (line[1:] < 0))
    return 0.5 * (time_s[last] + time_s[last + 1])
