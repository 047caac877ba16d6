"""What a machine is commanded to do: standstill points, or a path, row by row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from app.errors import PlanningError
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
_SAME = 1e-6  # mm or deg


def append_part(before: Commanded, part: Commanded) -> Commanded:
    """Return all rows: those before, then those that the part adds.

    Raises PlanningError if the part does not go on where the rows before have ended.
    """
    if part.axes != before.axes or isinstance(part, Path) != isinstance(before, Path):
        raise PlanningError("a part has the axes and the mode of what it goes on from")
    if isinstance(before, Path) and isinstance(part, Path):
        if np.abs(part.position[0] - before.position[-1]).max() > _SAME:
            raise PlanningError(
                "the first row of a part is where the machine stands: "
                f"{before.position[-1].tolist()}, not {part.position[0].tolist()}"
            )
        return Path(
            before.axes,
            np.vstack([before.position, part.position[1:]]),
            np.concatenate([before.feed_mm_min, part.feed_mm_min[1:]]),
            np.concatenate([before.dwell_s, part.dwell_s[1:]]),
            before.target + part.target[1:],
        )
    return Configurations(
        before.axes,
        np.vstack([before.position, part.position]),
        np.concatenate([before.dwell_s, part.dwell_s]),
        before.target + part.target,
    )
