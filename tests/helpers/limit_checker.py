"""A checker of plans that shares nothing with the planner: it samples the swept path.

Every line is walked in steps of at most a millimetre; the beam to each place is walked
too. What it finds is a violation by more than `SLACK_MM`.
"""

from dataclasses import dataclass, field

import numpy as np

STEP_MM, BEAM_PLACES, SLACK_MM = 1.0, 200, 1e-2


@dataclass(frozen=True)
class Limits:
    """Travel, boxes as (low, high), and the tracker, in plain numbers.

    offset_mm : of the target
    """

    low: np.ndarray
    high: np.ndarray
    offset_mm: np.ndarray
    keep_out: list = field(default_factory=list)
    tracker_mm: np.ndarray | None = None
    range_mm: tuple = (0.0, np.inf)
    blocks: list = field(default_factory=list)


def violations(limits, position):
    """Return what a path through the positions breaks, in words."""
    found = set()
    places = np.vstack([position[:1], *map(_walked, position[:-1], position[1:])])
    low, high = limits.low - SLACK_MM, limits.high + SLACK_MM
    if ((places < low) | (places > high)).any():
        found.add("travel")
    if any(_inside(places, box).any() for box in limits.keep_out):
        found.add("keep-out")
    if limits.tracker_mm is not None:
        found |= _of_tracker(limits, places + limits.offset_mm)
    return found


def _walked(begin, end):
    steps = int(np.ceil(np.linalg.norm(end - begin) / STEP_MM))
    share = np.arange(1, steps + 1)[:, None] / max(steps, 1)
    return begin + share * (end - begin)


def _inside(places, box):
    low, high = box
    return ((places > low + SLACK_MM) & (places < high - SLACK_MM)).all(axis=-1)


def _of_tracker(limits, target):
    found = set()
    beam = target - limits.tracker_mm
    distance = np.linalg.norm(beam, axis=1)
    near, far = limits.range_mm
    if distance.min() < near - SLACK_MM or distance.max() > far + SLACK_MM:
        found.add("range")
    share = np.linspace(0.0, 1.0, BEAM_PLACES)[None, :, None]
    along = limits.tracker_mm + share * beam[::10, None]
    if any(_inside(along, box).any() for box in limits.blocks):
        found.add("sight")
    return found
