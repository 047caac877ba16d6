"""A sketch of samples, to recognise a recording, cut or split.

A digest distinguishes two recordings by a single sample. A sketch holds the smallest
hashes of a few samples in succession (min-hash: Broder, On the resemblance and
containment of documents, 1997), so that any part of a recording has its share of them.
The noise of a tracker does not give the same samples twice.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt64

from truepath_drivers.interfaces.records import TrackerSamples

SKETCH = r"(?:[0-9a-f]{16})*"  # what one looks like in a file
_DIGITS = 16  # of a hash
_KEPT = 256  # a part of a hundredth has two or three of them
_WINDOW = 12  # samples in succession; fewer of a coarse tracker do coincide
_SHARED = 2  # hashes of 64 bits: not one of them is the same by chance
_SHARE = 0.5  # of the shorter one
_MIX = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)  # of splitmix64
_STEP = np.uint64(0x9E3779B97F4A7C15)


def sketch_samples(samples: TrackerSamples) -> str:
    """The smallest hashes of the usable samples, in one text."""
    return "".join(f"{value:0{_DIGITS}x}" for value in _find_smallest(_hash(samples)))


def _find_smallest(hashes: UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " k"]:
    """The smallest distinct ones; to sort all took a fifth of an analysis."""
    few = _KEPT
    while few < len(hashes):
        smallest = np.unique(np.partition(hashes, few)[:few])
        if len(smallest) >= _KEPT:
            return smallest[:_KEPT]
        few *= 4
    return np.unique(hashes)[:_KEPT]


def share_samples(one: str, other: str) -> bool:
    """Whether half of a recording, or more, is in another as well, by sketches.

    Less is no sign: a simulated tracker may begin each time with the same noise, before
    the machine moves.
    """
    mine, theirs = _split(one), _split(other)
    if not mine or not theirs:
        return False
    last = min(max(mine), max(theirs))  # beyond it one of them is incomplete
    fewest = min(sum(value <= last for value in each) for each in (mine, theirs))
    return len(mine & theirs) >= max(_SHARED, _SHARE * fewest)


def _split(sketch: str) -> set[str]:
    return {sketch[k : k + _DIGITS] for k in range(0, len(sketch), _DIGITS)}


def _hash(samples: TrackerSamples) -> UInt64[np.ndarray, " n"]:
    """A hash of every few usable samples in succession, constant ones left out."""
    usable = samples.position_mm[samples.status == 0] + 0.0  # no negative zero
    if len(usable) < _WINDOW:
        return np.empty(0, np.uint64)
    changes = np.any(usable[1:] != usable[:-1], axis=1)
    bits = np.ascontiguousarray(usable, "<f8").view("<u8")
    count = len(bits) - _WINDOW + 1
    value = np.zeros(count, np.uint64)
    moves = np.zeros(count, np.bool_)
    for k in range(_WINDOW):
        for column in range(3):
            value = _mix(value ^ bits[k : k + count, column])
        if k < _WINDOW - 1:
            moves |= changes[k : k + count]
    return value[moves]


def _mix(value: UInt64[np.ndarray, " n"]) -> UInt64[np.ndarray, " n"]:
    """Generator splitmix64."""
    value = value + _STEP
    value = (value ^ (value >> np.uint64(30))) * _MIX[0]
    value = (value ^ (value >> np.uint64(27))) * _MIX[1]
    return value ^ (value >> np.uint64(31))
