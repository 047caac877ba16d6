"""Judges the tracker's stream while it is recorded. Never waits, reads no clock."""

from __future__ import annotations

import threading
from enum import Enum

import numpy as np

from app.measurement.engine_settings import StreamTimeouts
from drivers.interfaces.records import TrackerSamples


class StreamState(Enum):
    """How the stream is."""

    GOOD = "good"
    SILENT = "silent"  # nothing came for a while: hold the feed
    DEAD = "dead"  # nothing came for so long that it will not come by itself
    BEAM_LOST = "beam-lost"  # samples come, none of them valid


class StreamMonitor:
    """Latest of the stream and a verdict on it. Any thread may call any method.

    now_s : time that the host has run, given with each call
    """

    def __init__(self, timeouts: StreamTimeouts, now_s: float) -> None:
        self._timeouts = timeouts
        self._lock = threading.Lock()
        self._received_s = self._valid_s = now_s
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

    def add_block(self, block: TrackerSamples, now_s: float) -> None:
        """Take note of a block that has just come."""
        if not len(block):
            return
        with self._lock:
            self._received_s = now_s
            self._device_time_s = float(block.device_time_s[-1])
            if np.any(block.status == 0):
                self._valid_s, self._has_valid = now_s, True

    def assess(self, now_s: float) -> StreamState:
        """Judge the stream as it is now."""
        with self._lock:
            silence_s = now_s - self._received_s
            # A beam is judged by the samples that came, not by their absence.
            without_beam_s = self._received_s - self._valid_s
        if silence_s > self._timeouts.dead_s:
            return StreamState.DEAD
        if silence_s > self._timeouts.silent_s:
            return StreamState.SILENT
        if without_beam_s > self._timeouts.beam_s:
            return StreamState.BEAM_LOST
        return StreamState.GOOD
