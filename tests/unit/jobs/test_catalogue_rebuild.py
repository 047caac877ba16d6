"""A catalogue made again from Runs and results on disk; what is kept of machines."""

import json
import shutil
import sqlite3
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from sqlalchemy import select

from job_builders import begin_run, make_samples, write_bundle_zip
from scripted_cell import ReaderHere
from truepath.answers.machine_history import Calibration
from truepath.catalogue import machine_registry as kept
from truepath.catalogue import schema
from truepath.catalogue.calibrations import sort_by_time
from truepath.catalogue.database import Database
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.machine_registry import describe_identity, find_machine
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import State
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.dispatch import catalogue_rebuild as rebuilding
from truepath.jobs.dispatch.catalogue_rebuild import rebuild_catalogue
from truepath.jobs.dispatch.deletion import Deletion
from truepath.measurement.run_file.run_file import Batch
from truepath_simulators.machine_file import load_machine

VERDICT = {"state": "usable", "reasons": []}


def open_catalogue(folder):
    return closing(Database(f"sqlite:///{folder / 'catalogue.sqlite'}"))


@pytest.fixture(scope="module")
def history(tmp_path_factory, empty_catalogue):
    folder = tmp_path_factory.mktemp("history")
    shutil.copyfile(empty_catalogue, folder / "catalogue.sqlite")
    with open_catalogue(folder) as database:
        machine = machine_from_json(load_machine("demo"))
        runs = RunCatalogue(database, folder / "runs", ReaderHere())
        store = Store(database, lambda _: None)

        def measure(run_id, job_id, name):
            recorder = begin_run(runs, machine, run_id, job_id, name)
            recorder.put_tracker(make_samples())
            recorder.close("finished")
            runs.add_measured(run_id)

        def end(job, **values):
            running = store.change(job.id, lambda j: replace(j, state=State.RUNNING))
            done = replace(running, state=State.SUCCEEDED, **values)
            store.change(job.id, lambda _: done)
            return job.id

        def write(job_id, name, **content):
            file = folder / "results" / job_id / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps({"verdict": VERDICT, **content}))

        measured, _ = store.create(Job(JobKind.MEASURE_OTF))
        measure(measured.id, measured.id, "mill monday")
        write(measured.id, "result.json", runs=[{"name": "mill monday"}])
        end(measured, run_id=measured.id)

        uploaded = write_bundle_zip(machine, folder / "sent.zip")
        sent = runs.add_uploaded(uploaded, "from the shop floor")

        analysed, _ = store.create(Job(JobKind.ANALYSE))
        both = [{"name": sent.id}, {"name": "mill monday"}, {"name": "mill monday"}]
        write(analysed.id, "result.json", runs=both)
        end(analysed, run_id=sent.id, further_run_ids=(measured.id,))

        found, _ = store.create(Job(JobKind.DISCOVER))
        write(found.id, "discovery.json", runs=[{"name": "mill monday"}])
        write(found.id, "model.json")
        end(found, run_id=measured.id)

        broken, _ = store.create(Job(JobKind.MEASURE_OTF))
        for run_id, name in (
            (broken.id, "mill tuesday, station 1"),
            ("p1", "mill tuesday, known points, station 2"),
            ("s2", "mill tuesday, station 2"),
        ):
            measure(run_id, broken.id, name)
        store.change(broken.id, lambda j: replace(j, state=State.ABORTING))
    return folder


@pytest.fixture
def folder(history, tmp_path, monkeypatch):
    reader = "truepath.jobs.dispatch.catalogue_rebuild.RunReader"
    monkeypatch.setattr(reader, ReaderHere)
    return shutil.copytree(history, tmp_path, dirs_exist_ok=True)


def rebuild(folder):
    with open_catalogue(folder) as database:
        runs, results = folder / "runs", folder / "results"
        return rebuild_catalogue(database, runs, results), read_rows(database)


def read_rows(database):
    found = {}
    with database.read() as connection:
        for table in (schema.runs, schema.jobs):
            rows = connection.execute(select(table).order_by(table.c.id)).mappings()
            found[table.name] = [
                {k: v for k, v in row.items() if k not in ("seq", "version")}
                for row in rows
            ]
    return found


def spoil(folder):
    (folder / "catalogue.sqlite").write_bytes(b"garbage " * 99)


@pytest.mark.fault_row(37)
def test_jobs_runs_results_and_models_come_back(folder):
    with open_catalogue(folder) as database:
        before = read_rows(database)
    spoil(folder)
    recovered, after = rebuild(folder)
    assert (recovered.runs, recovered.jobs) == (5, 4)
    assert (recovered.results, recovered.models, recovered.unreadable) == (3, 1, {})
    assert recovered.aside is not None
    assert recovered.aside.read_bytes() == b"garbage " * 99
    for old, new in zip(before["runs"], after["runs"], strict=True):
        same = {k: v for k, v in new.items() if k not in ("name", "created")}
        assert same == {k: old[k] for k in same}
    kept = ("id", "kind", "run_id", "further_run_ids")
    for old, new in zip(before["jobs"][:3], after["jobs"][:3], strict=True):
        assert {k: new[k] for k in kept} == {k: old[k] for k in kept}
        assert (new["state"], new["verdict"]) == ("succeeded", "usable")
    assert after["jobs"][0]["plan"]["kind"] == "path"
    last = after["jobs"][-1]  # of two stations, and without a result
    assert (last["kind"], last["state"]) == ("measure-otf", "interrupted")
    assert (last["run_id"], last["further_run_ids"]) == (last["id"], ["s2"])
    assert "the catalogue that knew how it ended is lost" in last["failure"]["detail"]
    again, second = rebuild(folder)
    assert second == after
    assert (again.aside, again.runs, again.jobs) == (None, 0, 0)


def test_a_whole_catalogue_keeps_all_it_has_and_gets_what_it_lacks(folder):
    with open_catalogue(folder) as database:
        store = Store(database, lambda _: None)
        failed, _ = store.create(Job(JobKind.ANALYSE))
        store.change(failed.id, lambda job: replace(job, state=State.FAILED))
        before = read_rows(database)
        lost = schema.runs.delete().where(schema.runs.c.id == "s2")
        database.write(lambda c: c.execute(lost))
    recovered, after = rebuild(folder)
    assert (recovered.aside, recovered.runs, recovered.jobs) == (None, 1, 0)
    assert after["jobs"] == before["jobs"]


@contextmanager
def deletion(folder):
    with open_catalogue(folder) as database:
        runs = RunCatalogue(database, folder / "runs", ReaderHere())
        jobs = {row["kind"]: row["id"] for row in read_rows(database)["jobs"]}
        yield Deletion(database, runs, folder / "results"), runs, jobs


def ids_of(rows):
    return {table: [row["id"] for row in found] for table, found in rows.items()}


@pytest.mark.parametrize("damage", [lambda _: None, spoil])
def test_what_was_deleted_stays_deleted(folder, damage):
    """A job whose Run stays, a Run with what was made from it, files left behind."""
    with deletion(folder) as (deleting, runs, jobs):
        (sent,) = (r.id for r in runs.list_all() if r.origin == "uploaded")
        deleting.delete_job(jobs["discover"])
        deleting.delete_run(sent, with_results=True)
        measured = next(r.id for r in runs.list_all() if r.name == "mill monday")
        deleting.delete_job(measured)
    with open_catalogue(folder) as database:
        before = ids_of(read_rows(database))
    damage(folder)
    after = ids_of(rebuild(folder)[1])
    assert after == before
    assert measured in after["runs"]


def test_a_result_that_outlives_its_deletion_makes_no_job(folder, monkeypatch):
    """The rows are gone and the disk refuses to give the files up."""
    with deletion(folder) as (deleting, _, jobs), monkeypatch.context() as m:
        refused = Mock(side_effect=OSError)
        m.setattr("truepath.jobs.dispatch.deletion.shutil.rmtree", refused)
        deleting.delete_job(jobs["discover"])
    assert (folder / "results" / jobs["discover"] / "discovery.json").is_file()
    assert jobs["discover"] not in ids_of(rebuild(folder)[1])["jobs"]
    spoil(folder)
    assert jobs["discover"] not in ids_of(rebuild(folder)[1])["jobs"]


def test_what_cannot_be_read_is_named_and_kept(folder):
    spoil(folder)
    garbage = folder / "runs" / "odd.sqlite"
    garbage.write_bytes(b"no Run")
    (folder / "results" / "strange").mkdir()
    (folder / "results" / "strange" / "result.json").write_text('{"verdict": "cut')
    recovered, rows = rebuild(folder)
    assert set(recovered.unreadable) == {"run odd", "result strange"}
    assert garbage.read_bytes() == b"no Run"
    assert len(rows["runs"]) == 5


def test_a_catalogue_damaged_anew_is_the_same_and_none_overwritten(folder, monkeypatch):
    spoil(folder)
    recovered, first = rebuild(folder)
    spoil(folder)
    aside = recovered.aside
    assert aside is not None
    stamp = aside.name.split("-")[-1].removesuffix(".sqlite")
    clock = "truepath.jobs.dispatch.catalogue_rebuild.time.strftime"
    monkeypatch.setattr(clock, lambda *_: stamp)
    with pytest.raises(BadInput, match="exists already"):
        rebuild(folder)
    assert (folder / "catalogue.sqlite").read_bytes() == b"garbage " * 99
    aside.rename(folder / "older")
    assert rebuild(folder)[1] == first


def test_a_check_names_where_catalogue_and_disk_disagree_and_what_was_changed(folder):
    """One byte of one batch is another, and its CRC fits: only the digest tells."""

    def check(**asked):
        with open_catalogue(folder) as database:
            return rebuilding.check_against_disk(database, folder / "runs", **asked)

    assert check()["runs_without_row"] == []
    assert check(with_hashes=True)["changed_files"] == []
    file = folder / "runs" / "s2.sqlite"
    file.chmod(0o644)
    with closing(sqlite3.connect(file)) as connection, connection:
        named = "stream, seq0, n, mono_ns, wall_ns, payload"
        *head, payload = connection.execute(f"SELECT {named} FROM batch").fetchone()
        batch = Batch(*head, payload[:-1] + bytes([payload[-1] ^ 1]))
        connection.execute(
            "UPDATE batch SET payload = ?, crc32 = ? WHERE stream = ? AND seq0 = ?",
            (batch.payload, batch.crc32, batch.stream, batch.seq0),
        )
    assert check(with_hashes=False)["changed_files"] is None
    assert check(with_hashes=True)["changed_files"] == ["s2"]
    file.rename(file.with_name("s3.sqlite"))
    found = check()
    assert (found["jobs"], found["runs"]) == (4, 5)
    assert (found["runs_without_row"], found["rows_without_file"]) == (["s3"], ["s2"])


@pytest.fixture
def registry(database):
    found = kept.MachineRegistry(database)
    found.record_configuration("mill-3", kept.CATALOGUE, {"name": "mill"}, {})
    return found


@pytest.mark.database
def test_identities_of_earlier_versions_are_taken_over_once(registry, tmp_path):
    file = tmp_path / "identities.json"
    lathe = {"operator": "B"}
    mill = {"serial_number": "4711", "place": "Hall 3", "tracker_serial_number": "7"}
    earlier = {"machine_serial": "4711", "place": "Hall 3", "tracker_serial": "7"}
    content = {"schema": "identities/1", "machines": {"mill": earlier, "lathe": lathe}}
    file.write_text(json.dumps(content))
    registry.change("mill-3", place="Hall 4")
    kept.take_over_identities(tmp_path, registry)
    assert describe_identity(registry.get("mill-3")) == {**mill, "place": "Hall 4"}
    assert json.loads(file.read_text())["machines"] == {"lathe": lathe}
    registry.change("mill-3", serial_number="4712")
    registry.record_configuration("lathe", kept.CATALOGUE, {"name": "lathe"}, {})
    kept.take_over_identities(tmp_path, registry)
    assert registry.get("mill-3").serial_number == "4712"
    assert registry.get("lathe").stated == lathe
    assert not file.exists()
    kept.take_over_identities(tmp_path, registry)


@pytest.mark.database
def test_a_result_is_of_its_jobs_machine_or_of_the_one_of_its_name(registry):
    mine = find_machine(Job(JobKind.ANALYSE, machine="mill-3"), "other", registry)
    named = find_machine(Job(JobKind.ANALYSE), "mill", registry)
    assert mine == named == registry.get("mill-3")
    assert find_machine(Job(JobKind.ANALYSE), "press", registry) is None
    assert find_machine(Job(JobKind.ANALYSE, machine="gone"), "mill", registry) is None


@pytest.mark.database
def test_what_is_stated_of_a_machine_alone_is_kept_by_the_name_of_today(registry):
    registry.change("mill-3", stated={"tracker_serial": "7"})
    assert describe_identity(registry.get("mill-3")) == {"tracker_serial_number": "7"}
    now = {"tracker_serial_number": "8"}
    kept.store_identity(registry.get("mill-3"), now, registry)
    assert registry.get("mill-3").stated == now
    registry.change("mill-3", stated={})
    assert kept.store_identity(None, {"operator": "A"}, registry) == {"operator": "A"}
    record = registry.get("mill-3")
    now = {"operator": "A", "measured_on": "2026-11-24"}
    assert kept.store_identity(record, now, registry) == now
    assert describe_identity(registry.get("mill-3")) == {"operator": "A"}


def calibration(name, measured, *, is_time_stated=True):
    files = (name,), measured, 1, None, Path(name)
    return Calibration("mill", name, *files, is_time_stated)


def names(*found):
    return [one.job_id for one in sort_by_time(found)]


def test_what_was_recorded_here_stands_in_its_order_whatever_the_clock_said():
    first = calibration("first", "2026-03-01T00:00:00Z")
    wrong = calibration("wrong", "2099-01-01T00:00:00Z")
    newest = calibration("newest", "2026-05-01T00:00:00Z")
    back = calibration("back", "1970-01-01T00:00:00Z")
    assert names((wrong, 5), (newest, 7), (first, 3)) == ["first", "wrong", "newest"]
    assert names((back, 8), (newest, 7), (first, 3)) == ["first", "newest", "back"]
    # What was uploaded stands by its time.
    recorded = calibration("recorded", "2026-03-01T00:00:00Z")
    older = calibration("older", "2026-01-01T00:00:00Z")
    newer = calibration("newer", "2026-04-01T00:00:00Z")
    no_time = calibration("no time", "2026-09-01T00:00:00Z", is_time_stated=False)
    found = names((recorded, 1), (newer, None), (older, None), (no_time, None))
    assert found == ["no time", "older", "recorded", "newer"]
