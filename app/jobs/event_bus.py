"""Tells whoever listens what happens: kept events and those that are only for now."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.jobs.estimate_history import EstimateHistory
from app.jobs.rows import StoredEvent


@dataclass(frozen=True, slots=True)
class JobEvent:
    """One event: `job` is kept, with its identifier.

    `progress`, `live`, `estimate` and `plan` are not.
    """

    type: str
    job_id: str | None
    body: Mapping[str, Any]
    id: int | None = None


Listener = Callable[[JobEvent], None]


class EventBus:
    """Fans notices out.

    Listeners are called by the thread that tells: they return at once.

    estimates : what the notices `estimate` have said
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self.estimates = EstimateHistory()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Add a listener; call what is returned to remove it."""
        with self._lock:
            self._listeners += (listener,)

        def forget() -> None:
            with self._lock:
                self._listeners = tuple(x for x in self._listeners if x is not listener)

        return forget

    def publish(self, notice: JobEvent) -> None:
        """Pass a notice to every listener."""
        if notice.type == "estimate" and notice.job_id is not None:
            self.estimates.add(notice.job_id, notice.body)
        for listener in self._listeners:
            listener(notice)

    def publish_stored(self, event: StoredEvent) -> None:
        """Pass on an event that the catalogue has kept."""
        self.publish(JobEvent(event.type, event.job_id, event.body, event.id))
