"""Jobs, their events and their idempotency keys in the catalogue.

Every change of state is compare-and-set on `version`, and its event stands in the same
transaction. Progress is written without a new version: it must not make the version
that an operator has read go stale.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import Connection, delete, func, select, update

from app.jobs import rows
from app.jobs.database import Database
from app.jobs.errors import StaleVersion
from app.jobs.job import (
    Health,
    Job,
    JobEvent,
    JobKind,
    NewJob,
    Progress,
    Stage,
    decode_job,
    encode_progress,
    format_utc_now,
)
from app.jobs.rows import JOBS, IdempotencyKey
from app.jobs.schema import events, idempotency_keys, jobs
from app.jobs.transitions import State, check_transition

KEEP_KEYS_S = 24 * 3600
KEEP_EVENTS = 20_000
_MOST_EVENTS = 500


Listener = Callable[[JobEvent], None]


class Store:
    """The jobs; `listener` receives each event after its commit, in their order."""

    def __init__(self, database: Database, listener: Listener) -> None:
        self._database, self._listener = database, listener

    def create(
        self, new: NewJob, key: IdempotencyKey | None = None
    ) -> tuple[Job, bool]:
        """Add a job; True if it is new, False if the key has made it before.

        Raises KeyReused, CellBusy.
        """

        def change(connection: Connection) -> tuple[Job, JobEvent | None]:
            earlier = rows.find_job_by_key(connection, key) if key else None
            if earlier is not None:
                return earlier, None
            if new.kind.measures:
                rows.refuse_second_measurement(connection)
            job = rows.insert_job(connection, new)
            if key is not None:
                rows.insert_key(connection, key, job.id)
            return job, rows.insert_event(connection, job)

        job, event = self._database.write(change, self._publish)
        return job, event is not None

    def find_by_key(self, key: IdempotencyKey) -> Job | None:
        """Return the job that a key has made, if any. Raises KeyReused."""
        with self._database.read() as connection:
            return rows.find_job_by_key(connection, key)

    def get(self, job_id: str) -> Job:
        """Return a job. Raises NotFound."""
        with self._database.read() as connection:
            return rows.read_job(connection, job_id)

    def read_plan(self, job_id: str) -> Mapping[str, Any] | None:
        """Return what a job commands or has planned, None if nothing or not yet."""
        content = self._read_plan_content(job_id)
        return content if "kind" in content else None

    def read_plan_request(self, job_id: str) -> Mapping[str, Any]:
        """Return what is asked of the plan of a job, nothing if nothing is."""
        return self._read_plan_content(job_id).get("request") or {}

    def keep_plan(self, job_id: str, plan: Mapping[str, Any]) -> None:
        """Keep what has been planned beside what was asked."""
        content = {"request": self.read_plan_request(job_id), **plan}
        query = update(jobs).where(jobs.c.id == job_id).values(plan=content)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def list_page(
        self,
        limit: int,
        *,
        before_seq: int | None = None,
        states: Sequence[State] = (),
        kinds: Sequence[JobKind] = (),
    ) -> list[Job]:
        """Return jobs, the newest first, older than `before_seq`."""
        query = JOBS.order_by(jobs.c.seq.desc()).limit(limit)
        if before_seq is not None:
            query = query.where(jobs.c.seq < before_seq)
        if states:
            query = query.where(jobs.c.state.in_([str(state) for state in states]))
        if kinds:
            query = query.where(jobs.c.kind.in_([str(kind) for kind in kinds]))
        with self._database.read() as connection:
            return [decode_job({**row}) for row in connection.execute(query).mappings()]

    def list_unfinished(self) -> list[Job]:
        """Return the jobs that have not ended, the oldest first."""
        with self._database.read() as connection:
            return rows.read_unfinished_jobs(connection)

    def change(
        self, job_id: str, change: Callable[[Job], Job], *, version: int | None = None
    ) -> Job:
        """Replace a job by `change(job)`, stamped; the same object changes nothing.

        Raises StaleVersion if `version` is given and not the newest, IllegalTransition.
        """

        def apply(connection: Connection) -> tuple[Job, JobEvent | None]:
            before = rows.read_job(connection, job_id)
            if version is not None and before.version != version:
                raise StaleVersion(version, before.version, before.state)
            after = change(before)
            if after is before:
                return before, None
            if after.state is not before.state:
                check_transition(before.state, after.state)
            after = _stamp_times(before, replace(after, version=before.version + 1))
            rows.update_job(connection, before, after)
            return after, rows.insert_event(connection, after)

        return self._database.write(apply, self._publish)[0]

    def keep_progress(
        self, job_id: str, stage: Stage, progress: Progress, health: Health
    ) -> None:
        """Keep how far a job is, without a new version."""
        values = {
            "stage": str(stage),
            "progress": encode_progress(progress),
            "health": asdict(health),
        }
        query = update(jobs).where(jobs.c.id == job_id).values(**values)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def read_events_after(
        self, event_id: int, *, job_id: str | None = None
    ) -> list[JobEvent]:
        """Return kept events in order, at most 500 after `event_id`."""
        query = select(events).where(events.c.id > event_id).order_by(events.c.id)
        if job_id is not None:
            query = query.where(events.c.job_id == job_id)
        with self._database.read() as connection:
            kept = connection.execute(query.limit(_MOST_EVENTS)).mappings()
            return [JobEvent(r["type"], r["job_id"], r["body"], r["id"]) for r in kept]

    def read_last_event_id(self) -> int:
        """Return the identifier of the newest event, 0 if there is none."""
        with self._database.read() as connection:
            return connection.execute(select(func.max(events.c.id))).scalar() or 0

    def prune(self, *, keep_events: int = KEEP_EVENTS) -> None:
        """Forget events and idempotency keys that nobody can still ask for."""
        oldest_s = int(time.time()) - KEEP_KEYS_S
        last = self.read_last_event_id()

        def change(connection: Connection) -> None:
            connection.execute(delete(events).where(events.c.id <= last - keep_events))
            old = idempotency_keys.c.created_s < oldest_s
            connection.execute(delete(idempotency_keys).where(old))

        self._database.write(change)

    def _read_plan_content(self, job_id: str) -> Mapping[str, Any]:
        query = select(jobs.c.plan).where(jobs.c.id == job_id)
        with self._database.read() as connection:
            return connection.execute(query).scalar() or {}

    def _publish(self, outcome: tuple[Job, JobEvent | None]) -> None:
        event = outcome[1]
        if event is not None:
            self._listener(event)


def _stamp_times(before: Job, after: Job) -> Job:
    if after.started is None and after.state is State.RUNNING:
        return replace(after, started=format_utc_now())
    is_end = after.is_final and not before.is_final
    return replace(after, ended=format_utc_now()) if is_end else after
