"""Writes aborts down: the machine is stopped first, the books follow when they can."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import structlog

from truepath.app.jobs.active_job import ActiveJob
from truepath.app.jobs.errors import StorageUnavailable
from truepath.app.jobs.job import Job
from truepath.app.jobs.transitions import Verb

log = structlog.get_logger(__name__)

BOOKS_S = 0.7  # that whoever stops the machine waits for the catalogue


def write_aborts(aborted: Sequence[ActiveJob]) -> list[Job]:
    """Write down what the machine was told, and return the jobs.

    Whoever asked is answered in time even where the catalogue is not: jobs are then
    as they were stored last, and their own threads write down how they end.
    """
    written: dict[str, Job] = {}
    writers = [
        threading.Thread(target=_write_abort, args=(active, written), daemon=True)
        for active in aborted
    ]
    for writer in writers:
        writer.start()
    end = time.monotonic() + BOOKS_S
    for writer in writers:
        writer.join(max(0.0, end - time.monotonic()))
    return [written.get(one.job_id) or one.show(one.job) for one in aborted]


def _write_abort(active: ActiveJob, written: dict[str, Job]) -> None:
    try:
        written[active.job_id] = active.apply_verb(Verb.ABORT)
    except StorageUnavailable as error:
        log.warning("an abort is not written down", job=active.job_id, why=error)
