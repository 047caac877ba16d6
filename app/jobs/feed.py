"""Tells whoever listens what happens: kept events and those that are only for now."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.jobs.estimates import Estimates
from app.jobs.rows import StoredEvent


@dataclass(frozen=True, slots=True)
class Notice:
    """One event: `job` is kept, with its identifier.

    `progress`, `live`, `estimate` and `plan` are not.
    """

    type: str
    job_id: str | None
    body: Mapping[str, Any]
    id: int | None = None


Listener = Callable[[Notice], None]


class Feed:
    """Fans notices out.

    Listeners are called by the thread that tells: they return at once.

    estimates : what the notices `estimate` have said
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self.estimates = Estimates()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Add a listener; call what is returned to remove it."""
        with self._lock:
            self._listeners += (listener,)

        def forget() -> None:
            with self._lock:
                self._listeners = tuple(x for x in self._listeners if x is not listener)

        return forget

    def tell(self, notice: Notice) -> None:
        """Pass a notice to every listener."""
        if notice.type == "estimate" and notice.job_id is not None:
            self.estimates.note(notice.job_id, notice.body)
        for listener in self._listeners:
            listener(notice)

    def tell_stored(self, event: StoredEvent) -> None:
        """Pass on an event that the catalogue has kept."""
        self.tell(Notice(event.type, event.job_id, event.body, event.id))
