"""Rows of jobs, events and idempotency keys, in the transaction of the caller."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, fields, replace
from typing import Any

from sqlalchemy import Connection, insert, select, update

from app.errors import NotFound
from app.jobs.errors import CellBusy, KeyReused, StaleVersion
from app.jobs.job import (
    Job,
    JobEvent,
    NewJob,
    Stage,
    decode_job,
    encode_job,
    format_utc_now,
    make_id,
)
from app.jobs.schema import events, idempotency_keys, jobs
from app.jobs.transitions import FINAL, State

JOBS = select(*[column for column in jobs.c if column is not jobs.c.plan])
_OPEN = tuple(str(state) for state in State if state not in FINAL)


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An Idempotency-Key and the body it came with."""

    value: str
    body: bytes

    @property
    def body_sha256(self) -> str:
        """Digest by which a repeated body is recognised."""
        return hashlib.sha256(self.body).hexdigest()


def read_job(connection: Connection, job_id: str) -> Job:
    """Return a job. Raises NotFound."""
    query = JOBS.where(jobs.c.id == job_id)
    row = connection.execute(query).mappings().first()
    if row is None:
        raise NotFound(f"there is no job {job_id}")
    return decode_job({**row})


def read_unfinished_jobs(connection: Connection) -> list[Job]:
    """Return the jobs that have not ended, oldest first."""
    query = JOBS.where(jobs.c.state.in_(_OPEN)).order_by(jobs.c.seq)
    return [decode_job({**row}) for row in connection.execute(query).mappings()]


def refuse_second_measurement(connection: Connection) -> None:
    """Raise CellBusy if another job measures."""
    for job in read_unfinished_jobs(connection):
        if job.kind.measures:
            raise CellBusy(job.id, job.state)


def insert_job(connection: Connection, new: NewJob) -> Job:
    """Write a new job and return it with its number."""
    job = Job(
        seq=0,
        id=make_id(),
        state=State.QUEUED,
        desired_state=str(State.READY if new.kind.measures else State.SUCCEEDED),
        version=1,
        stage=Stage.WAITING,
        created=format_utc_now(),
        **{f.name: getattr(new, f.name) for f in fields(new) if f.name != "plan"},
    )
    values = {**_encode_columns(job), "plan": new.plan}
    done = connection.execute(insert(jobs).values(**values))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return replace(job, seq=done.inserted_primary_key[0])


def update_job(connection: Connection, before: Job, after: Job) -> None:
    """Write a job over its version before. Raises StaleVersion."""
    same = (jobs.c.id == before.id) & (jobs.c.version == before.version)
    values = _encode_columns(after)
    done = connection.execute(update(jobs).where(same).values(**values))
    if done.rowcount != 1:
        now = read_job(connection, before.id)
        raise StaleVersion(before.version, now.version, now.state)


def _encode_columns(job: Job) -> dict[str, Any]:
    content = encode_job(job)
    del content["seq"]
    return content


def insert_event(connection: Connection, job: Job) -> JobEvent:
    """Write that a job has changed."""
    body = encode_job(job)
    row = {"job_id": job.id, "type": "job", "body": body, "created": format_utc_now()}
    done = connection.execute(insert(events).values(**row))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return JobEvent("job", job.id, body, done.inserted_primary_key[0])


def find_job_by_key(connection: Connection, key: IdempotencyKey) -> Job | None:
    """Return the job that a key has made. Raises KeyReused."""
    query = select(idempotency_keys).where(idempotency_keys.c.key == key.value)
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    if row["body_sha256"] != key.body_sha256:
        raise KeyReused(
            f"Idempotency-Key {key.value!r} has made job {row['job_id']} from another "
            "body; use a new key for a new job"
        )
    return read_job(connection, row["job_id"])


def insert_key(connection: Connection, key: IdempotencyKey, job_id: str) -> None:
    """Write which job a key has made."""
    row = {"key": key.value, "body_sha256": key.body_sha256, "job_id": job_id}
    query = insert(idempotency_keys).values(**row, created_s=int(time.time()))
    connection.execute(query)
