"""Deletion of jobs and Runs: first their rows, then their files.

The rows go in one transaction, which notes the deletion. Files follow; those that
remain after a crash or a disk error go at the next sweep, and a Run that is noted as
deleted is not catalogued again. An empty file `ID.deleted` beside the results remains
of a job, so that a rebuild from its Runs does not restore it.

Not deleted, because something depends on it: a job that others were made from, that a
machine is compared with or that a certificate cites; a Run of a result, or of a
measurement that can be resumed from it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import structlog
from sqlalchemy import Connection, Text, cast, delete, insert, or_, select, update

from truepath.catalogue.errors import StillNeeded
from truepath.catalogue.job import Job, JobKind, format_utc_now
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.schema import (
    deletions,
    events,
    idempotency_keys,
    jobs,
    machines,
    runs,
)
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.job_rows import JOBS, read_job, select_jobs
from truepath.catalogue.transitions import State
from truepath.documents.file_model import as_object, parse_json
from truepath.documents.whole_files import sync_to_disk
from truepath.errors import BundleError
from truepath.jobs.dispatch.resumability import can_go_on
from truepath.jobs.kinds.station_steps import list_run_ids
from truepath.jobs.running.resumption import list_part_ids
from truepath.measurement.run_file.run_file import hash_file

log = structlog.get_logger(__name__)

_STATED = ("result.json", "verification.json")  # by certificates, of other jobs too
_CERTIFICATES = "certificates/*/certificate.json"
_MARK = ".deleted"


@dataclass(frozen=True, slots=True)
class Deleted:
    """Identifier and files of one deletion.

    kind : `job` or `run`
    files : SHA-256 by name, below the folder of the data
    """

    kind: str
    id: str
    files: Mapping[str, str]


Note = Callable[[Connection, Deleted], None]


class Deletion:
    """Deletes jobs and Runs without dependants; thread-safe."""

    def __init__(self, database: Database, catalogue: RunCatalogue, results: Path):
        self._database, self._catalogue, self._results = database, catalogue, results

    def delete_job(self, job_id: str, note: Note | None = None) -> Deleted:
        """Delete an ended job with its answer; its Runs stay.

        note : is called in the same transaction

        Raises NotFound, StillNeeded.
        """
        self._reject_certified(job_id)
        found = Deleted("job", job_id, self._hash_files(job_id))

        def change(connection: Connection) -> None:
            _delete_job(connection, read_job(connection, job_id))
            if note is not None:
                note(connection, found)

        self._database.write(change)
        self.remove_files()
        return found

    def delete_run(
        self, run_id: str, *, with_results: bool = False, note: Note | None = None
    ) -> list[Deleted]:
        """Delete a Run and references by jobs without an answer; lists deletions.

        with_results : delete the jobs too whose answers were made from it
        note : is called in the same transaction, for each

        Raises NotFound, StillNeeded.
        """
        record = self._catalogue.get(run_id)
        with self._database.read() as connection:
            answers = [job for job in _list_users(connection, run_id) if _answers(job)]
        if answers and not with_results:
            raise _make_refusal(f"run {run_id}", answers)
        for job in answers:
            self._reject_certified(job.id)
        found = [Deleted("job", job.id, self._hash_files(job.id)) for job in answers]
        files = {f"runs/{record.file}": record.sha256}
        found.append(Deleted("run", run_id, files))
        allowed = {job.id for job in answers}

        def change(connection: Connection) -> None:
            _delete_run(connection, run_id, allowed)
            if note is not None:
                for one in found:
                    note(connection, one)

        self._database.write(change)
        self.remove_files()
        return found

    def remove_files(self) -> None:
        """Remove the files of noted deletions, then the notes.

        Failures are logged and tried again at the next call.
        """
        with self._database.read() as connection:
            noted = connection.execute(select(deletions.c.kind, deletions.c.id)).all()
        for kind, name in noted:
            try:
                self._remove_files_of(kind, name)
            except OSError as error:
                log.warning("files stay", deleted=kind, id=name, reason=str(error))
                continue
            gone = (deletions.c.kind == kind) & (deletions.c.id == name)
            query = delete(deletions).where(gone)
            self._database.write(lambda c, query=query: c.execute(query).rowcount)
            log.info("deleted", kind=kind, id=name)

    def _remove_files_of(self, kind: str, name: str) -> None:
        if kind == "run":
            self._catalogue.remove_files(name)
            return
        folder = self._results / name
        self._results.mkdir(parents=True, exist_ok=True)
        folder.with_name(name + _MARK).touch()
        sync_to_disk(self._results)
        if folder.is_dir():
            shutil.rmtree(folder)

    def _hash_files(self, job_id: str) -> dict[str, str]:
        files = sorted(f for f in (self._results / job_id).rglob("*") if f.is_file())
        above = self._results.parent
        return {f.relative_to(above).as_posix(): hash_file(f) for f in files}

    def _reject_certified(self, job_id: str) -> None:
        own = self._results / job_id
        stated = {hash_file(own / n) for n in _STATED if (own / n).is_file()}
        for record in self._results.glob(f"*/{_CERTIFICATES}"):
            if record.is_relative_to(own) or stated.intersection(_list_sources(record)):
                number = record.parent.name
                text = f"certificate {number} states the result of job {job_id}"
                raise StillNeeded(text, [f"certificate {number}"])


def _list_sources(record: Path) -> list[object]:
    """An unreadable certificate protects only its own job."""
    try:
        content = as_object(parse_json(record.read_bytes(), record.name))
    except (BundleError, OSError) as error:
        log.warning("certificate not read", file=str(record), reason=str(error))
        return []
    return list(as_object(content.get("sources_sha256")).values())


def list_deleted_jobs(database: Database, results: Path) -> set[str]:
    """Identifiers of deleted jobs, from mark files and noted deletions."""
    query = select(deletions.c.id).where(deletions.c.kind == "job")
    with database.read() as connection:
        noted = set(connection.execute(query).scalars())
    return noted | {mark.stem for mark in results.glob(f"*{_MARK}")}


def _delete_job(
    connection: Connection, job: Job, together: frozenset[str] | set[str] = frozenset()
) -> None:
    if not job.is_final:
        raise StillNeeded(f"job {job.id} ({job.state}) has not ended", [job.id])
    users = [one for one in _list_users(connection, job.id) if one.id not in together]
    users = [one for one in users if one.id != job.id]
    if users:
        raise _make_refusal(f"job {job.id}", users)
    held = select(machines.c.id).where(machines.c.reference_job == job.id)
    for machine in connection.execute(held).scalars():
        text = f"machine {machine} is held against job {job.id}"
        raise StillNeeded(text, [f"machine {machine}"])
    for table in (events, idempotency_keys):
        connection.execute(delete(table).where(table.c.job_id == job.id))
    connection.execute(delete(jobs).where(jobs.c.id == job.id))
    _note_deletion(connection, "job", job.id)


def _delete_run(connection: Connection, run_id: str, allowed: set[str]) -> None:
    users = _list_users(connection, run_id)
    needed = [
        job
        for job in users
        if not job.is_final
        or (_answers(job) and job.id not in allowed)
        or _goes_on_from(connection, job, run_id)
    ]
    if needed:
        raise _make_refusal(f"run {run_id}", needed)
    for job in users:
        if _answers(job):
            _delete_job(connection, job, allowed)
        elif run_id in job.run_ids:
            _remove_run(connection, job, run_id)
    connection.execute(delete(runs).where(runs.c.id == run_id))
    _note_deletion(connection, "run", run_id)


def _remove_run(connection: Connection, job: Job, run_id: str) -> None:
    left = [one for one in job.run_ids if one != run_id]
    if job.run_id != run_id:
        first = job.run_id
    else:
        is_extra = job.kind is JobKind.MEASURE_EXTRA  # its own Run is the last one
        first = left[0] if left and not is_extra else None
    values = {
        "run_id": first,
        "further_run_ids": [one for one in left if one != first],
        "version": job.version + 1,
    }
    connection.execute(update(jobs).where(jobs.c.id == job.id).values(**values))


def _goes_on_from(connection: Connection, job: Job, run_id: str) -> bool:
    query = select(jobs.c.plan).where(jobs.c.id == job.id)
    plan = connection.execute(query).scalar() or {}
    own = {*job.run_ids, *list_part_ids(plan)}
    own.update(list_run_ids(plan), list_run_ids(plan, "points_id"))
    return run_id in own and can_go_on(job, plan)


def _answers(job: Job) -> bool:
    return job.state is State.SUCCEEDED and job.kind is not JobKind.PLAN


def _list_users(connection: Connection, name: str) -> Sequence[Job]:
    texts = (cast(column, Text) for column in (jobs.c.further_run_ids, jobs.c.plan))
    named = [text.contains(name, autoescape=True) for text in texts]
    query = JOBS.where(or_(jobs.c.run_id == name, *named)).order_by(jobs.c.seq)
    return select_jobs(connection, query)


def _make_refusal(what: str, users: Sequence[Job]) -> StillNeeded:
    named = ", ".join(f"{job.id} ({job.kind}, {job.state})" for job in users[:10])
    more = f" and {len(users) - 10} more" if len(users) > 10 else ""
    return StillNeeded(
        f"{what} is used by job {named}{more}", [job.id for job in users]
    )


def _note_deletion(connection: Connection, kind: str, name: str) -> None:
    row = {"kind": kind, "id": name, "created": format_utc_now()}
    connection.execute(insert(deletions).values(**row))
