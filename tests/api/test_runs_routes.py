from __future__ import annotations

import io
import os
import signal
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor

import pytest
from scripted_cell import wait_until

from truepath.service.api.routes import runs as run_routes

ADDRESS = "/api/v1/runs"


def upload(client, content, name="from shop.zip"):
    return client.post(ADDRESS, files={"bundle": (name, content, "application/zip")})


def test_an_uploaded_bundle_is_catalogued_and_analysed(client, bundle, until):
    answer = upload(client, bundle())
    assert answer.status_code == 201, answer.text
    run = answer.json()
    assert answer.headers["location"] == f"{ADDRESS}/{run['id']}"
    assert (run["name"], run["origin"], run["mode"]) == ("from shop", "uploaded", "otf")
    assert (run["samples"], run["lost_samples"]) == (100, 0)
    order = {"kind": "analyse", "run_id": run["id"], "perpendicular_only": True}
    job = until(client.post("/api/v1/jobs", json=order).json(), "succeeded")
    assert job["run_id"] == run["id"]
    assert job["perpendicular_only"]
    plan = client.get(job["links"]["plan"]).json()
    assert plan["position"] == [[10, 10, 10], [400, 300, 200]]


def test_several_runs_are_analysed_together(client, bundle, until):
    ids = [upload(client, bundle()).json()["id"] for _ in range(2)]
    order = {"kind": "analyse", "run_ids": ids}
    job = until(client.post("/api/v1/jobs", json=order).json(), "succeeded")
    assert (job["run_id"], job["run_ids"]) == (ids[0], ids)
    unknown = {"kind": "analyse", "run_ids": [ids[0], "nowhere"]}
    assert client.post("/api/v1/jobs", json=unknown).status_code == 404


def test_a_bundle_comes_back_as_it_was_sent(client, bundle):
    sent = bundle()
    run = upload(client, sent).json()
    back = client.get(run["links"]["bundle"])
    assert back.content == sent
    assert f'filename="run-{run["id"]}.zip"' in back.headers["content-disposition"]


def test_runs_are_listed_in_pages(client, bundle):
    ids = [upload(client, bundle()).json()["id"] for _ in range(3)]
    first = client.get(f"{ADDRESS}?limit=2").json()
    second = client.get(f"{ADDRESS}?limit=2&after={first['next']}").json()
    assert [run["id"] for run in first["items"] + second["items"]] == ids[::-1]
    assert second["next"] is None
    assert client.get(f"{ADDRESS}/{ids[0]}").json()["id"] == ids[0]


@pytest.mark.parametrize("path", ["/nowhere", "/nowhere/bundle", "/..%2f..%2fetc"])
def test_an_unknown_run_is_not_found(client, is_problem, path):
    is_problem(client.get(ADDRESS + path), 404, "not-found")


@pytest.mark.parametrize(
    ("members", "place", "text"),
    [
        ({"tracker_csv": None}, ("tracker.parquet", None, None), "missing"),
        (
            {"tracker_csv": "t_s,x_mm,y_mm\n0,1,2\n"},
            ("tracker.csv", None, "z_mm"),
            "missing",
        ),
        ({"machine_json": "{}"}, ("machine.json", None, None), "schema"),
    ],
)
def test_a_bundle_that_cannot_be_used_is_refused_with_its_place(
    client, bundle, is_problem, members, place, text
):
    problem = is_problem(upload(client, bundle(**members)), 422, "bundle")
    assert text in problem["detail"]
    assert (problem["file"], problem["column"]) == (place[0], place[2])
    assert place[1] is None or problem["row"] == place[1]
    assert client.get(ADDRESS).json()["items"] == []


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 truncated"])
def test_what_is_no_archive_is_refused(client, is_problem, content, service):
    is_problem(upload(client, content), 422, "bundle")
    assert list(service.runs._folder.iterdir()) == []


@pytest.mark.parametrize("content", [b"not a zip", b"PK\x03\x04 truncated"])
def test_a_refused_upload_is_named_as_it_was_sent(client, is_problem, content):
    problem = is_problem(upload(client, content, "C:\\data\\mill 3.zip"), 422, "bundle")
    assert problem["file"] == "mill 3.zip"
    assert ".upload" not in str(problem)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("line\tbreak", r"holds '\t' (U+0009)"), ("", "at least 1 character")],
)
def test_a_refused_name_is_told_what_is_wrong_with_it(client, is_problem, name, wrong):
    answer = client.patch(f"{ADDRESS}/any", json={"name": name})
    detail = is_problem(answer, 422, "validation")["detail"]
    assert wrong in detail
    assert "pattern" not in detail


def test_an_upload_beyond_the_limit_is_refused(client, is_problem):
    is_problem(upload(client, b"0" * (4 << 20)), 413, "too-large")


def test_an_upload_that_would_unpack_to_too_much_is_refused(client, is_problem):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tracker.csv", b"0" * (17 << 20))
    problem = is_problem(upload(client, packed.getvalue()), 422, "bundle")
    assert "unpacks to 17 MiB" in problem["detail"]


def test_an_upload_without_a_bundle_is_named(client, is_problem):
    answer = client.post(ADDRESS, files={"other": b"x"})
    problem = is_problem(answer, 422, "validation")
    assert problem["errors"][0]["location"] == ["body", "bundle"]


def test_a_body_that_is_no_form_is_a_problem(client):
    headers = {"content-type": "multipart/form-data; boundary=x"}
    answer = client.post(ADDRESS, content=b"--x\r\ngarbage", headers=headers)
    assert answer.status_code in (400, 422)
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_large_body_where_none_belongs_is_refused(client, is_problem):
    headers = {"content-type": "application/json"}
    answer = client.post("/api/v1/jobs", content=b" " * (2 << 20), headers=headers)
    is_problem(answer, 413, "too-large")


def test_a_full_disk_takes_no_uploads(client, bundle, is_problem, monkeypatch):
    monkeypatch.setattr(run_routes, "LEAST_FREE_BYTES", 1 << 60)
    is_problem(upload(client, bundle()), 507, "disk-full")


def test_members_that_point_out_of_the_archive_are_refused(client, bundle, is_problem):
    packed = io.BytesIO(bundle())
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr("../../machine.json", "{}")
    problem = is_problem(upload(client, packed.getvalue()), 422, "bundle")
    assert "points out of the archive" in problem["detail"]


@pytest.mark.parametrize(
    ("filename", "name"),
    [
        ("mill.zip", "mill"),
        ("../../etc/passwd", "passwd"),
        (r"C:\data\run 7.zip", "run 7"),
        ("a\x00b\n<script>.zip", "a_b_script"),
        ("", "bundle"),
        (None, "bundle"),
        ("...", "bundle"),
        ("x" * 300, "x" * 100),
    ],
)
def test_the_name_of_a_file_is_for_people_only(filename, name):
    assert run_routes.clean_run_name(filename) == name


def test_an_analysis_says_which_trials_it_is_held_against(client, bundle, until):
    run = upload(client, bundle()).json()
    order = {"kind": "analyse", "run_id": run["id"], "monte_carlo": {"seed": 7}}
    job = until(client.post("/api/v1/jobs", json=order).json(), "succeeded")
    assert job["monte_carlo"] == {"seed": 7, "interval": "symmetric"}
    plain = {"kind": "analyse", "run_id": run["id"]}
    job = until(client.post("/api/v1/jobs", json=plain).json(), "succeeded")
    assert job["monte_carlo"] is None


@pytest.mark.parametrize(
    "order",
    [
        {"kind": "measure-otf", "monte_carlo": {}},
        {"kind": "analyse", "run_id": "x", "monte_carlo": {"seed": -1}},
        {"kind": "analyse", "run_id": "x", "monte_carlo": {"interval": "widest"}},
    ],
)
def test_trials_that_cannot_be_are_refused(client, is_problem, order):
    is_problem(client.post("/api/v1/jobs", json=order), 422, "validation")


@pytest.mark.fault_row(36)
def test_the_service_answers_while_what_was_uploaded_is_read(
    live, service, bundle, run_reader, measured
):
    assert upload(live, bundle()).status_code == 201  # the reader is up
    uploads, folder = 45, service.runs._folder  # more than there are request threads
    process_id = run_reader._process._process.process_id
    with ThreadPoolExecutor(uploads) as pool:
        os.kill(process_id, signal.SIGSTOP)
        try:
            sent = [pool.submit(upload, live, bundle()) for _ in range(uploads)]
            wait_until(lambda: len(list(folder.glob("*.upload"))) >= 4)
            begun = time.monotonic()
            for _ in range(20):
                assert live.get(ADDRESS).status_code == 200
            took_s = time.monotonic() - begun
            assert took_s < 5
            measured(f"20 requests beside {uploads} uploads that stand: {took_s:.2f} s")
            assert not any(one.done() for one in sent)
        finally:
            os.kill(process_id, signal.SIGCONT)
        assert {one.result().status_code for one in sent} == {201}
