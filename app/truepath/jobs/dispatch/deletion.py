"""Deletion of jobs and Runs, on request or by age: first rows, then files.

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
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import structlog
from sqlalchemy import Connection, Text, cast, delete, insert, or_, select, update

from truepath.catalogue.calibrations import Calibrations
from truepath.catalogue.database import Database
from truepath.catalogue.errors import StillNeeded, StorageUnavailable
from truepath.catalogue.job import Job, JobKind, format_utc, format_utc_now
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.schema import (
    deletions,
    events,
    idempotency_keys,
    jobs,
    machines,
    runs,
)
from truepath.catalogue.store import JOBS, read_job, select_jobs
from truepath.documents.file_model import as_object, parse_json
from truepath.documents.whole_files import sync_to_disk
from truepath.errors import BundleError, NotFound, TruepathError
from truepath.jobs.running.context import JobContext
from truepath.jobs.running.resumption import can_go_on, list_part_ids, list_run_ids
from truepath.measurement.run_file.run_file import hash_file
from truepath_drivers import host_clock

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
            answers = [job for job in _list_users(connection, run_id) if job.answer]
        if answers and not with_results:
            raise _make_still_needed(f"run {run_id}", answers)
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
        raise _make_still_needed(f"job {job.id}", users)
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
        or (job.answer and job.id not in allowed)
        or _goes_on_from(connection, job, run_id)
    ]
    if needed:
        raise _make_still_needed(f"run {run_id}", needed)
    for job in users:
        if job.answer:
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


def _list_users(connection: Connection, name: str) -> Sequence[Job]:
    texts = (cast(column, Text) for column in (jobs.c.further_run_ids, jobs.c.plan))
    named = [text.contains(name, autoescape=True) for text in texts]
    query = JOBS.where(or_(jobs.c.run_id == name, *named)).order_by(jobs.c.seq)
    return select_jobs(connection, query)


def _make_still_needed(what: str, users: Sequence[Job]) -> StillNeeded:
    named = ", ".join(f"{job.id} ({job.kind}, {job.state})" for job in users[:10])
    more = f" and {len(users) - 10} more" if len(users) > 10 else ""
    return StillNeeded(
        f"{what} is used by job {named}{more}", [job.id for job in users]
    )


def _note_deletion(connection: Connection, kind: str, name: str) -> None:
    row = {"kind": kind, "id": name, "created": format_utc_now()}
    connection.execute(insert(deletions).values(**row))


EVERY_S = 3600.0
FIRST_S = 60.0
MOST_AHEAD = timedelta(days=30)
"""How far the clock may be ahead of the newest job: else it may be wrong."""
_PAGE = 200


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """Days for which Runs, and jobs with their answers, are kept; 0 is for ever."""

    keep_runs_days: int = 0
    keep_results_days: int = 0


class Retention:
    """Periodic deletion by age in a separate thread; dependencies are kept.

    Calibrations in the history of a machine stay, and so does every Run of a result.
    Superseded analyses, verifications, plans, failed jobs and their Runs are deleted
    when old enough; expired keys and events are pruned too.

    note : records each deletion, in its transaction
    is_measuring : nothing is deleted while it is true
    """

    def __init__(
        self,
        context: JobContext,
        calibrations: Calibrations,
        deletion: Deletion,
        rules: RetentionRules,
        note: Note,
        is_measuring: Callable[[], bool],
    ) -> None:
        self._context, self._calibrations = context, calibrations
        self._deletion, self._rules, self._note = deletion, rules, note
        self._is_measuring = is_measuring
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="retention")

    def start(self) -> None:
        """Start the thread; files left by earlier deletions are removed first."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread after the current deletion."""
        self._closing.set()
        if self._thread.is_alive():
            host_clock.join(self._thread)

    def sweep(self, now: datetime | None = None) -> int:
        """Delete expired items; gives their number. Raises StorageUnavailable.

        Deletes nothing where the clock is behind the newest job, or `MOST_AHEAD` of it.
        """
        now = now or datetime.now(UTC)
        self._context.store.prune()
        self._deletion.remove_files()
        if not self._is_plausible(now):
            return 0
        count = 0
        if days := self._rules.keep_results_days:
            count += self._sweep_jobs(now - timedelta(days=days))
        if days := self._rules.keep_runs_days:
            count += self._sweep_runs(now - timedelta(days=days))
        if count:
            log.info("kept long enough", deleted=count)
        return count

    def _is_plausible(self, now: datetime) -> bool:
        newest = self._context.store.find_newest_created()
        if newest is None or newest <= now <= newest + MOST_AHEAD:
            return True
        if self._rules != RetentionRules():
            log.warning(
                "nothing is deleted: the clock does not go with the newest job; set it "
                "right, or make any job where it is",
                clock=format_utc(now),
                newest_job=format_utc(newest),
            )
        return False

    def _sweep_jobs(self, before: datetime) -> int:
        machines = self._context.store.list_machines()
        known = (self._calibrations.list_of(machine) for machine in machines)
        history = {one.job_id for calibrations in known for one in calibrations}
        count, seq = 0, None
        while page := self._context.store.list_page(_PAGE, before_seq=seq):
            seq = page[-1].seq
            for job in page:  # the newest first: it may depend on an older one
                is_old = job.is_final and (job.ended or job.created) < format_utc(
                    before
                )
                if is_old and job.id not in history:
                    count += self._try(
                        lambda i=job.id: self._deletion.delete_job(i, self._note)
                    )
        return count

    def _sweep_runs(self, before: datetime) -> int:
        count, seq = 0, None
        while page := self._context.runs.list_page(_PAGE, before_seq=seq, until=before):
            seq = page[-1].seq
            for run in page:
                count += self._try(
                    lambda i=run.id: self._deletion.delete_run(i, note=self._note)
                )
        return count

    def _try(self, delete: Callable[[], object]) -> int:
        if self._closing.is_set() or self._is_measuring():
            return 0
        try:
            delete()
        except (StillNeeded, NotFound) as error:
            log.debug("kept", reason=str(error))
            return 0
        except StorageUnavailable:
            raise
        except TruepathError as error:  # of this one: the others continue
            log.warning("not deleted", reason=str(error))
            return 0
        return 1

    def _run(self) -> None:
        pause_s = FIRST_S
        while not host_clock.wait(self._closing, pause_s):
            pause_s = EVERY_S
            try:
                self.sweep()
            except (TruepathError, OSError) as error:
                log.warning("nothing more is deleted for now", reason=str(error))
            except Exception:
                log.exception("nothing more is deleted for now")
