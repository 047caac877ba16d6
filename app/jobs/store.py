"""Jobs, their events and their idempotency keys in the catalogue.

Every change of state is compare-and-set on `version`, and its event stands in the same
transaction. Progress is written without a new version: it must not make the version
that an operator has read go stale.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from typing import Any

from sqlalchemy import (
    Connection,
    Select,
    delete,
    exists,
    func,
    insert,
    select,
    update,
)

from truepath.app.errors import IllegalTransition, NotFound
from truepath.app.jobs.database import Database
from truepath.app.jobs.errors import CellBusy, KeyReused, StaleVersion
from truepath.app.jobs.job import (
    Health,
    Job,
    JobEvent,
    JobKind,
    Json,
    Progress,
    Stage,
    decode_job,
    encode_job,
    format_utc,
    format_utc_now,
    make_id,
)
from truepath.app.jobs.schema import events, idempotency_keys, jobs, runs
from truepath.app.jobs.transitions import FINAL, State, check_transition

KEEP_KEYS_S = 24 * 3600
KEEP_EVENTS = 20_000
_MOST_EVENTS = 500
_JOBS = select(*[column for column in jobs.c if column is not jobs.c.plan])
_OPEN = [str(state) for state in State if state not in FINAL]
_UNFINISHED = _JOBS.where(jobs.c.state.in_(_OPEN)).order_by(jobs.c.seq)


Listener = Callable[[JobEvent], None]


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An Idempotency-Key, the body it came with, and whose it is.

    owner : name of the user; None where nobody logs in
    """

    value: str
    body: bytes
    owner: str | None = None

    @property
    def kept(self) -> str:
        """What it is kept as: two users may choose the same."""
        if self.owner is None:
            return self.value
        return hashlib.sha256(f"{self.owner} {self.value}".encode()).hexdigest()

    @property
    def body_sha256(self) -> str:
        """Digest by which a repeated body is recognised."""
        return hashlib.sha256(self.body).hexdigest()


class Store:
    """The jobs; `listener` receives each event after its commit, in their order."""

    def __init__(self, database: Database, listener: Listener) -> None:
        self._database, self._listener = database, listener

    def create(
        self, new: Job, key: IdempotencyKey | None = None, plan: Json | None = None
    ) -> tuple[Job, bool]:
        """Add a job; True if it is new, False if the key has made it before.

        plan : as `encode_commanded_json` makes it; the `request` of a job that plans

        Raises KeyReused, CellBusy.
        """
        identified = replace(new, id=make_id())

        def change(connection: Connection) -> tuple[Job, JobEvent | None]:
            added = _find_first_event(connection, identified.id)
            if added is not None:  # the word that it was committed got lost
                return _read_job(connection, identified.id), added
            earlier = _find_job_by_key(connection, key) if key else None
            if earlier is not None:
                return earlier, None
            if new.kind.measures:
                _refuse_second_measurement(connection, new.machine)
            job = _insert_job(connection, identified, plan)
            if key is not None:
                _insert_key(connection, key, job.id)
            return job, _insert_event(connection, job)

        job, event = self._database.write(change, self._publish)
        return job, event is not None

    def add_recovered(self, job: Job, plan: Json | None) -> bool:
        """Add a job that has ended as it is; False where there is one of its name."""

        def change(connection: Connection) -> bool:
            known = select(jobs.c.seq).where(jobs.c.id == job.id)
            if connection.execute(known).first() is not None:
                return False
            connection.execute(insert(jobs).values(**_encode_columns(job), plan=plan))
            return True

        return self._database.write(change)

    def find_analyses_of_one(self) -> dict[str, str]:
        """Return, by Run, the newest job with a result of that Run alone."""
        query = select(jobs.c.run_id, jobs.c.id, jobs.c.kind, jobs.c.further_run_ids)
        query = query.where(jobs.c.state == str(State.SUCCEEDED))
        found: dict[str, str] = {}
        with self._database.read() as connection:
            for row in connection.execute(query.order_by(jobs.c.seq)).mappings():
                is_alone = row["run_id"] and not row["further_run_ids"]
                if is_alone and JobKind(row["kind"]).analyses:
                    found[row["run_id"]] = row["id"]
        return found

    def find_by_key(self, key: IdempotencyKey) -> Job | None:
        """Return the job that a key has made, if any. Raises KeyReused."""
        with self._database.read() as connection:
            return _find_job_by_key(connection, key)

    def get(self, job_id: str) -> Job:
        """Return a job. Raises NotFound."""
        with self._database.read() as connection:
            return _read_job(connection, job_id)

    def read_plan(self, job_id: str) -> Json | None:
        """Return what a job commands or has planned, None if nothing or not yet."""
        content = self._read_plan_content(job_id)
        return content if "kind" in content else None

    def read_plan_request(self, job_id: str) -> Json:
        """Return what is asked of the plan of a job, nothing if nothing is."""
        return self._read_plan_content(job_id).get("request") or {}

    def keep_plan(self, job_id: str, plan: Json) -> None:
        """Keep what has been planned beside what was asked."""
        self._update(job_id, plan={"request": self.read_plan_request(job_id), **plan})

    def list_page(
        self,
        limit: int,
        *,
        before_seq: int | None = None,
        states: Sequence[State] = (),
        kinds: Sequence[JobKind] = (),
        machine: str | None = None,
        name: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> list[Job]:
        """Return jobs, the newest first, older than `before_seq`.

        name : a part of it, in small letters or capitals
        since, until : created not before the one and before the other, with a zone
        """
        query = _JOBS.order_by(jobs.c.seq.desc()).limit(limit)
        if before_seq is not None:
            query = query.where(jobs.c.seq < before_seq)
        if states:
            query = query.where(jobs.c.state.in_([str(state) for state in states]))
        if kinds:
            query = query.where(jobs.c.kind.in_([str(kind) for kind in kinds]))
        if machine is not None:
            query = query.where(jobs.c.machine == machine)
        if name is not None:
            query = query.where(jobs.c.name.icontains(name, autoescape=True))
        if since is not None:
            query = query.where(jobs.c.created >= format_utc(since))
        if until is not None:
            query = query.where(jobs.c.created < format_utc(until))
        return self._read(query)

    def count_by_state(self) -> dict[tuple[JobKind, State], int]:
        """Return how many jobs of each kind are in each state, of all times."""
        query = select(jobs.c.kind, jobs.c.state, func.count())
        with self._database.read() as connection:
            rows = connection.execute(query.group_by(jobs.c.kind, jobs.c.state)).all()
        return {(JobKind(kind), State(state)): n for kind, state, n in rows}

    def list_unfinished(self) -> list[Job]:
        """Return the jobs that have not ended, the oldest first."""
        return self._read(_UNFINISHED)

    def list_with_result(self, machine: str) -> list[Job]:
        """Return the jobs of a machine whose error tables stand, the oldest first."""
        own = (jobs.c.machine == machine) & (jobs.c.state == str(State.SUCCEEDED))
        found = self._read(_JOBS.where(own).order_by(jobs.c.seq))
        return [job for job in found if job.has_result]

    def list_machines(self) -> list[str]:
        """Return the machines that jobs are about."""
        query = select(jobs.c.machine).where(jobs.c.machine.is_not(None)).distinct()
        with self._database.read() as connection:
            return sorted(str(one) for one in connection.execute(query).scalars())

    def find_newest_created(self) -> datetime | None:
        """Return when the newest job was created, None without any."""
        with self._database.read() as connection:
            newest = connection.execute(select(func.max(jobs.c.created))).scalar()
        return None if newest is None else datetime.fromisoformat(newest)

    def list_without_run(self) -> list[Job]:
        """Return the measurements that have ended and name no Run, but have one."""
        has_run = exists().where(runs.c.id == jobs.c.id)
        measures = jobs.c.kind.like("measure-%") & jobs.c.run_id.is_(None)
        ended = jobs.c.state.not_in(_OPEN)
        return self._read(_JOBS.where(measures & ended & has_run).order_by(jobs.c.seq))

    def change(
        self, job_id: str, change: Callable[[Job], Job], *, version: int | None = None
    ) -> Job:
        """Replace a job by `change(job)`, stamped; the same object changes nothing.

        Raises StaleVersion if `version` is given and not the newest, IllegalTransition.
        """
        written: list[tuple[Job, JobEvent]] = []

        def apply(connection: Connection) -> tuple[Job, JobEvent | None]:
            before = _read_job(connection, job_id)
            for after, event in written:
                if (before.version, before.state) == (after.version, after.state):
                    return before, event  # the word that it was committed got lost
            if version is not None:
                require_version(before, version)
            after = change(before)
            if after is before:
                return before, None
            if after.state is not before.state:
                check_transition(before.state, after.state)
                if before.is_final and after.kind.measures:
                    _refuse_second_measurement(connection, after.machine)
                _refuse_to_measure_again(after)
            after = _stamp_times(before, replace(after, version=before.version + 1))
            _update_job(connection, before, after)
            written.append((after, _insert_event(connection, after)))
            return written[-1]

        return self._database.write(apply, self._publish)[0]

    def rename(self, job_id: str, name: str | None, note: str | None) -> Job:
        """Change name and note of a job, without a new version; None leaves one.

        Raises NotFound.
        """
        given = {"name": name, "note": note}
        values = {column: text for column, text in given.items() if text is not None}
        written: list[JobEvent] = []

        def change(connection: Connection) -> tuple[Job, JobEvent | None]:
            before = _read_job(connection, job_id)
            after = replace(before, **values)
            if after == before:  # the word that it was committed may have got lost
                return before, written[-1] if written else None
            query = update(jobs).where(jobs.c.id == job_id)
            connection.execute(query.values(**values))
            written.append(_insert_event(connection, after))
            return after, written[-1]

        return self._database.write(change, self._publish)[0]

    def keep_progress(
        self, job_id: str, stage: Stage, progress: Progress, health: Health
    ) -> None:
        """Keep how far a job is, without a new version."""
        done = {"progress": asdict(progress), "health": asdict(health)}
        self._update(job_id, stage=str(stage), **done)

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
        last = self.read_last_event_id()

        def change(connection: Connection) -> None:
            connection.execute(delete(events).where(events.c.id <= last - keep_events))
            old = idempotency_keys.c.created_s < _find_oldest_s()
            connection.execute(delete(idempotency_keys).where(old))

        self._database.write(change)

    def _read(self, query: Select[Any]) -> list[Job]:
        with self._database.read() as connection:
            return _select_jobs(connection, query)

    def _update(self, job_id: str, **values: Any) -> None:
        query = update(jobs).where(jobs.c.id == job_id).values(**values)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def _read_plan_content(self, job_id: str) -> Json:
        query = select(jobs.c.plan).where(jobs.c.id == job_id)
        with self._database.read() as connection:
            return connection.execute(query).scalar() or {}

    def _publish(self, outcome: tuple[Job, JobEvent | None]) -> None:
        event = outcome[1]
        if event is not None:
            self._listener(event)


def _refuse_to_measure_again(job: Job) -> None:
    if job.kind.measures and job.state is State.QUEUED:
        raise IllegalTransition(f"job {job.id} measures; it is not begun again")


def _stamp_times(before: Job, after: Job) -> Job:
    if after.started is None and after.state is State.RUNNING:
        return replace(after, started=format_utc_now())
    is_end = after.is_final and not before.is_final
    return replace(after, ended=format_utc_now()) if is_end else after


def _select_jobs(connection: Connection, query: Select[Any]) -> list[Job]:
    return [decode_job({**row}) for row in connection.execute(query).mappings()]


def require_version(job: Job, version: int) -> None:
    """Raise StaleVersion if somebody has changed the job since that version."""
    if job.version != version:
        raise StaleVersion(version, job.version, job.state)


def _read_job(connection: Connection, job_id: str) -> Job:
    for job in _select_jobs(connection, _JOBS.where(jobs.c.id == job_id)):
        return job
    raise NotFound(f"there is no job {job_id}")


def _refuse_second_measurement(connection: Connection, machine: str | None) -> None:
    for job in _select_jobs(connection, _UNFINISHED):
        if job.kind.measures and job.machine == machine:
            raise CellBusy(job.id, job.state)


def _insert_job(connection: Connection, new: Job, plan: Json | None) -> Job:
    goal = State.READY if new.kind.measures else State.SUCCEEDED
    now = format_utc_now()
    job = replace(new, desired_state=str(goal), created=now)
    query = insert(jobs).values(**_encode_columns(job), plan=plan)
    done = connection.execute(query)
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return replace(job, seq=done.inserted_primary_key[0])


def _update_job(connection: Connection, before: Job, after: Job) -> None:
    """Write a job over its version before. Raises StaleVersion."""
    same = (jobs.c.id == before.id) & (jobs.c.version == before.version)
    columns = _encode_columns(after)
    for given_by_people in ("name", "note"):  # changed without a new version
        del columns[given_by_people]
    query = update(jobs).where(same).values(**columns)
    if connection.execute(query).rowcount != 1:
        now = _read_job(connection, before.id)
        raise StaleVersion(before.version, now.version, now.state)


def _encode_columns(job: Job) -> dict[str, Any]:
    content = encode_job(job)
    del content["seq"]
    return content


def _insert_event(connection: Connection, job: Job) -> JobEvent:
    body = encode_job(job)
    row = {"job_id": job.id, "type": "job", "body": body, "created": format_utc_now()}
    done = connection.execute(insert(events).values(**row))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return JobEvent("job", job.id, body, done.inserted_primary_key[0])


def _find_first_event(connection: Connection, job_id: str) -> JobEvent | None:
    """Return the event of a job that was added, None where there is no such job."""
    query = select(events).where(events.c.job_id == job_id).order_by(events.c.id)
    row = connection.execute(query.limit(1)).mappings().first()
    if row is None:
        return None
    return JobEvent(row["type"], job_id, row["body"], row["id"])


def _find_job_by_key(connection: Connection, key: IdempotencyKey) -> Job | None:
    is_own = idempotency_keys.c.key == key.kept
    is_young = idempotency_keys.c.created_s >= _find_oldest_s()
    query = select(idempotency_keys).where(is_own & is_young)
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    if row["body_sha256"] != key.body_sha256:
        raise KeyReused(
            f"Idempotency-Key {key.value!r} has made job {row['job_id']} from another "
            "body; use a new key for a new job"
        )
    return _read_job(connection, row["job_id"])


def _insert_key(connection: Connection, key: IdempotencyKey, job_id: str) -> None:
    of_before = idempotency_keys.c.key == key.kept
    connection.execute(delete(idempotency_keys).where(of_before))
    row = {"key": key.kept, "body_sha256": key.body_sha256, "job_id": job_id}
    query = insert(idempotency_keys).values(**row, created_s=int(time.time()))
    connection.execute(query)


def _find_oldest_s() -> int:
    """Return since when a key counts, in seconds of the epoch."""
    return int(time.time()) - KEEP_KEYS_S
