"""Counts of a cell since the service began, over all its measurements.

Each measurement, and each new cell process, counts from 0; monitoring of the service
needs sums that only grow.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from truepath.measurement.measurement_state import ENDS
from truepath.measurement.messages import (
    CellEvent,
    CellState,
    CellVerb,
    MeasurementProgress,
    RunClosed,
    StateChanged,
)
from truepath.measurement.time_limits import DurationHistogram
from truepath_drivers import host_clock

_CONFIRMED_BY = {
    CellVerb.PAUSE: {CellState.PAUSED, *ENDS},
    CellVerb.RESUME: {CellState.RUNNING, *ENDS},
    CellVerb.ABORT: ENDS,
}


@dataclass(frozen=True, slots=True)
class CellCounts:
    """Sums since the service began.

    queue_depth : samples that wait to be written now
    commits : durations of commits of a Run
    commands : durations of commands until they were confirmed
    """

    samples: int = 0
    lost_samples: int = 0
    gaps: int = 0
    crc_errors: int = 0
    queue_depth: int = 0
    commits: DurationHistogram = field(default_factory=DurationHistogram)
    commands: dict[str, DurationHistogram] = field(default_factory=dict)


class CellCounters:
    """Follows the events of a cell; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._before, self._now = CellCounts(), CellCounts()
        self._commands: dict[str, DurationHistogram] = {}
        self._expected: dict[CellVerb, float] = {}

    def read(self) -> CellCounts:
        """Sums of ended measurements and the present one."""
        with self._lock:
            joined = _join(self._before, self._now)
            return replace(joined, commands=dict(self._commands))

    def begin_measurement(self) -> None:
        """Start a new measurement; its counts begin at 0, but the tracker's errors."""
        with self._lock:
            self._close_measurement()
            self._expected.clear()

    def count(self, event: CellEvent) -> None:
        """Update the counts from an event."""
        with self._lock:
            match event:
                case MeasurementProgress():
                    self._follow(event)
                case RunClosed(samples=samples, lost_samples=lost):
                    closed = {"samples": samples, "lost_samples": lost}
                    self._now = replace(self._now, queue_depth=0, **closed)
                case StateChanged(state):
                    self._confirm(state)
                case _:
                    pass

    def expect_answer(self, verb: CellVerb) -> None:
        """Start to time a verb, unless an earlier one is not yet confirmed."""
        if verb in _CONFIRMED_BY:
            with self._lock:
                self._expected.setdefault(verb, host_clock.now_s())

    @contextmanager
    def time_command(self, name: str) -> Iterator[None]:
        """Time a command that is confirmed at the end of the block."""
        begun_s = host_clock.now_s()
        yield
        with self._lock:
            self._add_command(name, host_clock.now_s() - begun_s)

    def _follow(self, progress: MeasurementProgress) -> None:
        if progress.crc_errors < self._now.crc_errors:  # connected again
            crc_errors = self._before.crc_errors + self._now.crc_errors
            self._before = replace(self._before, crc_errors=crc_errors)
        self._now = CellCounts(
            progress.samples,
            progress.lost_samples,
            progress.gaps,
            progress.crc_errors,
            progress.queue_depth,
            progress.commits,
        )

    def _close_measurement(self) -> None:
        crc_errors = self._now.crc_errors
        ended = replace(self._now, crc_errors=0)
        self._before = _join(self._before, ended)
        self._now = CellCounts(crc_errors=crc_errors)

    def _confirm(self, state: CellState) -> None:
        for verb, states in _CONFIRMED_BY.items():
            if state in states and verb in self._expected:
                begun_s = self._expected.pop(verb)
                self._add_command(str(verb), host_clock.now_s() - begun_s)

    def _add_command(self, name: str, duration_s: float) -> None:
        before = self._commands.get(name, DurationHistogram())
        self._commands[name] = before.add(duration_s)


def _join(before: CellCounts, now: CellCounts) -> CellCounts:
    return CellCounts(
        before.samples + now.samples,
        before.lost_samples + now.lost_samples,
        before.gaps + now.gaps,
        before.crc_errors + now.crc_errors,
        now.queue_depth,
        before.commits.join(now.commits),
    )
