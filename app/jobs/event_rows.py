"""Events of jobs as rows of the catalogue, over one connection."""

from __future__ import annotations

from sqlalchemy import Connection, func, insert, select

from truepath.app.jobs.job import Job, JobEvent, encode_job, format_utc_now
from truepath.app.jobs.schema import events

_MOST_EVENTS = 500


def insert_event(connection: Connection, job: Job) -> JobEvent:
    """Add the event that a job is as it is now."""
    body = encode_job(job)
    row = {"job_id": job.id, "type": "job", "body": body, "created": format_utc_now()}
    done = connection.execute(insert(events).values(**row))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return JobEvent("job", job.id, body, done.inserted_primary_key[0])


def find_first_event(connection: Connection, job_id: str) -> JobEvent | None:
    """Return the event of a job that was added, None where there is no such job."""
    query = select(events).where(events.c.job_id == job_id).order_by(events.c.id)
    row = connection.execute(query.limit(1)).mappings().first()
    if row is None:
        return None
    return JobEvent(row["type"], job_id, row["body"], row["id"])


def select_events_after(
    connection: Connection, event_id: int, job_id: str | None
) -> list[JobEvent]:
    """Return kept events in order, at most 500 after `event_id`.

    job_id : of the one job whose events are asked for; None for all
    """
    query = select(events).where(events.c.id > event_id).order_by(events.c.id)
    if job_id is not None:
        query = query.where(events.c.job_id == job_id)
    kept = connection.execute(query.limit(_MOST_EVENTS)).mappings()
    return [JobEvent(r["type"], r["job_id"], r["body"], r["id"]) for r in kept]


def find_last_event_id(connection: Connection) -> int:
    """Return the identifier of the newest event, 0 if there is none."""
    return connection.execute(select(func.max(events.c.id))).scalar() or 0
