"""Rows of a plan in the order of a controller's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truepath.measurement.faults import Fault
from truepath.motion.configurations import Configurations
from truepath_drivers.interfaces.records import Path


def arrange_axes(
    commanded: Path | Configurations, axes: tuple[str, ...], here: tuple[float, ...]
) -> Path | Configurations:
    """Rows in the axis order of a controller.

    Axes that the plan does not name stay where they are. Raises Fault if the plan names
    an axis that the controller lacks.
    """
    missing = [name for name in commanded.axes if name not in axes]
    if missing:
        raise Fault(
            "wrong-device",
            f"the controller has axes {', '.join(axes)}, none is {missing[0]}",
            "check the machine file and the controller",
        )
    position: NDArray[np.float64] = np.tile(np.array(here, float), (len(commanded), 1))
    for column, name in enumerate(commanded.axes):
        position[:, axes.index(name)] = commanded.position[:, column]
    return replace(commanded, axes=axes, position=position)
