"""A catalogue made again from Runs and results on disk."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from scripted_cell import DEVICES
from sqlalchemy import select

from truepath.catalogue import schema
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.runs import RunCatalogue
from truepath.catalogue.store.database import Database
from truepath.catalogue.store.store import Store
from truepath.catalogue.transitions import State
from truepath.errors import BadInput
from truepath.files.bundle.bundle import zip_bundle
from truepath.files.bundle.run import Run
from truepath.jobs.dispatch.catalogue_rebuild import (
    check_against_disk,
    rebuild_catalogue,
)
from truepath.jobs.dispatch.deletion import Deletion
from truepath.measurement.run_file.recorder import Recorder
from truepath.measurement.run_file.run_file import Batch, RunHeader
from truepath.motion.configurations import Configurations
from truepath.motion.paths.commanded_rows import command_rows
from truepath_drivers.interfaces.records import TrackerSamples

ROWS = (
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0},
    {"x_mm": 400.0, "y_mm": 300.0, "z_mm": 200.0, "feed_mm_min": 1000.0},
)
VERDICT = {"state": "usable", "reasons": []}


@pytest.fixture
def samples():
    n = np.arange(10)
    return TrackerSamples(n, n / 500.0, np.ones((10, 3)), np.zeros(10, np.int64))


@pytest.fixture
def folder(tmp_path, empty_catalogue, machine, samples, run_reader):
    """A data folder with a history; its catalogue may be spoiled."""
    shutil.copyfile(empty_catalogue, tmp_path / "catalogue.sqlite")
    database = Database(f"sqlite:///{tmp_path / 'catalogue.sqlite'}")
    runs = RunCatalogue(database, tmp_path / "runs", run_reader)
    store = Store(database, lambda _: None)

    def measure(run_id, job_id, name):
        path = command_rows(machine, ROWS, is_path=True)
        axes = machine.axis_names
        header = RunHeader(name, machine, path, 500.0, DEVICES, axes, job_id=job_id)
        recorder = Recorder(runs.name_run_file(run_id), header, reserve_bytes=0)
        recorder.put_tracker(samples)
        recorder.close("finished")
        runs.add_measured(run_id)

    def end(job, **values):
        running = store.change(job.id, lambda j: replace(j, state=State.RUNNING))
        done = replace(running, state=State.SUCCEEDED, **values)
        store.change(job.id, lambda _: done)
        return job.id

    def write(job_id, name, **content):
        (tmp_path / "results" / job_id).mkdir(parents=True, exist_ok=True)
        file = tmp_path / "results" / job_id / name
        file.write_text(json.dumps({"verdict": VERDICT, **content}))

    measured, _ = store.create(Job(JobKind.MEASURE_OTF))
    measure(measured.id, measured.id, "mill monday")
    write(measured.id, "result.json", runs=[{"name": "mill monday"}])
    end(measured, run_id=measured.id)

    uploaded = tmp_path / "sent.zip"
    points = Configurations(machine.axis_names, np.ones((1, 3)), np.array([1.0]))
    uploaded.write_bytes(zip_bundle(Run("b", machine, points, samples)))
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
    database.close()
    return tmp_path


def rebuild(folder):
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    try:
        runs, results = folder / "runs", folder / "results"
        return rebuild_catalogue(database, runs, results), read_rows(database)
    finally:
        database.close()


def read_rows(database):
    with database.read() as connection:
        return {
            table.name: [
                {k: v for k, v in row.items() if k not in ("seq", "version")}
                for row in connection.execute(select(table).order_by(table.c.id))
                .mappings()
                .all()
            ]
            for table in (schema.runs, schema.jobs)
        }


def spoil(folder):
    (folder / "catalogue.sqlite").write_bytes(b"garbage " * 99)


@pytest.mark.fault_row(37)
def test_jobs_runs_results_and_models_come_back(folder):
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    before = read_rows(database)
    database.close()
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


def test_a_measurement_without_a_result_comes_back_with_the_runs_of_its_stations(
    folder,
):
    spoil(folder)
    last = rebuild(folder)[1]["jobs"][-1]
    assert (last["kind"], last["state"]) == ("measure-otf", "interrupted")
    assert (last["run_id"], last["further_run_ids"]) == (last["id"], ["s2"])
    assert "the catalogue that knew how it ended is lost" in last["failure"]["detail"]


def test_rebuilding_twice_is_rebuilding_once(folder):
    spoil(folder)
    _, first = rebuild(folder)
    again, second = rebuild(folder)
    assert second == first
    assert (again.aside, again.runs, again.jobs) == (None, 0, 0)


def test_a_catalogue_that_is_damaged_anew_is_made_the_same_again(folder):
    spoil(folder)
    recovered, first = rebuild(folder)
    spoil(folder)
    assert recovered.aside is not None
    recovered.aside.rename(folder / "older")
    assert rebuild(folder)[1] == first


def test_a_whole_catalogue_keeps_all_it_has_and_gets_what_it_lacks(folder):
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    store = Store(database, lambda _: None)
    failed, _ = store.create(Job(JobKind.ANALYSE))
    store.change(failed.id, lambda job: replace(job, state=State.FAILED))
    before = read_rows(database)
    database.write(
        lambda c: c.execute(schema.runs.delete().where(schema.runs.c.id == "s2"))
    )
    database.close()
    recovered, after = rebuild(folder)
    assert (recovered.aside, recovered.runs, recovered.jobs) == (None, 1, 0)
    assert after["jobs"] == before["jobs"]


@pytest.mark.parametrize("damage", [lambda _: None, spoil])
def test_what_was_deleted_stays_deleted(folder, run_reader, damage):
    """A job whose Run stays, a Run with what was made from it, files left behind."""
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    runs = RunCatalogue(database, folder / "runs", run_reader)
    deletion = Deletion(database, runs, folder / "results")
    jobs = {row["kind"]: row["id"] for row in read_rows(database)["jobs"]}
    (sent,) = (r.id for r in runs.list_all() if r.origin == "uploaded")
    deletion.delete_job(jobs["discover"])
    deletion.delete_run(sent, with_results=True)
    measured = next(r.id for r in runs.list_all() if r.name == "mill monday")
    deletion.delete_job(measured)
    before = read_rows(database)
    database.close()
    damage(folder)
    _, after = rebuild(folder)
    assert [r["id"] for r in after["runs"]] == [r["id"] for r in before["runs"]]
    assert [j["id"] for j in after["jobs"]] == [j["id"] for j in before["jobs"]]
    assert measured in [r["id"] for r in after["runs"]]


def test_a_result_that_outlives_its_deletion_makes_no_job(
    folder, run_reader, monkeypatch
):
    """The rows are gone and the disk refuses to give the files up."""
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    runs = RunCatalogue(database, folder / "runs", run_reader)
    deletion = Deletion(database, runs, folder / "results")
    found = next(
        j["id"] for j in read_rows(database)["jobs"] if j["kind"] == "discover"
    )
    with monkeypatch.context() as refusing:
        refusing.setattr(
            "truepath.jobs.dispatch.deletion.shutil.rmtree", Mock(side_effect=OSError)
        )
        deletion.delete_job(found)
    assert (folder / "results" / found / "discovery.json").is_file()
    database.close()
    assert found not in [job["id"] for job in rebuild(folder)[1]["jobs"]]
    spoil(folder)
    assert found not in [job["id"] for job in rebuild(folder)[1]["jobs"]]


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


def test_a_catalogue_kept_aside_is_never_overwritten(folder, monkeypatch):
    spoil(folder)
    first, _ = rebuild(folder)
    spoil(folder)
    assert first.aside is not None
    stamp = first.aside.name.split("-")[-1].removesuffix(".sqlite")
    monkeypatch.setattr(
        "truepath.jobs.dispatch.catalogue_rebuild.time.strftime", lambda *_: stamp
    )
    with pytest.raises(BadInput, match="exists already"):
        rebuild(folder)
    assert (folder / "catalogue.sqlite").read_bytes() == b"garbage " * 99


def test_a_check_names_where_catalogue_and_disk_disagree(folder):
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    assert check_against_disk(database, folder / "runs")["runs_without_row"] == []
    (folder / "runs" / "s2.sqlite").rename(folder / "runs" / "s3.sqlite")
    found = check_against_disk(database, folder / "runs")
    database.close()
    assert (found["jobs"], found["runs"]) == (4, 5)
    assert found["runs_without_row"] == ["s3"]
    assert found["rows_without_file"] == ["s2"]


def test_a_run_changed_with_its_checksums_made_anew_is_named(folder):
    """One byte of one batch is another, and its CRC fits: only the digest tells."""
    database = Database(f"sqlite:///{folder / 'catalogue.sqlite'}")
    whole = check_against_disk(database, folder / "runs", with_hashes=True)
    assert whole["changed_files"] == []
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
    assert check_against_disk(database, folder / "runs")["changed_files"] is None
    found = check_against_disk(database, folder / "runs", with_hashes=True)
    database.close()
    assert found["changed_files"] == ["s2"]
