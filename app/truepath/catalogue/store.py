"""Jobs, their events and their idempotency keys in the catalogue.

Every change of state is compare-and-set on `version`, and its event is in the same
transaction. Progress is written without a new version: it must not make the version
that an operator has read stale.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from typing import Any

from sqlalchemy import (
    Connection,
    RowMapping,
    Select,
    delete,
    exists,
    func,
    insert,
    select,
    update,
)

from truepath.catalogue.database import Database
from truepath.catalogue.errors import (
    CellBusy,
    KeyReused,
    StaleVersion,
    StorageUnavailable,
)
from truepath.catalogue.job import (
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
from truepath.catalogue.job_changes import (
    reject_to_measure_again,
    require_version,
    stamp_times,
)
from truepath.catalogue.schema import events, idempotency_keys, jobs, runs
from truepath.catalogue.transitions import FINAL, State, check_transition
from truepath.errors import NotFound
from truepath_drivers import host_clock

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


KEEP_KEYS_S = 24 * 3600


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An Idempotency-Key, the body it came with, and its owner.

    owner : name of the user; None where there is no login
    """

    value: str
    body: bytes
    owner: str | None = None

    @property
    def kept(self) -> str:
        """The stored form, separate by owner: two users may choose the same key."""
        if self.owner is None:
            return self.value
        return hashlib.sha256(f"{self.owner} {self.value}".encode()).hexdigest()

    @property
    def body_sha256(self) -> str:
        """Digest by which a repeated body is recognised."""
        return hashlib.sha256(self.body).hexdigest()


def find_job_by_key(connection: Connection, key: IdempotencyKey) -> Job | None:
    """None if the key has made no job in 24 h. Raises KeyReused."""
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
    return read_job(connection, row["job_id"])


def insert_key(connection: Connection, key: IdempotencyKey, job_id: str) -> None:
    """Record which job a key has made."""
    of_before = idempotency_keys.c.key == key.kept
    connection.execute(delete(idempotency_keys).where(of_before))
    row = {"key": key.kept, "body_sha256": key.body_sha256, "job_id": job_id}
    query = insert(idempotency_keys).values(**row, created_s=int(host_clock.wall_s()))
    connection.execute(query)


def _find_oldest_s() -> int:
    return int(host_clock.wall_s()) - KEEP_KEYS_S


KEEP_EVENTS = 20_000
_MOST_EVENTS = 500  # that are read at once
Listener = Callable[[JobEvent], None]


class Store:
    """The jobs; `listener` receives each event after its commit, in their order.

    A job that has ended counts as ended in every read, even while the catalogue cannot
    store that and still has it as running.
    """

    def __init__(self, database: Database, listener: Listener) -> None:
        self._database, self._listener = database, listener
        self._ended: dict[str, Job] = {}

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
                return read_job(connection, identified.id), added
            earlier = find_job_by_key(connection, key) if key else None
            if earlier is not None:
                return earlier, None
            if new.kind.measures:
                reject_second_measurement(connection, new.machine)
            job = insert_job(connection, identified, plan)
            if key is not None:
                insert_key(connection, key, job.id)
            return job, _insert_event(connection, job)

        job, event = self._database.write(change, self._publish)
        return job, event is not None

    def add_recovered(self, job: Job, plan: Json | None) -> bool:
        """Add a job that has ended, unchanged; False where its identifier exists."""

        def change(connection: Connection) -> bool:
            known = select(jobs.c.seq).where(jobs.c.id == job.id)
            if connection.execute(known).first() is not None:
                return False
            connection.execute(insert(jobs).values(**encode_columns(job), plan=plan))
            return True

        return self._database.write(change)

    def find_analyses_of_one(self) -> dict[str, str]:
        """By Run, the newest job with a result of that Run alone."""
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
        """None if the key has made no job in 24 h. Raises KeyReused."""
        with self._database.read() as connection:
            return find_job_by_key(connection, key)

    def get(self, job_id: str) -> Job:
        """Raises NotFound."""
        ended = self._ended.copy()  # before reading: meanwhile it may be stored
        with self._database.read() as connection:
            return _see(read_job(connection, job_id), ended)

    def apply_pending_end(self, job: Job) -> Job:
        """A stored job, but ended if it has ended since."""
        return _see(job, self._ended)

    def mark_ended(self, before: Job, ended: Job) -> Job:
        """Show a job as ended until `change` has stored it; the first call counts."""
        return self._ended.setdefault(before.id, stamp_times(before, ended))

    def discard_pending_end(self, job_id: str) -> None:
        """Leave an end that could not be stored to the next start of the service."""
        self._ended.pop(job_id, None)

    def read_plan(self, job_id: str) -> Json | None:
        """Commanded rows of a job, or its finished plan; None if there are none yet."""
        content = self._read_plan_content(job_id)
        return content if "kind" in content else None

    def read_plan_request(self, job_id: str) -> Json:
        """The request of a job that plans; empty for others."""
        return self._read_plan_content(job_id).get("request") or {}

    def store_plan(self, job_id: str, plan: Json) -> None:
        """Store a finished plan together with its request."""
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
        """Jobs, the newest first, older than `before_seq`.

        name : a part of it, in small letters or capitals
        since, until : created not before the one and before the other, with a zone
        """
        query = JOBS.order_by(jobs.c.seq.desc()).limit(limit)
        if before_seq is not None:
            query = query.where(jobs.c.seq < before_seq)
        if states:
            stored = jobs.c.state.in_([str(state) for state in states])
            query = query.where(stored | jobs.c.id.in_(list(self._ended)))
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
        found = self._read(query)
        return [job for job in found if not states or job.state in states]

    def count_by_state(self) -> dict[tuple[JobKind, State], int]:
        """Number of jobs by kind and state, of all times."""
        query = select(jobs.c.kind, jobs.c.state, func.count())
        ended = self._ended.copy()
        with self._database.read() as connection:
            rows = connection.execute(query.group_by(jobs.c.kind, jobs.c.state)).all()
            stored = [read_job(connection, job_id) for job_id in ended]
        counts = {(JobKind(kind), State(state)): n for kind, state, n in rows}
        for job in stored:
            counts[job.kind, job.state] -= 1
            seen = job.kind, _see(job, ended).state
            counts[seen] = counts.get(seen, 0) + 1
        return counts

    def list_unfinished(self) -> list[Job]:
        """Jobs that have not ended, the oldest first."""
        return [job for job in self._read(UNFINISHED) if not job.is_final]

    def list_with_result(self, machine: str) -> list[Job]:
        """Jobs of a machine with error tables, the oldest first."""
        own = (jobs.c.machine == machine) & (jobs.c.state == str(State.SUCCEEDED))
        found = self._read(JOBS.where(own).order_by(jobs.c.seq))
        return [job for job in found if job.answer == "result"]

    def list_machines(self) -> list[str]:
        """Machines that jobs are about, sorted."""
        query = select(jobs.c.machine).where(jobs.c.machine.is_not(None)).distinct()
        with self._database.read() as connection:
            return sorted(str(one) for one in connection.execute(query).scalars())

    def find_newest_created(self) -> datetime | None:
        """None without any job."""
        with self._database.read() as connection:
            newest = connection.execute(select(func.max(jobs.c.created))).scalar()
        return None if newest is None else datetime.fromisoformat(newest)

    def list_without_run(self) -> list[Job]:
        """Ended measurements that name no Run, although there is one."""
        return self._read(MEASURED_WITHOUT_RUN)

    def change(
        self,
        job_id: str,
        change: Callable[[Job], Job],
        *,
        version: int | None = None,
        ends: bool = False,
    ) -> Job:
        """Replace a job by `change(job)`, stamped; the same object changes nothing.

        ends : whether this stores the end that is shown already; nothing comes before

        Raises StaleVersion if `version` is given and not the newest, IllegalTransition.
        """
        written: list[tuple[Job, JobEvent]] = []
        unstored = None if ends else self._ended.get(job_id)
        if unstored is not None:  # seen as ended without waiting for the catalogue
            if change(unstored) is unstored:
                return unstored
            raise StorageUnavailable(f"the end of job {job_id} is not stored yet")

        def apply(connection: Connection) -> tuple[Job, JobEvent | None]:
            before = read_job(connection, job_id)
            for after, event in written:
                if (before.version, before.state) == (after.version, after.state):
                    return before, event  # the word that it was committed got lost
            if version is not None:
                require_version(before, version)
            seen = before if ends else self.apply_pending_end(before)
            after = change(seen)
            if after is seen:
                return seen, None
            if seen is not before:
                raise StorageUnavailable(f"the end of job {job_id} is not stored yet")
            if after.state is not before.state:
                check_transition(before.state, after.state)
                if before.is_final and after.kind.measures:
                    reject_second_measurement(connection, after.machine)
                reject_to_measure_again(after)
            after = stamp_times(before, replace(after, version=before.version + 1))
            update_job(connection, before, after)
            written.append((after, _insert_event(connection, after)))
            return written[-1]

        job = self._database.write(apply, self._publish)[0]
        if ends and job.is_final:
            self.discard_pending_end(job_id)
        return job

    def rename(self, job_id: str, name: str | None, note: str | None) -> Job:
        """Change name and note of a job, without a new version; None leaves one.

        Raises NotFound.
        """
        values = {c: t for c, t in (("name", name), ("note", note)) if t is not None}
        written: list[JobEvent] = []

        def change(connection: Connection) -> tuple[Job, JobEvent | None]:
            before = read_job(connection, job_id)
            after = replace(before, **values)
            if after == before:  # the word that it was committed may have got lost
                return before, written[-1] if written else None
            connection.execute(update(jobs).where(jobs.c.id == job_id).values(**values))
            written.append(_insert_event(connection, after))
            return after, written[-1]

        return self._database.write(change, self._publish)[0]

    def store_progress(
        self, job_id: str, stage: Stage, progress: Progress, health: Health
    ) -> None:
        """Store the progress of a job, without a new version."""
        done = {"progress": asdict(progress), "health": asdict(health)}
        self._update(job_id, stage=str(stage), **done)

    def read_events_after(
        self, event_id: int, *, job_id: str | None = None
    ) -> list[JobEvent]:
        """Stored events in order, at most 500 after `event_id`.

        job_id : of the one job whose events are requested; None for all
        """
        query = select(events).where(events.c.id > event_id).order_by(events.c.id)
        if job_id is not None:
            query = query.where(events.c.job_id == job_id)
        with self._database.read() as connection:
            kept = connection.execute(query.limit(_MOST_EVENTS)).mappings()
            return [_decode_event(row) for row in kept]

    def read_last_event_id(self) -> int:
        """0 if there is no event."""
        with self._database.read() as connection:
            return connection.execute(select(func.max(events.c.id))).scalar() or 0

    def prune(self, *, keep_events: int = KEEP_EVENTS) -> None:
        """Delete the oldest events, and expired idempotency keys."""
        last = self.read_last_event_id()

        def change(connection: Connection) -> None:
            connection.execute(delete(events).where(events.c.id <= last - keep_events))
            old = idempotency_keys.c.created_s < _find_oldest_s()
            connection.execute(delete(idempotency_keys).where(old))

        self._database.write(change)

    def _read(self, query: Select[Any]) -> list[Job]:
        ended = self._ended.copy()
        with self._database.read() as connection:
            return [_see(job, ended) for job in select_jobs(connection, query)]

    def _update(self, job_id: str, **values: Any) -> None:
        query = update(jobs).where(jobs.c.id == job_id).values(**values)
        self._database.write(lambda connection: connection.execute(query).rowcount)

    def _read_plan_content(self, job_id: str) -> Json:
        query = select(jobs.c.plan).where(jobs.c.id == job_id)
        with self._database.read() as connection:
            return connection.execute(query).scalar() or {}

    def _publish(self, outcome: tuple[Job, JobEvent | None]) -> None:
        if (event := outcome[1]) is not None:
            self._listener(event)


def _see(job: Job, ended: Mapping[str, Job]) -> Job:
    return job if job.is_final else ended.get(job.id, job)


def _insert_event(connection: Connection, job: Job) -> JobEvent:
    body = encode_job(job)
    row = {"job_id": job.id, "type": "job", "body": body, "created": format_utc_now()}
    done = connection.execute(insert(events).values(**row))
    assert done.inserted_primary_key is not None  # noqa: S101 (one row was inserted)
    return JobEvent("job", job.id, body, done.inserted_primary_key[0])


def _find_first_event(connection: Connection, job_id: str) -> JobEvent | None:
    query = select(events).where(events.c.job_id == job_id).order_by(events.c.id)
    row = connection.execute(query.limit(1)).mappings().first()
    return None if row is None else _decode_event(row)


def _decode_event(row: RowMapping) -> JobEvent:
    return JobEvent(row["type"], row["job_id"], row["body"], row["id"])
