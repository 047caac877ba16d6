"""Publishes events of jobs to listeners: stored events and momentary ones."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.jobs.estimate_history import EstimateHistory
from app.jobs.rows import StoredEvent


@dataclass(frozen=True, slots=True)
class JobEvent:
    """One event of a job.

    type : `job` is stored in the catalogue and has its `id`; `progress`, `live`,
        `estimate` and `plan` are not
    """

    type: str
    job_id: str | None
    body: Mapping[str, Any]
    id: int | None = None


Listener = Callable[[JobEvent], None]


class EventBus:
    """Passes events to every listener.

    Listeners are called by the thread that publishes, so they must return at once.

    estimates : history of the `estimate` events
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self.estimates = EstimateHistory()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Add a listener; call what is returned to remove it."""
        with self._lock:
            self._listeners += (listener,)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(x for x in self._listeners if x is not listener)

        return unsubscribe

    def publish(self, event: JobEvent) -> None:
        """Pass an event to every listener."""
        if event.type == "estimate" and event.job_id is not None:
            self.estimates.add(event.job_id, event.body)
        for listener in self._listeners:
            listener(event)

    def publish_stored(self, event: StoredEvent) -> None:
        """Pass on an event that the catalogue has kept."""
        self.publish(JobEvent(event.type, event.job_id, event.body, event.id))
