"""Paths through rows that a test states."""

import numpy as np

from truepath_drivers.interfaces.records import Arc, Path

XYZ = ("X", "Y", "Z")


def path_of(*rows, feed=6000.0, dwell_s=0.0, axes=XYZ, target=(), arc=()) -> Path:
    """Return the path; feeds and dwells are one for all rows or one for each."""
    n = len(rows)
    position = np.array(rows, float).reshape(n, len(axes))
    feeds, dwells_s = (np.full(n, each, float) for each in (feed, dwell_s))
    return Path(tuple(axes), position, feeds, dwells_s, target, arc=arc)


ENDS = (20, 20, 20), (480, 380, 20), (20, 380, 280), (480, 20, 280), (20, 20, 20)
ACROSS = path_of(*ENDS, feed=12_000.0, dwell_s=1.0)
"""In the travel of the demonstration machine."""


def two_turns(x, y, radius_mm, z=0.0, **given) -> Path:
    """From beside a circle a little more than twice round it, and back."""
    end = np.radians(12.0)
    far = x + radius_mm * np.cos(end), y + radius_mm * np.sin(end), z
    beside = (x + radius_mm, y, z)
    arcs = [Arc("XY", (x, y), turn_deg) for turn_deg in (732.0, -732.0)]
    return path_of(*np.round([beside, far, beside], 4), arc=(None, *arcs), **given)
