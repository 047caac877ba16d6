"""Jobs, their events and their idempotency keys in the catalogue.

Every change of state is compare-and-set on `version`, and its event stands in the same
transaction. Progress is written without a new version: it must not make the version
that an operator has read go stale.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from sqlalchemy import Connection, RowMapping, delete, func, insert, select, update

from app.errors import NotFound
from app.jobs.database import Database
from app.jobs.errors import CellBusy, KeyReused, StaleVersion
from app.jobs.job import (
    EarlyEnd,
    Failure,
    Health,
    Job,
    Kind,
    NewJob,
    Progress,
    Stage,
    job_json,
    new_id,
    now_utc,
    progress_from_json,
    progress_json,
)
from app.jobs.schema import events, idempotency_keys, jobs
from app.jobs.transitions import FINAL, State, check_follows
from app.numerics.adaptive_trials import TrialPlan

KEEP_KEYS_S = 24 * 3600
KEEP_EVENTS = 20_000


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """Something that happened, kept so that a client can catch up."""

    id: int
    job_id: str
    type: str
    body: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Key:
    """An Idempotency-Key and the body it came with."""

    value: str
    body: bytes

    @property
    def body_sha256(self) -> str:
        """Digest by which a repeated body is recognised."""
        return hashlib.sha256(self.body).hexdigest()


Listener = Callable[[StoredEvent], None]

_JOBS = select(*[column for column in jobs.c if column is not jobs.c.plan])
_OPEN = tuple(str(state) for state in State if state not in FINAL)


class Store:
    """The catalogue of jobs. Any thread may call it.

    listener : told of every event after its commit, in the order of their identifiers
    """

    def __init__(self, database: Database, listener: Listener) -> None:
        self._database, self._listener = database, listener

    def create(self, new: NewJob, key: Key | None = None) -> tuple[Job, bool]:
        """Add a job; True if it is new, False if the key has made it before.

        Raises KeyReused if the key came with another body, CellBusy if the job would
        measure while another one has not ended.
        """

        def change(connection: Connection) -> tuple[Job, StoredEvent | None]:
            earlier = _by_key(connection, key) if key else None
            if earlier is not None:
                return earlier, None
            if new.kind.measures:
                _refuse_second(connection)
            job = _insert(connection, new)
            if key is not None:
                _insert_key(connection, key, job.id)
            return job, _insert_event(connection, job)

        job, event = self._database.write(change, self._tell)
        return job, event is not None

    def by_key(self, key: Key) -> Job | None:
        """Return the job that a key has made, if any. Raises KeyReused."""
        with self._database.read() as connection:
            return _by_key(connection, key)

    def get(self, job_id: str) -> Job:
        """Return a job. Raises NotFound."""
        with self._database.read() as connection:
            return _get(connection, job_id)

    def plan(self, job_id: str) -> Mapping[str, Any] | None:
        """Return what a job commands or has planned; None if it does not, or not yet.

        Beside the rows stand `request` and `document` of what has been planned.
        """
        content = self._plan_content(job_id)
        return content if "kind" in content else None

    def plan_request(self, job_id: str) -> Mapping[str, Any]:
        """Return what is asked of the plan of a job, nothing if nothing is."""
        return self._plan_content(job_id).get("request") or {}

    def keep_plan(self, job_id: str, plan: Mapping[str, Any]) -> None:
        """Keep what has been planned beside what was asked."""
        content = {"request": self.plan_request(job_id), **plan}
        query = update(jobs).where(jobs.c.id == job_id).values(plan=content)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def page(
        self,
        limit: int,
        *,
        before_seq: int | None = None,
        states: Sequence[State] = (),
        kinds: Sequence[Kind] = (),
    ) -> list[Job]:
        """Return jobs, the newest first, older than `before_seq`."""
        query = _JOBS.order_by(jobs.c.seq.desc()).limit(limit)
        if before_seq is not None:
            query = query.where(jobs.c.seq < before_seq)
        if states:
            query = query.where(jobs.c.state.in_([str(state) for state in states]))
        if kinds:
            query = query.where(jobs.c.kind.in_([str(kind) for kind in kinds]))
        with self._database.read() as connection:
            return [_job(row) for row in connection.execute(query).mappings()]

    def unfinished(self) -> list[Job]:
        """Return the jobs that have not ended, the oldest first."""
        with self._database.read() as connection:
            return _unfinished(connection)

    def change(
        self, job_id: str, change: Callable[[Job], Job], *, version: int | None = None
    ) -> Job:
        """Replace a job by `change(job)`; returning the same object changes nothing.

        version : what the caller has read; StaleVersion if the job has moved on since.
        Raises IllegalTransition if the table does not allow the new state. The start
        and the end of a job are stamped here.
        """

        def apply(connection: Connection) -> tuple[Job, StoredEvent | None]:
            before = _get(connection, job_id)
            if version is not None and before.version != version:
                raise _stale(before, version)
            after = change(before)
            if after is before:
                return before, None
            if after.state is not before.state:
                check_follows(before.state, after.state)
            after = _stamped(before, replace(after, version=before.version + 1))
            _update(connection, before, after)
            return after, _insert_event(connection, after)

        return self._database.write(apply, self._tell)[0]

    def note(
        self, job_id: str, stage: Stage, progress: Progress, health: Health
    ) -> None:
        """Keep how far a job is, without a new version."""
        values = {
            "stage": str(stage),
            "progress": progress_json(progress),
            "health": asdict(health),
        }
        query = update(jobs).where(jobs.c.id == job_id).values(**values)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def events_after(
        self, event_id: int, *, job_id: str | None = None, limit: int = 500
    ) -> list[StoredEvent]:
        """Return kept events in order, those after `event_id`."""
        query = select(events).where(events.c.id > event_id).order_by(events.c.id)
        if job_id is not None:
            query = query.where(events.c.job_id == job_id)
        with self._database.read() as connection:
            rows = connection.execute(query.limit(limit)).mappings()
            return [_event(row) for row in rows]

    def last_event_id(self) -> int:
        """Return the identifier of the newest event, 0 if there is none."""
        with self._database.read() as connection:
            return connection.execute(select(func.max(events.c.id))).scalar() or 0

    def prune(self, *, keep_events: int = KEEP_EVENTS) -> None:
        """Forget events and idempotency keys that nobody can still ask for."""
        oldest_s = int(time.time()) - KEEP_KEYS_S
        last = self.last_event_id()

        def change(connection: Connection) -> None:
            connection.execute(delete(events).where(events.c.id <= last - keep_events))
            old = idempotency_keys.c.created_s < oldest_s
            connection.execute(delete(idempotency_keys).where(old))

        self._database.write(change)

    def _plan_content(self, job_id: str) -> Mapping[str, Any]:
        query = select(jobs.c.plan).where(jobs.c.id == job_id)
        with self._database.read() as connection:
            return connection.execute(query).scalar() or {}

    def _tell(self, outcome: tuple[Job, StoredEvent | None]) -> None:
        event = outcome[1]
        if event is not None:
            self._listener(event)


def _stale(job: Job, version: int) -> StaleVersion:
    return StaleVersion(
        f"version {version} of the job is not the current one, {job.version} "
        f"({job.state}); read the job again",
        job.version,
    )


def _stamped(before: Job, after: Job) -> Job:
    if after.started is None and after.state is State.RUNNING:
        after = replace(after, started=now_utc())
    if after.is_final and not before.is_final:
        after = replace(after, ended=now_utc())
    return after


def _get(connection: Connection, job_id: str) -> Job:
    query = _JOBS.where(jobs.c.id == job_id)
    row = connection.execute(query).mappings().first()
    if row is None:
        raise NotFound(f"there is no job {job_id}")
    return _job(row)


def _unfinished(connection: Connection) -> list[Job]:
    query = _JOBS.where(jobs.c.state.in_(_OPEN)).order_by(jobs.c.seq)
    return [_job(row) for row in connection.execute(query).mappings()]


def _refuse_second(connection: Connection) -> None:
    for job in _unfinished(connection):
        if job.kind.measures:
            raise CellBusy(job.id, job.state)


def _insert(connection: Connection, new: NewJob) -> Job:
    job = Job(
        seq=0,
        id=new_id(),
        kind=new.kind,
        state=State.QUEUED,
        desired_state=str(State.READY if new.kind.measures else State.SUCCEEDED),
        version=1,
        stage=Stage.WAITING,
        created=now_utc(),
        run_id=new.run_id,
        further_run_ids=new.further_run_ids,
        perpendicular_only=new.perpendicular_only,
        monte_carlo=new.monte_carlo,
        target_um=new.target_um,
    )
    values = {**_columns(job), "plan": new.plan}
    done = connection.execute(insert(jobs).values(**values))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return replace(job, seq=done.inserted_primary_key[0])


def _update(connection: Connection, before: Job, after: Job) -> None:
    same = (jobs.c.id == before.id) & (jobs.c.version == before.version)
    values = _columns(after)
    done = connection.execute(update(jobs).where(same).values(**values))
    if done.rowcount != 1:
        raise _stale(_get(connection, before.id), before.version)


def _columns(job: Job) -> dict[str, Any]:
    content = job_json(job)
    del content["seq"]
    return content


def _job(row: RowMapping) -> Job:
    failure, early_end = row["failure"], row["early_end"]
    monte_carlo = row["monte_carlo"]
    return Job(
        **{
            **row,
            "kind": Kind(row["kind"]),
            "state": State(row["state"]),
            "stage": Stage(row["stage"]),
            "progress": progress_from_json(row["progress"]),
            "health": Health(**row["health"]),
            "further_run_ids": tuple(row["further_run_ids"] or ()),
            "failure": Failure(**failure) if failure else None,
            "early_end": EarlyEnd(**early_end) if early_end else None,
            "monte_carlo": TrialPlan(**monte_carlo) if monte_carlo else None,
        }
    )


def _insert_event(connection: Connection, job: Job) -> StoredEvent:
    body = job_json(job)
    row = {"job_id": job.id, "type": "job", "body": body, "created": now_utc()}
    done = connection.execute(insert(events).values(**row))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return StoredEvent(done.inserted_primary_key[0], job.id, "job", body)


def _event(row: RowMapping) -> StoredEvent:
    return StoredEvent(row["id"], row["job_id"], row["type"], row["body"])


def _by_key(connection: Connection, key: Key) -> Job | None:
    query = select(idempotency_keys).where(idempotency_keys.c.key == key.value)
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    if row["body_sha256"] != key.body_sha256:
        raise KeyReused(
            f"Idempotency-Key {key.value!r} has made job {row['job_id']} from another "
            "body; use a new key for a new job"
        )
    return _get(connection, row["job_id"])


def _insert_key(connection: Connection, key: Key, job_id: str) -> None:
    connection.execute(
        insert(idempotency_keys).values(
            key=key.value,
            body_sha256=key.body_sha256,
            job_id=job_id,
            created_s=int(time.time()),
        )
    )
