"""Stamps that were rounded, or set in bursts, to the times of rows that come evenly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_SHARE = 0.4  # of the rows: so many follow at once where stamps come in bursts
_AT_ONCE = 0.2  # of the mean step
_LONG = (3.0, 1.5)  # times the usual way between stamps: a gap; the second if need be
_LATE = 1.1  # of that way: how far stamps may lie off rows that come evenly
_LATE_S = 0.02  # and of a computer that was busy
_ROUND = 0.005  # of a rate: so far it may be off a whole number of rows a second
_LEAST = 100  # rows that tell a rate


def even_out(time_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return times of rows that come evenly between gaps, and words on it, or neither.

    The words are empty where the stamps are not of that kind, or rows are missing.
    """
    step = np.diff(time_s)
    if len(step) < _LEAST or (step < 0).any() or not (step > 0).any():
        return time_s, ""
    mean = float(step[step <= np.percentile(step, 99.9)].mean())
    tied = bool((step == 0).any())
    if not tied and (step < _AT_ONCE * mean).mean() < _SHARE:
        return time_s, ""
    heads = np.flatnonzero(step > (0.0 if tied else mean)) + 1
    if len(heads) < 3:
        return time_s, ""
    way = float(np.median(np.diff(time_s[heads])))
    for long in _LONG:
        part = np.append(0, np.cumsum(step > long * way))
        begin, count = np.unique(part, return_index=True, return_counts=True)[1:]
        row = np.arange(len(time_s), dtype=float)
        row -= (np.bincount(part, row) / count)[part]
        middle = (np.bincount(part, time_s) / count)[part]
        usual = float(row @ (time_s - middle) / (row @ row))
        whole = np.rint(1.0 / usual)
        choices = [1.0 / whole] if abs(usual * whole - 1.0) < _ROUND else []
        for each in (*choices, usual):
            even = middle + each * row
            late = time_s - even
            spread = np.maximum.reduceat(late, begin) - np.minimum.reduceat(late, begin)
            if spread.max() < _LATE * way + max(_LATE_S, 2.0 * each):
                words = f"stamps {way:.3g} s apart, {way / each:.3g} rows in each: "
                return even - even[0], words + f"rows come at {1 / each:.6g} Hz"
    return time_s, ""
