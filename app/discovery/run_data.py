"""What one Run shows, and what it is held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from app.alignment.observations import Observations
from app.estimation.design_matrix import Linearisation
from app.kinematics.effects.base import Effect
from app.kinematics.effects.catalogue import Wave


class FastSums(Protocol):
    """What samples tell within their cells."""

    def shows(self, effect: Effect) -> bool:
        """Tell whether an effect is fast, and of this Run."""
        ...

    def sums(
        self, effects: Sequence[Effect], folds: int
    ) -> tuple[Float64[np.ndarray, "k q q"], list[tuple[int, int]]]:
        """Return the sums on fast effects and data, and which columns they are."""
        ...

    def squares(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return the weighted squares of the data."""
        ...

    def wave(
        self, wave: Wave
    ) -> tuple[NDArray[np.complex128], Float64[np.ndarray, " v"]]:
        """Return data and weight of a wave in time."""
        ...

    def freedom(self, folds: int) -> Float64[np.ndarray, " k"]:
        """Return their degrees of freedom."""
        ...


@dataclass(frozen=True)
class RunData:
    """What one Run shows, and what it is held against.

    base : machine, poses and noise that all explanations share
    within : what its samples tell within their cells
    """

    observations: Observations
    base: Linearisation
    within: FastSums | None = None
