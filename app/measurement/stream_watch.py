"""Judges the tracker's stream while it is recorded. Never waits, reads no clock."""

from __future__ import annotations

import threading
from enum import Enum

import numpy as np

from app.measurement.limits import Patience
from drivers.interfaces.records import TrackerSamples


class Verdict(Enum):
    """How the stream is."""

    GOOD = "good"
    SILENT = "silent"  # nothing came for a while: hold the feed
    DEAD = "dead"  # nothing came for so long that it will not come by itself
    BEAM_LOST = "beam-lost"  # samples come, none of them valid


class StreamWatch:
    """Latest of the stream and a verdict on it. Any thread may call any method.

    now_s : time that the host has run, given with each call
    """

    def __init__(self, patience: Patience, now_s: float) -> None:
        self._patience = patience
        self._lock = threading.Lock()
        self._seen_s = self._valid_s = now_s
        self._device_time_s: float | None = None
        self._has_valid = False

    @property
    def device_time_s(self) -> float | None:
        """Device clock of the newest sample, None before the first."""
        return self._device_time_s

    @property
    def has_valid(self) -> bool:
        """Whether a valid sample has come so far."""
        return self._has_valid

    def seen(self, block: TrackerSamples, now_s: float) -> None:
        """Take note of a block that has just come."""
        if not len(block):
            return
        with self._lock:
            self._seen_s = now_s
            self._device_time_s = float(block.device_time_s[-1])
            if np.any(block.status == 0):
                self._valid_s, self._has_valid = now_s, True

    def verdict(self, now_s: float) -> Verdict:
        """Judge the stream as it is now."""
        with self._lock:
            silence_s = now_s - self._seen_s
            # A beam is judged by the samples that came, not by their absence.
            without_beam_s = self._seen_s - self._valid_s
        if silence_s > self._patience.dead_s:
            return Verdict.DEAD
        if silence_s > self._patience.silent_s:
            return Verdict.SILENT
        if without_beam_s > self._patience.beam_s:
            return Verdict.BEAM_LOST
        return Verdict.GOOD
