"""What a tracker tells beside samples, kept until somebody takes it. Any thread."""

from __future__ import annotations

import threading

from truepath.drivers.interfaces.tracker_records import TrackerEvent, TrackerEventKind
from truepath.drivers.tracker.streaming.measurements import StatusBit
from truepath.drivers.tracker.streaming.messages import Event, EventCode

_MOST = 1000  # kept; nobody takes them
_MESSAGES: dict[int, tuple[TrackerEventKind, str]] = {
    EventCode.BEAM_BROKEN: (TrackerEventKind.BEAM_LOST, "the beam was broken"),
    EventCode.BEAM_LOCKED: (TrackerEventKind.BEAM_LOCKED, "the beam is locked again"),
}
_WARNINGS = {
    StatusBit.NOT_LEVELLED: (
        "the tracker is not level",
        "level it and let it compensate, or measure on if its tilt stays",
    ),
    StatusBit.ENVIRONMENT_STALE: (
        "the tracker's weather station has not been read for a while",
        "check its sensor: distances are corrected with old air",
    ),
}


class EventLog:
    """Events in order; each warning once a connection."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._events: list[TrackerEvent] = []
        self._told = 0

    def note(self, event: Event) -> None:
        """Keep an event of the device, at its own time."""
        if (told := _MESSAGES.get(event.code)) is not None:
            kind, text = told
            self._add(TrackerEvent(kind, f"{text} at {1e-6 * event.clock_us:.6f} s"))

    def note_status(self, status: int) -> None:
        """Keep a warning of each bit that was not seen before."""
        for bit, (text, action) in _WARNINGS.items():
            if status & bit & ~self._told:
                self._told |= bit
                self._add(TrackerEvent(TrackerEventKind.WARNING, text, action))

    def take(self) -> tuple[TrackerEvent, ...]:
        """Return the events since the last call."""
        with self._lock:
            events, self._events = tuple(self._events), []
        return events

    def _add(self, event: TrackerEvent) -> None:
        with self._lock:
            self._events = [*self._events, event][-_MOST:]
