"""Tells whoever listens what happens: kept events and those that are only for now."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from app.jobs.store import StoredEvent

ESTIMATES = 16
"""Jobs whose latest live estimate is remembered."""


@dataclass(frozen=True, slots=True)
class Notice:
    """One event: `job` is kept, with its identifier.

    `progress`, `live` and `estimate` are not.
    """

    type: str
    job_id: str | None
    body: Mapping[str, Any]
    id: int | None = None


Listener = Callable[[Notice], None]


class Feed:
    """Fans notices out.

    Listeners are called by the thread that tells: they return at once.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self._estimates: OrderedDict[str, Mapping[str, Any]] = OrderedDict()

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
            self._remember(notice.job_id, notice.body)
        for listener in self._listeners:
            listener(notice)

    def estimate(self, job_id: str) -> Mapping[str, Any] | None:
        """Return the latest live estimate of a job, if it is remembered."""
        return self._estimates.get(job_id)

    def _remember(self, job_id: str, estimate: Mapping[str, Any]) -> None:
        with self._lock:
            self._estimates[job_id] = estimate
            self._estimates.move_to_end(job_id)
            while len(self._estimates) > ESTIMATES:
                self._estimates.popitem(last=False)

    def tell_stored(self, event: StoredEvent) -> None:
        """Pass on an event that the catalogue has kept."""
        self.tell(Notice(event.type, event.job_id, event.body, event.id))
