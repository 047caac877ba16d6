"""Runs that are taken in, named, noted, followed over time, and deleted as jobs are."""

import io
import json
import shutil
import zipfile
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from api_builders import KNOWN_LENGTHS
from truepath.catalogue.job import Stage
from truepath.errors import BundleError
from truepath.jobs.dispatch.deletion import Retention, RetentionRules
from truepath.jobs.dispatch.reconciliation import reconcile
from truepath.measurement.run_file.run_loader import open_recorded
from truepath.service.api.routes import runs as run_routes
from truepath_simulators.machine_file import load_machine

pytestmark = pytest.mark.database
JOBS, RUNS = "/api/v1/jobs", "/api/v1/runs"


def send(client, content, name="from shop.zip"):
    return client.post(RUNS, files={"bundle": (name, content, "application/zip")})


def test_an_uploaded_bundle_is_analysed_and_comes_back_as_sent(client, bundle, take):
    sent = bundle()
    answer = send(client, sent)
    assert answer.status_code == 201, answer.text
    run = answer.json()
    assert answer.headers["location"] == f"{RUNS}/{run['id']}"
    assert (run["name"], run["origin"], run["mode"]) == ("from shop", "uploaded", "otf")
    assert (run["samples"], run["lost_samples"]) == (100, 0)
    back = client.get(run["links"]["bundle"])
    assert back.content == sent
    assert f'filename="run-{run["id"]}.zip"' in back.headers["content-disposition"]
    order = {"kind": "analyse", "run_id": run["id"]}
    job = take(**order, perpendicular_only=True, monte_carlo={"seed": 7})
    assert (job["run_id"], job["perpendicular_only"]) == (run["id"], True)
    assert job["monte_carlo"] == {"seed": 7, "interval": "symmetric"}
    plan = client.get(job["links"]["plan"]).json()
    assert plan["position"] == [[10, 10, 10], [400, 300, 200]]
    assert take(**order)["monte_carlo"] is None


def test_a_bad_upload_has_its_place(client, service, bundle, is_problem, monkeypatch):
    for members, file, column, text in (
        ({"tracker_csv": None}, "tracker.parquet", None, "missing"),
        ({"tracker_csv": "t_s,x_mm,y_mm\n0,1,2\n"}, "tracker.csv", "z_mm", "missing"),
        ({"machine_json": "{}"}, "machine.json", None, "schema"),
    ):
        problem = is_problem(send(client, bundle(**members)), 422, "bundle")
        assert text in problem["detail"]
        assert (problem["file"], problem["column"]) == (file, column)
    for content in (b"", b"not a zip", b"PK\x03\x04 truncated"):
        answer = send(client, content, "C:\\data\\mill 3.zip")
        problem = is_problem(answer, 422, "bundle")
        assert not content or problem["file"] == "mill 3.zip"  # as it was sent
        assert ".upload" not in str(problem)
    is_problem(send(client, b"0" * (4 << 20)), 413, "too-large")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tracker.csv", b"0" * (17 << 20))
    problem = is_problem(send(client, packed.getvalue()), 422, "bundle")
    assert "unpacks to 17 MiB" in problem["detail"]
    problem = is_problem(client.post(RUNS, files={"other": b"x"}), 422, "validation")
    assert problem["errors"][0]["location"] == ["body", "bundle"]
    headers = {"content-type": "application/json"}  # where no large body belongs
    answer = client.post(JOBS, content=b" " * (2 << 20), headers=headers)
    is_problem(answer, 413, "too-large")
    monkeypatch.setattr(run_routes, "LEAST_FREE_BYTES", 1 << 60)
    is_problem(send(client, bundle()), 507, "disk-full")
    assert client.get(RUNS).json()["items"] == []
    assert list(service.runs._folder.iterdir()) == []


def test_the_name_of_a_file_is_for_people_only():
    for filename, name in (
        ("mill.zip", "mill"),
        ("../../etc/passwd", "passwd"),
        (r"C:\data\run 7.zip", "run 7"),
        ("a\x00b\n<script>.zip", "a_b_script"),
        ("", "bundle"),
        (None, "bundle"),
        ("...", "bundle"),
        ("x" * 300, "x" * 100),
    ):
        assert run_routes.clean_run_name(filename) == name


def test_a_job_gets_name_and_note_without_a_new_version(client, service, ready):
    at = f"{JOBS}/{ready['id']}"
    assert (ready["name"], ready["note"]) == ("", "")
    event = service.store.read_last_event_id()
    assert client.patch(at, json={"name": "As found, Müller"}).status_code == 200
    noted = client.patch(at, json={"note": "Warm since 8:00.\nDoor open."}).json()
    assert noted["name"] == "As found, Müller"
    assert noted == client.get(at).json()
    assert noted["version"] == ready["version"]
    assert service.store.read_last_event_id() == event + 2
    client.patch(at, json={"name": "As found, Müller"})
    assert service.store.read_last_event_id() == event + 2
    newest = client.get("/api/v1/audit").json()["items"]
    changed = [one for one in newest if one["what"] == f"PATCH {at}"]
    assert changed[1]["new"] == {"note": noted["note"]}
    # Who changes the job as it was before leaves its name.
    service.store.change(ready["id"], lambda job: replace(job, name="", note="old"))
    job = client.get(at).json()
    assert (job["name"], job["note"]) == (noted["name"], noted["note"])


def test_names_are_short_and_found_by_a_part(client, ready, run, is_problem):
    for at, named in ((JOBS, ready), (RUNS, run)):
        own = f"{at}/{named['id']}"
        client.patch(own, json={"name": "Vor der Spindel ÄÖ 100%_a"})
        for part, count in (("SPINDEL äö", 1), ("0%_", 1), ("0_", 0), ("%x", 0)):
            found = client.get(at, params={"name": part}).json()["items"]
            assert len(found) == count, part
        for body in (
            {"name": "a\x00b"},
            {"name": "two\nlines"},
            {"name": "\u202egnp.exe"},
            {"note": "\x1b[2J"},
            {"name": 200 * "ab"},
            {"note": 2001 * "n"},
            {"owner": "bert"},
        ):
            is_problem(client.patch(own, json=body), 422, "validation")
    named = client.patch(own, json={"name": "Before", "note": "as found"}).json()
    assert (named["name"], named["note"]) == ("Before", "as found")
    assert client.get(own).json() == named
    assert named["sha256"] == run["sha256"]
    for name, wrong in (("", "at least 1 character"), ("a\tb", r"'\t' (U+0009)")):
        answer = client.patch(own, json={"name": name})
        detail = is_problem(answer, 422, "validation")["detail"]
        assert wrong in detail
        assert "pattern" not in detail


def test_runs_are_listed_and_analysed_together(client, run, upload, take, is_problem):
    for asked, count in (
        ({"machine": run["machine"]}, 1),
        ({"machine": "default"}, 1),
        ({"machine": "another"}, 0),
        ({"mode": "otf"}, 1),
        ({"mode": "standstill"}, 0),
        ({"since": run["created"]}, 1),
        ({"until": run["created"]}, 0),
    ):
        assert len(client.get(RUNS, params=asked).json()["items"]) == count, asked
    ids = [upload(f"run {number % 2}.zip")["id"] for number in range(5)][::2]
    first = client.get(RUNS, params={"name": "RUN 0", "limit": 2})
    assert "name=RUN" in first.headers["Link"]
    after = {"name": "RUN 0", "limit": 2, "after": first.json()["next"]}
    second = client.get(RUNS, params=after).json()
    found = [first.json()["items"], second["items"]]
    assert [[run["id"] for run in page] for page in found] == [ids[:0:-1], ids[:1]]
    assert second["next"] is None
    assert client.get(f"{RUNS}/{ids[0]}").json()["id"] == ids[0]
    job = take(kind="analyse", run_ids=ids)
    assert (job["run_id"], job["run_ids"]) == (ids[0], ids)
    for unknown in ({"run_id": "nowhere"}, {"run_ids": [ids[0], "nowhere"]}):
        answer = client.post(JOBS, json={"kind": "analyse", **unknown})
        is_problem(answer, 404, "not-found")
    for path in ("/nowhere", "/nowhere/bundle", "/..%2f..%2fetc"):
        is_problem(client.get(RUNS + path), 404, "not-found")


@pytest.fixture
def analyse(take):
    return lambda run, **more: take(kind="analyse", run_id=run["id"], **more)


@pytest.fixture
def kept(service, analyse, run):
    job = analyse(run)
    folder = service.results / job["id"]
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(json.dumps({"job": job["id"]}))
    return job


def test_a_job_goes_with_its_answer_and_a_run_with_its_results_if_that_is_asked(
    client, service, kept, run, analyse, take, order, is_problem
):
    at, of_run = f"{JOBS}/{kept['id']}", f"{RUNS}/{run['id']}"
    other = analyse(run)
    assert client.delete(at).status_code == 204
    assert client.get(at).status_code == 404
    assert not (service.results / kept["id"]).exists()
    assert client.get(f"{of_run}/bundle").status_code == 200
    newest = client.get("/api/v1/audit").json()["items"][0]
    assert newest["what"] == f"DELETE {at}"
    assert len(newest["old"][f"results/{kept['id']}/result.json"]) == 64
    assert client.delete(at).status_code == 404
    said = is_problem(client.delete(of_run), 409, "in-use")
    assert said["dependents"] == [other["id"]]
    assert client.delete(of_run, params={"with_results": True}).status_code == 204
    for gone in (of_run, f"{JOBS}/{other['id']}"):
        assert client.get(gone).status_code == 404
    assert not list(service.results.parent.glob(f"runs/**/{run['id']}*"))
    ready = take("ready", **order)  # it is under way
    is_problem(client.delete(f"{JOBS}/{ready['id']}"), 409, "in-use")


def test_what_others_or_a_certificate_depend_on_is_not_deleted(
    client, service, kept, analysed, analyse, run, is_problem
):
    shutil.copytree(analysed, service.results / kept["id"], dirs_exist_ok=True)
    at = f"{JOBS}/{kept['id']}"
    user, other = analyse(run, model_id=kept["id"]), analyse(run)
    said = is_problem(client.delete(at), 409, "in-use")
    assert said["dependents"] == [user["id"]]
    client.delete(f"{JOBS}/{user['id']}")
    machine = "/api/v1/machines/default"
    client.patch(machine, json={"reference_job": kept["id"]})
    said = is_problem(client.delete(at), 409, "in-use")
    assert said["dependents"] == ["machine default"]
    client.patch(machine, json={"reference_job": None})
    folder = service.results / kept["id"] / "certificates" / "TP-1"
    folder.mkdir(parents=True)
    for text in ('{"sources_sha256": {}}', '{"place": "a\\u0000b"}'):
        (folder / "certificate.json").write_text(text)
        is_problem(client.delete(at), 409, "in-use")
        asked = {"with_results": True}
        is_problem(client.delete(f"{RUNS}/{run['id']}", params=asked), 409, "in-use")
        assert (folder / "certificate.json").is_file()
    # One that cannot be read holds no other job.
    assert client.delete(f"{JOBS}/{other['id']}").status_code == 204


def test_a_run_stays_while_its_measurement_can_go_on_from_it_and_is_then_forgotten(
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
    assert client.get(f"{JOBS}/{job['id']}").json()["run_id"] is None


def test_a_run_once_deleted_is_not_taken_in(client, service, finished, monkeypatch):
    """The rows are gone and the file is not: as if the power had failed between."""
    file = service.runs.file(finished["run_id"])

    def fail(*_):
        raise OSError("the disk refuses")

    with monkeypatch.context() as patch:
        patch.setattr(type(service.runs), "remove_files", fail)
        at = f"{RUNS}/{finished['run_id']}"
        assert client.delete(at, params={"with_results": True}).status_code == 204
    assert (file.is_file(), file.suffix) == (True, ".sqlite")
    reconcile(service.dispatcher._context)
    assert not service.runs.find([finished["run_id"]])
    service.deletion.remove_files()
    assert not file.exists()
    assert service.runs.list_uncatalogued() == []


def test_a_sweep_takes_what_is_old_and_can_go_and_leaves_history_and_its_runs(
    client, service, kept, run, analyse, upload, monkeypatch
):
    rows, rules = [], RetentionRules(keep_runs_days=20, keep_results_days=20)
    parts = service.dispatcher._context, service.calibrations, service.deletion

    def note(_, deleted):
        rows.append((deleted.kind, deleted.id))

    retention = Retention(*parts, rules, note, lambda: False)
    loose, bad = upload("loose.zip"), analyse(run)
    delete_job = service.deletion.delete_job

    def refuse_one(job_id, note):
        if job_id == bad["id"]:
            raise BundleError("is not JSON", file="certificate.json")
        return delete_job(job_id, note)

    monkeypatch.setattr(service.deletion, "delete_job", refuse_one)
    again = analyse(run)  # stands for the earlier one in the history of the machine
    assert (kept["machine"], again["machine"]) == ("default", "default")
    (service.results / again["id"]).mkdir(exist_ok=True)
    (service.results / again["id"] / "result.json").write_text("{}")
    assert retention.sweep() == 0
    for years in (10, -10):  # a clock that does not go with the newest job
        assert retention.sweep(datetime.now(UTC) + timedelta(days=365 * years)) == 0
    assert rows == []
    retention.sweep(datetime.now(UTC) + timedelta(days=25))
    assert set(rows) == {("job", kept["id"]), ("run", loose["id"])}
    assert not service.runs.find([loose["id"]])
    assert service.runs.find([run["id"]])  # an answer was made from it
    assert client.get(f"{JOBS}/{again['id']}").status_code == 200


def test_known_lengths_stay_with_their_run(client, service, run, is_problem):
    address = run["links"]["known_lengths"]

    def send(text, to=address):
        return client.put(to, files={"known_lengths": ("bar.csv", text)})

    in_metres = KNOWN_LENGTHS.replace("2000.01", "2.00001")
    problem = is_problem(send(in_metres), 422, "bundle")
    assert (problem["row"], problem["column"]) == (2, "length_mm")
    is_problem(send(KNOWN_LENGTHS, f"{RUNS}/nowhere/known-lengths"), 404, "not-found")
    is_problem(client.get(address), 404, "not-found")
    assert send(KNOWN_LENGTHS).json() == {"count": 1}
    assert client.get(address).text == KNOWN_LENGTHS
    (one,) = open_recorded(service.runs.file(run["id"])).known_lengths
    assert one.length_mm == 2000.01
    back = client.get(run["links"]["bundle"]).content
    with zipfile.ZipFile(io.BytesIO(back)) as archive:
        assert any(n.endswith("/known_lengths.csv") for n in archive.namelist())
    assert client.delete(address).status_code == 204
    assert not open_recorded(service.runs.file(run["id"])).known_lengths
    send(KNOWN_LENGTHS)
    assert client.delete(f"{RUNS}/{run['id']}").status_code == 204
    assert not list(service.runs._folder.glob("*.csv"))


@pytest.fixture
def upload_at(upload):
    def taken(begin_s, name="mill.zip", **members):
        rows = "".join(f"{begin_s + n / 500:.3f},{n},0,0\n" for n in range(100))
        return upload(name, tracker_csv="t_s,x_mm,y_mm,z_mm\n" + rows, **members)["id"]

    return taken


def test_a_trend_is_told_what_is_asked(client, upload_at, take, follower):
    runs = [upload_at(0.0), upload_at(3600.0)]
    asked = {"limit_um": 5.0, "later_h": [1.0], "temperature_degC": {"X": 21.5}}
    job = take(kind="trend", run_ids=runs, **asked)
    assert (job["run_ids"], job["verdict"], job["result"]) == (runs, "usable", None)
    report = client.get(job["trend"]["report_html"])
    assert "sandbox" in report.headers["content-security-policy"]
    ((files, names, told),) = follower.calls
    assert (len(files), names) == (2, ["mill", "mill"])
    assert {key: told[key] for key in asked} == asked


def test_runs_without_a_trend_make_no_job(client, upload_at, is_problem):
    def ask(*ids, **more):
        return client.post(JOBS, json={"kind": "trend", "run_ids": ids} | more)

    first, anew = upload_at(5.0, "monday.zip"), upload_at(0.0)
    again = upload_at(5.0, "tuesday.zip")
    said = is_problem(ask(first, again, at_h=[0, 1]), 422, "bad-input")["detail"]
    assert all(words in said for words in ("monday (", "tuesday (", "same Run"))
    is_problem(ask(first, "no-such-run"), 404, "not-found")
    assert "at_h" in is_problem(ask(first, anew), 422, "bad-input")["detail"]
    said = is_problem(ask(first, anew, at_h=[8.0]), 422, "bad-input")["detail"]
    assert "1 times" in said
    shorter = load_machine("demo")
    shorter["axes"]["X"]["max_mm"] = 450.0
    other = upload_at(3600.0, machine_json=json.dumps(shorter))
    assert "axes.X.max_mm" in is_problem(ask(first, other), 422, "bundle")["detail"]
    assert ask(first, anew, at_h=[8.0, 9.5]).status_code == 202


def test_a_reanalysis_takes_many_runs_and_has_a_summary(client, take, reanalysed):
    job = take(kind="reanalyse", run_ids=reanalysed)
    summary = client.get(job["reanalysis"]["reanalysis"]).json()
    assert (summary["schema"], summary["analysed"]) == ("reanalysis/1", 2)
    assert [one["name"] for one in summary["analyses"]] == ["run-0", "run-1"]
    at = f"{JOBS}/{job['id']}/reanalysis/runs"
    assert client.get(f"{at}/{reanalysed[0]}").json()["schema"] == "result/1"
    ids = [f"019a0000-0000-7000-8000-{n:012d}" for n in range(51)]
    assert client.get(f"{at}/{ids[0]}").status_code == 404
    answer = client.post(JOBS, json={"kind": "analyse", "run_ids": ids})
    assert answer.status_code == 422
    assert "more than 50" in answer.text
    answer = client.post(JOBS, json={"kind": "reanalyse", "run_ids": ids})
    assert answer.status_code == 404
