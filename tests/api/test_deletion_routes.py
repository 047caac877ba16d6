"""Jobs and Runs are deleted with their files, and nothing that is depended on."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from truepath.catalogue.job import Stage
from truepath.errors import BundleError
from truepath.jobs.dispatch.reconciliation import reconcile
from truepath.jobs.dispatch.retention import Retention, RetentionRules

JOBS, RUNS = "/api/v1/jobs", "/api/v1/runs"
LATER = datetime.now(UTC) + timedelta(days=25)


@pytest.fixture
def run(client, bundle):
    return client.post(RUNS, files={"bundle": ("mill.zip", bundle())}).json()


@pytest.fixture
def analyse(client, until):
    def asked(run, **more):
        order = {"kind": "analyse", "run_id": run["id"], **more}
        return until(client.post(JOBS, json=order).json(), "succeeded")

    return asked


@pytest.fixture
def kept(service, analyse, run):
    """A job whose answer stands in its folder."""
    job = analyse(run)
    folder = service.results / job["id"]
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(json.dumps({"job": job["id"]}))
    return job


@pytest.fixture
def retention(service):
    rows = []
    context = service.dispatcher._context
    made = Retention(
        context,
        service.calibrations,
        service.deletion,
        RetentionRules(keep_runs_days=20, keep_results_days=20),
        lambda _, deleted: rows.append((deleted.kind, deleted.id)),
        lambda: False,
    )
    made.rows = rows
    return made


def test_a_job_goes_with_its_answer_and_its_run_stays(client, service, kept, run):
    at = f"{JOBS}/{kept['id']}"
    assert client.delete(at).status_code == 204
    assert client.get(at).status_code == 404
    assert not (service.results / kept["id"]).exists()
    assert client.get(f"{RUNS}/{run['id']}/bundle").status_code == 200
    newest = client.get("/api/v1/audit").json()["items"][0]
    assert newest["what"] == f"DELETE {at}"
    assert len(newest["old"][f"results/{kept['id']}/result.json"]) == 64
    assert client.delete(at).status_code == 404


def test_a_job_under_way_is_not_deleted(client, ready, is_problem):
    is_problem(client.delete(f"{JOBS}/{ready['id']}"), 409, "in-use")


def test_what_others_depend_on_is_not_deleted(
    client, service, kept, analysed, analyse, run, is_problem
):
    shutil.copytree(analysed, service.results / kept["id"], dirs_exist_ok=True)
    user = analyse(run, model_id=kept["id"])
    said = is_problem(client.delete(f"{JOBS}/{kept['id']}"), 409, "in-use")
    assert said["dependents"] == [user["id"]]
    client.delete(f"{JOBS}/{user['id']}")
    client.patch("/api/v1/machines/default", json={"reference_job": kept["id"]})
    said = is_problem(client.delete(f"{JOBS}/{kept['id']}"), 409, "in-use")
    assert said["dependents"] == ["machine default"]


def test_the_result_of_a_certificate_stays(client, service, kept, run, is_problem):
    folder = service.results / kept["id"] / "certificates" / "TP-1"
    folder.mkdir(parents=True)
    (folder / "certificate.json").write_text('{"sources_sha256": {}}')
    is_problem(client.delete(f"{JOBS}/{kept['id']}"), 409, "in-use")
    at = f"{RUNS}/{run['id']}"
    is_problem(client.delete(at, params={"with_results": True}), 409, "in-use")
    assert (folder / "certificate.json").is_file()


def test_a_certificate_that_cannot_be_read_holds_no_other_job(
    client, service, kept, analyse, run, is_problem
):
    other = analyse(run)
    folder = service.results / other["id"] / "certificates" / "TP-1"
    folder.mkdir(parents=True)
    (folder / "certificate.json").write_bytes(b'{"place": "a\\u0000b"}')
    is_problem(client.delete(f"{JOBS}/{other['id']}"), 409, "in-use")
    assert client.delete(f"{JOBS}/{kept['id']}").status_code == 204


def test_a_sweep_goes_on_behind_a_job_that_cannot_be_deleted(
    client, analyse, run, retention, service, monkeypatch
):
    good, bad, _ = (analyse(run) for _ in range(3))  # the newest is history
    delete_job = service.deletion.delete_job

    def refuse_one(job_id, note):
        if job_id == bad["id"]:
            raise BundleError("is not JSON", file="certificate.json")
        return delete_job(job_id, note)

    monkeypatch.setattr(service.deletion, "delete_job", refuse_one)
    retention.sweep(LATER)
    rows = {i for kind, i in retention.rows if kind == "job"}
    assert good["id"] in rows
    assert bad["id"] not in rows


def test_a_run_goes_with_its_results_only_when_that_is_asked(
    client, service, kept, run, is_problem
):
    at = f"{RUNS}/{run['id']}"
    said = is_problem(client.delete(at), 409, "in-use")
    assert said["dependents"] == [kept["id"]]
    assert client.delete(at, params={"with_results": True}).status_code == 204
    assert client.get(at).status_code == 404
    assert client.get(f"{JOBS}/{kept['id']}").status_code == 404
    assert not list(service.results.parent.glob(f"runs/**/{run['id']}*"))


def test_a_job_without_an_answer_forgets_its_run(client, service, armed, until):
    client.post(f"{JOBS}/{armed['id']}/abort")
    job = until(armed, "aborted", "faulted")
    (run_id,) = service.runs.find([job["id"]])
    assert client.delete(f"{RUNS}/{run_id}").status_code == 204
    assert client.get(f"{JOBS}/{job['id']}").json()["run_id"] is None


def test_a_run_stays_while_its_measurement_can_go_on_from_it(
    client, service, armed, make_cell, until, is_problem
):
    make_cell.cell.fault()
    make_cell.cell.end("faulted")
    job = until(armed, "faulted")
    at = f"{RUNS}/{job['run_id']}"
    for asked in ({}, {"with_results": True}):
        said = is_problem(client.delete(at, params=asked), 409, "in-use")
        assert said["dependents"] == [job["id"]]
    assert "acknowledge" in job["links"]["verbs"]
    change = {"stage": Stage.ESTIMATING}
    service.store.change(job["id"], lambda one: replace(one, **change))
    now = client.get(f"{JOBS}/{job['id']}").json()
    assert "acknowledge" not in now["links"]["verbs"]
    assert f'"run_ids": ["{job["run_id"]}"]' in now["error"]["action"]
    assert client.delete(at).status_code == 204


def test_a_run_whose_file_outlives_a_crash_is_not_taken_in_again(
    client, service, finished, monkeypatch
):
    """The rows are gone and the file is not: as if the power had failed between."""
    file = service.runs.file(finished["run_id"])

    def fail(*_):
        raise OSError("the disk refuses")

    with monkeypatch.context() as patch:
        patch.setattr(type(service.runs), "remove_files", fail)
        at = f"{RUNS}/{finished['run_id']}"
        assert client.delete(at, params={"with_results": True}).status_code == 204
    assert file.is_file()
    assert file.suffix == ".sqlite"
    reconcile(service.dispatcher._context)
    assert not service.runs.find([finished["run_id"]])
    service.deletion.remove_files()
    assert not file.exists()
    assert service.runs.list_left_behind() == []


@pytest.mark.parametrize("years", [10, -10])
def test_nothing_is_deleted_by_a_clock_that_does_not_go_with_the_newest_job(
    client, service, kept, analyse, run, retention, years
):
    analyse(run)
    assert retention.sweep(datetime.now(UTC) + timedelta(days=365 * years)) == 0
    assert retention.rows == []
    retention.sweep(LATER)
    assert ("job", kept["id"]) in retention.rows


def test_a_sweep_takes_what_is_old_and_leaves_history_and_its_runs(
    client, service, kept, run, analyse, retention, bundle
):
    loose = client.post(RUNS, files={"bundle": ("loose.zip", bundle())}).json()
    again = analyse(run)  # stands for the earlier one in the history of the machine
    assert (kept["machine"], again["machine"]) == ("default", "default")
    (service.results / again["id"]).mkdir(exist_ok=True)
    (service.results / again["id"] / "result.json").write_text("{}")
    assert retention.sweep() == 0
    retention.sweep(LATER)
    assert set(retention.rows) == {("job", kept["id"]), ("run", loose["id"])}
    assert not service.runs.find([loose["id"]])
    assert service.runs.find([run["id"]])  # an answer was made from it
    assert client.get(f"{JOBS}/{again['id']}").status_code == 200
