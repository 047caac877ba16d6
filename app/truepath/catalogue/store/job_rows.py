"""Jobs as rows of the catalogue, over one connection."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Select, exists, insert, select, update

from truepath.catalogue.errors import CellBusy, StaleVersion
from truepath.catalogue.job import (
    Job,
    JobKind,
    Json,
    decode_job,
    encode_job,
    format_utc_now,
)
from truepath.catalogue.schema import jobs, runs
from truepath.catalogue.transitions import FINAL, State
from truepath.errors import NotFound

JOBS = select(*[column for column in jobs.c if column is not jobs.c.plan])
OPEN_STATES = [str(state) for state in State if state not in FINAL]
UNFINISHED = JOBS.where(jobs.c.state.in_(OPEN_STATES)).order_by(jobs.c.seq)
_HAS_RUN = exists().where(runs.c.id == jobs.c.id)
MEASURED_WITHOUT_RUN = JOBS.where(
    jobs.c.kind.like("measure-%"),
    jobs.c.run_id.is_(None),
    jobs.c.state.not_in(OPEN_STATES),
    _HAS_RUN,
).order_by(jobs.c.seq)


def select_jobs(connection: Connection, query: Select[Any]) -> list[Job]:
    """Jobs of a query on `JOBS`, in its order."""
    return [decode_job({**row}) for row in connection.execute(query).mappings()]


def read_job(connection: Connection, job_id: str) -> Job:
    """Raises NotFound."""
    for job in select_jobs(connection, JOBS.where(jobs.c.id == job_id)):
        return job
    raise NotFound(f"there is no job {job_id}")


def find_analyses_of_one(connection: Connection) -> dict[str, str]:
    """By Run, the newest job with a result of that Run alone."""
    query = select(jobs.c.run_id, jobs.c.id, jobs.c.kind, jobs.c.further_run_ids)
    query = query.where(jobs.c.state == str(State.SUCCEEDED))
    found: dict[str, str] = {}
    for row in connection.execute(query.order_by(jobs.c.seq)).mappings():
        is_alone = row["run_id"] and not row["further_run_ids"]
        if is_alone and JobKind(row["kind"]).analyses:
            found[row["run_id"]] = row["id"]
    return found


def insert_job(connection: Connection, new: Job, plan: Json | None) -> Job:
    """Add a job; the result has its goal, its time and its `seq`."""
    goal = State.READY if new.kind.measures else State.SUCCEEDED
    now = format_utc_now()
    job = replace(new, desired_state=str(goal), created=now)
    query = insert(jobs).values(**encode_columns(job), plan=plan)
    done = connection.execute(query)
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return replace(job, seq=done.inserted_primary_key[0])


def update_job(connection: Connection, before: Job, after: Job) -> None:
    """Write a job over its version before. Raises StaleVersion."""
    same = (jobs.c.id == before.id) & (jobs.c.version == before.version)
    columns = encode_columns(after)
    for given_by_people in ("name", "note"):  # changed without a new version
        del columns[given_by_people]
    query = update(jobs).where(same).values(**columns)
    if connection.execute(query).rowcount != 1:
        now = read_job(connection, before.id)
        raise StaleVersion(before.version, now.version, now.state)


def encode_columns(job: Job) -> dict[str, Any]:
    """Values of all columns of a job but `seq` and `plan`."""
    content = encode_job(job)
    del content["seq"]
    return content


def reject_second_measurement(connection: Connection, machine: str | None) -> None:
    """Raise CellBusy if a measurement of the machine has not ended."""
    for job in select_jobs(connection, UNFINISHED):
        if job.kind.measures and job.machine == machine:
            raise CellBusy(job.id, job.state)
