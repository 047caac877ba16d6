"""A measurement whose path grows while it is made: parts, one after another.

Each part is loaded while the machine stands at the end of the part before. A part of a
path begins with the row at which the machine stands, so that the controller knows
where its first line starts; that row is there once in what the Run says was commanded.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from app.errors import PlanningError
from app.motion.configurations import Commanded, Configurations
from drivers.interfaces.records import Path

RequestPart = Callable[[], Commanded | None]
"""Requests a further part and waits for it, in the controller's axes; None: the end."""
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
