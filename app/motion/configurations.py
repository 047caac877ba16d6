"""What a machine is commanded to do: standstill points, or a path, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from drivers.interfaces.records import Path


@dataclass(frozen=True, slots=True)
class Configurations:
    """Axis positions to stand still at.

    position : (n, axes), mm for linear and deg for rotary axes
    dwell_s : (n,)
    target : name of the target measured at each row; empty for a single target
    """

    axes: tuple[str, ...]
    position: Float64[np.ndarray, "n a"]
    dwell_s: Float64[np.ndarray, " n"]
    target: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.position)


Commanded = Path | Configurations
