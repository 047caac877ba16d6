from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace

import pytest

from truepath.catalogue import job as job_records
from truepath.catalogue.errors import CellBusy, KeyReused, StaleVersion
from truepath.catalogue.job import Failure, Health, Job, JobKind, Progress, Stage
from truepath.catalogue.schema import idempotency_keys
from truepath.catalogue.store import KEEP_KEYS_S, IdempotencyKey, Store
from truepath.catalogue.transitions import State
from truepath.errors import IllegalTransition, NotFound
from truepath_drivers import host_clock

pytestmark = pytest.mark.database
ANALYSE = Job(JobKind.ANALYSE)
MEASURE = Job(JobKind.MEASURE_OTF)
PLAN = {"kind": "path", "axes": ["X"]}


def to(state):
    return lambda job: replace(job, state=state)


def test_a_new_job_is_queued_at_version_one_and_keeps_its_plan(store):
    assert (store.read_last_event_id(), store.read_events_after(0)) == (0, [])
    job, is_new = store.create(ANALYSE)
    assert is_new
    assert (job.state, job.version, job.desired_state) == ("queued", 1, "succeeded")
    assert store.get(job.id) == job
    job, _ = store.create(MEASURE, plan=PLAN)
    assert store.read_plan(job.id) == PLAN
    assert store.get(job.id).desired_state == "ready"
    with pytest.raises(NotFound, match="no job nowhere"):
        store.get("nowhere")
    assert store.read_plan("nowhere") is None


def test_a_second_measuring_job_is_refused_while_the_first_lasts(store):
    first, _ = store.create(MEASURE)
    with pytest.raises(CellBusy, match=first.id):
        store.create(MEASURE)
    store.create(ANALYSE)
    store.change(first.id, to(State.FAILED))
    store.create(MEASURE)


def test_each_change_counts_the_version_and_keeps_an_event(store, told, database):
    job, _ = store.create(ANALYSE)
    assert store.change(job.id, lambda job: job).version == 1, "nothing has changed"
    with pytest.raises(IllegalTransition, match="queued cannot become paused"):
        store.change(job.id, to(State.PAUSED))
    meddle = {"state": State.RUNNING, "version": 7}
    job = store.change(job.id, lambda job: replace(job, **meddle), version=1)
    assert job.version == 2, "whatever a change writes there"
    assert job.started is not None
    assert job.ended is None
    stale = r"version 1 .* not the current one, 2"
    with pytest.raises(StaleVersion, match=stale) as at:
        store.change(job.id, to(State.FAILED), version=1)
    assert at.value.current == 2
    failure = Failure("BundleError", "tracker.csv, row 7: NaN", "c", "a")
    ended = {"state": State.FAILED, "failure": failure}
    job = store.change(job.id, lambda job: replace(job, **ended))
    assert job.ended is not None
    kept = store.read_events_after(0)
    assert kept == told
    assert [event.body["state"] for event in kept] == ["queued", "running", "failed"]
    assert [event.body["version"] for event in kept] == [1, 2, 3]
    assert job_records.decode_job(kept[-1].body) == replace(job, seq=job.seq)
    assert job_records.decode_job(job_records.encode_job(job)) == job
    database.engine.dispose()
    again = Store(database, told.append).get(job.id)
    assert (again, again.failure) == (job, failure)


@pytest.mark.fault_row(33)
def test_of_many_writers_with_one_version_one_wins(store, measured):
    job, _ = store.create(ANALYSE)

    def write(_):
        with suppress(StaleVersion):
            return store.change(job.id, to(State.RUNNING), version=1)

    with ThreadPoolExecutor(8) as pool:
        outcomes = list(pool.map(write, range(8)))
    assert len([o for o in outcomes if o is not None]) == 1
    assert store.get(job.id).version == 2
    measured(f"1 of {len(outcomes)} writers with one version wins")


@pytest.fixture
def commit_twice(store, monkeypatch):
    """A server that restarts may commit and lose its answer; the write is repeated."""
    commit = store._database._commit

    def commit_twice(change, deadline):
        commit(change, deadline)
        return commit(change, deadline)

    return lambda: monkeypatch.setattr(store._database, "_commit", commit_twice)


@pytest.mark.fault_row(33)
@pytest.mark.fault_row(37)
@pytest.mark.parametrize("new", [ANALYSE, MEASURE], ids=lambda job: str(job.kind))
def test_a_job_whose_commit_is_not_confirmed_is_made_once(store, commit_twice, new):
    commit_twice()
    job, is_new = store.create(new)
    assert is_new
    assert [each.id for each in store.list_page(9)] == [job.id]
    assert len(store.read_events_after(0)) == 1


@pytest.mark.fault_row(33)
@pytest.mark.fault_row(37)
@pytest.mark.parametrize("version", [1, None])
def test_an_unconfirmed_change_is_made_once(store, commit_twice, told, version):
    job, _ = store.create(ANALYSE)
    commit_twice()
    changed = store.change(job.id, to(State.RUNNING), version=version)
    assert (changed.version, changed.state) == (2, State.RUNNING)
    assert store.get(job.id) == changed
    assert [event.body["version"] for event in told] == [1, 2]
    assert [event.id for event in told] == [e.id for e in store.read_events_after(0)]
    with pytest.raises(StaleVersion):
        store.change(job.id, to(State.SUCCEEDED), version=1)
    assert store.rename(job.id, "As found", None).name == "As found"
    assert [event.body["name"] for event in told] == ["", "", "As found"]
    assert [event.id for event in told] == [e.id for e in store.read_events_after(0)]


def test_a_key_with_another_body_is_refused_and_a_refused_job_leaves_none(store):
    store.create(MEASURE, IdempotencyKey("k-1", b"one"))
    with pytest.raises(KeyReused, match="'k-1' has made job"):
        store.create(ANALYSE, IdempotencyKey("k-1", b"two"))
    with pytest.raises(KeyReused):
        store.find_by_key(IdempotencyKey("k-1", b"two"))
    key = IdempotencyKey("k-2", b"body")
    with pytest.raises(CellBusy):
        store.create(MEASURE, key)
    assert store.find_by_key(key) is None


def let_keys_be(age_s, database):
    query = idempotency_keys.update().values(created_s=int(host_clock.wall_s()) - age_s)
    database.write(lambda c: c.execute(query).rowcount)


@pytest.mark.fault_row(33)
def test_a_key_makes_one_job_of_one_user_on_one_day(store, database):
    keys = [IdempotencyKey("k-1", b"body", owner) for owner in ("anna", "ben", None)]
    jobs = [store.create(ANALYSE, key)[0] for key in keys]
    assert len({job.id for job in jobs}) == 3
    assert [store.create(ANALYSE, key) for key in keys] == [(j, False) for j in jobs]
    assert [store.find_by_key(key) for key in keys] == jobs
    let_keys_be(25 * 3600, database)
    assert store.find_by_key(keys[0]) is None
    again, is_new = store.create(ANALYSE, keys[0])
    assert is_new
    assert again.id != jobs[0].id
    assert store.create(ANALYSE, keys[0]) == (again, False)


def test_old_keys_and_events_are_forgotten(store, database):
    job, _ = store.create(ANALYSE, IdempotencyKey("old", b""))
    let_keys_be(KEEP_KEYS_S + 5, database)
    store.create(ANALYSE, IdempotencyKey("young", b""))
    for _ in range(3):
        store.change(job.id, lambda job: replace(job, perpendicular_only=True))
    store.prune(keep_events=2)
    assert store.find_by_key(IdempotencyKey("old", b"")) is None
    assert store.find_by_key(IdempotencyKey("young", b"")) is not None
    assert len(store.read_events_after(0)) == 2


def test_progress_is_kept_without_a_new_version(store, told):
    job, _ = store.create(MEASURE)
    progress = Progress(3, 10, "lines", 12.5, 4.0, (1.0, 2.0, 3.0))
    store.store_progress(job.id, Stage.MEASURING, progress, Health(1000, 2, 1))
    kept = store.get(job.id)
    assert (kept.version, kept.stage) == (1, "measuring")
    assert kept.progress == progress
    assert kept.health == Health(1000, 2, 1)
    assert len(told) == 1


def test_events_can_be_caught_up_on_by_job(store):
    one, other = store.create(ANALYSE)[0], store.create(ANALYSE)[0]
    store.change(one.id, to(State.RUNNING))
    mine = store.read_events_after(0, job_id=one.id)
    assert [event.body["state"] for event in mine] == ["queued", "running"]
    assert store.read_events_after(mine[0].id, job_id=one.id) == mine[1:]
    assert [e.job_id for e in store.read_events_after(0)] == [one.id, other.id, one.id]
    assert store.read_last_event_id() == mine[-1].id


def test_identifiers_differ_and_rise_in_the_order_they_are_told(
    store, told, monkeypatch
):
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: store.create(ANALYSE), range(8)))
    ids = [event.id for event in told]
    assert (ids, len(set(ids))) == (sorted(ids), 8)
    stamps = iter([1_000_000, 2_000_000, 3_000_000])
    with monkeypatch.context() as patch:
        patch.setattr(host_clock, "wall_ns", lambda: next(stamps))
        ids = [job_records.make_id() for _ in range(3)]
    assert ids == sorted(ids)
    assert len({job_records.make_id() for _ in range(1000)}) == 1000
    assert job_records.make_id()[14] == "7"
