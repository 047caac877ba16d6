"""Events of jobs for listeners, with the newest live estimates."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from truepath.catalogue.job import JobEvent

JOBS = 16
"""Number of jobs whose estimates are kept: those with the newest ones."""
COURSE = ("elapsed_s", "done", "volumetric_uncertainty_um")

Listener = Callable[[JobEvent], None]


class EventBus:
    """Calls listeners in the thread that publishes: they must return at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Listener, ...] = ()
        self.estimates = EstimateHistory()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Add a listener; calling the result removes it."""
        with self._lock:
            self._listeners += (listener,)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(x for x in self._listeners if x is not listener)

        return unsubscribe

    def publish(self, event: JobEvent) -> None:
        """Pass an event to every listener; estimates are also remembered."""
        if event.type == "estimate" and event.job_id is not None:
            self.estimates.add(event.job_id, event.body)
        for listener in self._listeners:
            listener(event)


class EstimateHistory:
    """Newest estimates of `JOBS` jobs, with the course of their uncertainty."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: OrderedDict[str, Mapping[str, Any]] = OrderedDict()
        self._courses: dict[str, list[tuple[Any, ...]]] = {}

    def add(self, job_id: str, body: Mapping[str, Any]) -> None:
        """Add an estimate; a repeated one adds no step to the course."""
        step = tuple(body[name] for name in COURSE)
        with self._lock:
            self._newest[job_id] = body
            self._newest.move_to_end(job_id)
            course = self._courses.setdefault(job_id, [])
            if course[-1:] != [step]:
                course.append(step)
            while len(self._newest) > JOBS:
                oldest, _ = self._newest.popitem(last=False)
                del self._courses[oldest]

    def newest(self, job_id: str) -> Mapping[str, Any] | None:
        """None where no estimate is remembered."""
        return self._newest.get(job_id)

    def course(self, job_id: str) -> dict[str, list[Any]]:
        """Columns `COURSE`, one row per estimate, oldest first."""
        with self._lock:
            rows = list(self._courses.get(job_id, ()))
        return {name: [row[i] for row in rows] for i, name in enumerate(COURSE)}
