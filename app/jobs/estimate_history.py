"""The live estimates of a few jobs: the newest, and how the uncertainty came down."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

JOBS = 16
"""Number of jobs whose estimates are kept: those with the newest ones."""
COURSE = ("elapsed_s", "done", "volumetric_uncertainty_um")


@dataclass(slots=True)
class _Remembered:
    newest: Mapping[str, Any]
    course: list[tuple[Any, ...]] = field(default_factory=list)


class EstimateHistory:
    """Estimates of `estimate` events by job. Any thread may call it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: OrderedDict[str, _Remembered] = OrderedDict()

    def add(self, job_id: str, body: Mapping[str, Any]) -> None:
        """Add an estimate; a repeated one adds no step to the course."""
        step = tuple(body[name] for name in COURSE)
        with self._lock:
            job = self._jobs.setdefault(job_id, _Remembered(body))
            job.newest = body
            if job.course[-1:] != [step]:
                job.course.append(step)
            self._jobs.move_to_end(job_id)
            while len(self._jobs) > JOBS:
                self._jobs.popitem(last=False)

    def newest(self, job_id: str) -> Mapping[str, Any] | None:
        """Return the newest estimate of a job, None where none is remembered."""
        job = self._jobs.get(job_id)
        return job.newest if job is not None else None

    def course(self, job_id: str) -> dict[str, list[Any]]:
        """Return the columns `COURSE`, one row an estimate, the oldest first."""
        with self._lock:
            job = self._jobs.get(job_id)
            rows = list(job.course) if job is not None else []
        return {name: [row[i] for row in rows] for i, name in enumerate(COURSE)}
