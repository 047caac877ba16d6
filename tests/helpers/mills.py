"""Machines of three linear axes, in no more words than a test needs."""

from truepath.kinematics.machine.machine import LinearAxis, Machine, Target
from truepath.kinematics.machine.tracker_noise import TrackerNoise


def build_mill(*offsets_mm, sides=("", "XYZ"), travel_mm=(500.0, 500.0, 500.0)):
    """Return a mill with targets T1, T2, … on the tool.

    sides : the axes that move the workpiece, those that move the tool, base to both
    """
    travels = zip("XYZ", travel_mm, strict=True)
    axes = tuple(LinearAxis(name, 0.0, length) for name, length in travels)
    named = enumerate(offsets_mm, 1)
    targets = tuple(Target(f"T{k}", "tool", offset) for k, offset in named)
    return Machine("m", *map(tuple, sides), axes, targets, TrackerNoise())
