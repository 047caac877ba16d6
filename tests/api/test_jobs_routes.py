from __future__ import annotations

import re
import threading
import time
from datetime import datetime, timedelta, timezone

import pytest
from arming import arm_over_http, request_token
from scripted_cell import wait_until

from truepath.catalogue.errors import (
    ArmTokenExpired,
    ArmTokenUsed,
    StorageUnavailable,
)
from truepath.jobs.dispatch.arm_tokens import ArmTokens

UNKNOWN = "/api/v1/jobs/019a0000-0000-7000-8000-000000000000"


def test_a_job_is_taken_on_with_its_address_and_version(client, order, until):
    answer = client.post("/api/v1/jobs", json=order)
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"/api/v1/jobs/{job['id']}"
    assert answer.headers["etag"] == f'"{job["version"]}"'
    assert job["links"]["events"] == f"/api/v1/jobs/{job['id']}/events"
    until(job, "ready")


def test_the_main_job_over_rest(client, finished, service):
    assert finished["stage"] == "reporting"
    assert finished["error"] is None
    counted = {"lost_samples": 0, "crc_errors": 0, "gaps": 0, "repeats": 0}
    assert finished["health"] == {"samples": 50, **counted}
    links = finished["result"]
    result = client.get(links["result"])
    assert result.headers["content-type"] == "application/json"
    assert result.json()["schema"] == "result/1"
    tables = client.get(links["error_tables_json"]).json()
    assert tables["schema"] == "error-tables/1"
    assert set(tables["error_tables"]) == {"EXX"}
    assert set(tables["squareness_urad"]) == {"C0Y"}
    csv = client.get(links["error_tables_csv"])
    assert csv.headers["content-type"] == "text/csv; charset=utf-8"
    assert csv.text.startswith("error,position_mm")
    assert 'filename="error_tables.csv"' in csv.headers["content-disposition"]
    run = client.get(finished["links"]["run"]).json()
    assert (run["origin"], run["samples"], run["complete"]) == ("measured", 50, True)
    bundle = client.get(run["links"]["bundle"])
    assert bundle.headers["content-type"] == "application/zip"
    assert bundle.content.startswith(b"PK")


def test_the_report_runs_in_a_sandbox(client, finished):
    report = client.get(finished["result"]["report_html"])
    assert report.headers["content-type"] == "text/html; charset=utf-8"
    policy = report.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "default-src 'none'" in policy


def test_the_plan_is_what_was_asked_for(client, ready):
    plan = client.get(f"/api/v1/jobs/{ready['id']}/plan").json()
    assert plan["axes"] == ["X", "Y", "Z"]
    assert plan["position"] == [[10, 10, 10], [400, 300, 200], [100, 350, 50]]
    assert plan["feed_mm_min"][1] == 1000
    assert plan["dwell_s"][1] == 0.5
    assert plan["kind"] == "path"


def test_standstill_points_have_no_feed(client, until):
    points = [{"x_mm": x, "y_mm": x * x, "z_mm": 3} for x in (1, 9, 17)]
    order = {"kind": "measure-standstill", "points": points}
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    plan = client.get(job["links"]["plan"]).json()
    assert (plan["kind"], plan["feed_mm_min"]) == ("points", [])


@pytest.mark.parametrize("verb", ["arm", "resume"])
def test_what_moves_the_machine_needs_the_version_that_was_read(
    client, ready, is_problem, make_cell, verb
):
    address = f"/api/v1/jobs/{ready['id']}/{verb}"
    is_problem(client.post(address), 428, "version-required")
    every = client.post(address, headers={"If-Match": "*"})
    is_problem(every, 428, "version-required")
    odd = client.post(address, headers={"If-Match": '"three"'})
    is_problem(odd, 412, "stale-version")
    body = {"token": "of nobody"}
    stale = client.post(address, headers={"If-Match": '"1"'}, json=body)
    problem = is_problem(stale, 412, "stale-version")
    assert problem["current_version"] == ready["version"]
    assert "begin" not in make_cell.cell.heard


def test_a_weak_tag_matches_no_version(client, ready, is_problem, make_cell):
    headers = {"If-Match": f'W/"{ready["version"]}"'}
    body = {"token": request_token(client, ready["id"])}
    answer = client.post(f"/api/v1/jobs/{ready['id']}/arm", headers=headers, json=body)
    is_problem(answer, 412, "stale-version")
    assert "begin" not in make_cell.cell.heard


def test_arming_shows_what_moves_and_its_token_arms_once(
    client, ready, is_problem, make_cell
):
    address = f"/api/v1/jobs/{ready['id']}"
    shown = client.post(f"{address}/arming").json()
    assert (shown["job"], shown["machine"]) == (ready["id"], "default")
    assert {one["axis"] for one in shown["envelope"]} == {"X", "Y", "Z"}
    assert (shown["obstacles"], shown["expires_in_s"]) == ([], 60.0)
    headers = {"If-Match": f'"{shown["version"]}"'}
    body = {"token": shown["token"]}
    other = client.post(f"{address}/arm", headers=headers, json={"token": "other"})
    is_problem(other, 409, "arm-token-other")
    is_problem(client.post(f"{address}/arm", headers=headers), 422, "validation")
    assert "begin" not in make_cell.cell.heard
    assert client.post(f"{address}/arm", headers=headers, json=body).status_code == 202
    again = client.post(f"{address}/arm", headers=headers, json=body)
    is_problem(again, 409, "illegal-transition")


@pytest.mark.parametrize(
    ("error", "code"),
    [(ArmTokenExpired, "arm-token-expired"), (ArmTokenUsed, "arm-token-used")],
)
def test_a_token_that_is_no_longer_good_is_a_problem(
    client, ready, is_problem, service, monkeypatch, error, code
):
    def refuse(*_):
        raise error("it is not good any more")

    monkeypatch.setattr(ArmTokens, "use", refuse)
    is_problem(arm_over_http(client, ready), 409, code)


def test_pause_and_resume(client, armed, until):
    address = f"/api/v1/jobs/{armed['id']}"
    answer = client.post(f"{address}/pause")
    assert (answer.status_code, answer.json()["state"]) == (202, "pausing")
    paused = until(armed, "paused")
    assert paused["desired_state"] == "paused"
    again = client.post(f"{address}/pause")
    assert again.headers["etag"] == f'"{paused["version"]}"'
    headers = {"If-Match": again.headers["etag"]}
    answer = client.post(f"{address}/resume", headers=headers)
    assert (answer.status_code, answer.json()["state"]) == (202, "resuming")
    until(armed, "running")


def test_a_job_that_stands_says_why(client, armed, make_cell, until):
    make_cell.cell.fault("beam-lost", "the beam is lost", "lock it, then press Resume")
    make_cell.cell.say_state("paused")
    error = until(armed, "paused")["error"]
    assert error["code"] == "beam-lost"
    assert error["type"] == "/problems/beam-lost"
    assert error["detail"] == "the beam is lost"
    assert error["action"] == "lock it, then press Resume"


@pytest.mark.parametrize("verb", ["abort", "stop"])
def test_abort_and_stop_need_nothing(client, armed, until, verb, make_cell):
    address = "/api/v1/stop" if verb == "stop" else f"/api/v1/jobs/{armed['id']}/abort"
    answer = client.post(address)
    assert answer.status_code == 202
    until(armed, "aborted")
    assert "abort" in make_cell.cell.heard
    assert client.post(address).status_code == 202


def test_stop_works_while_every_other_request_waits_for_a_device(
    client, make_cell, service
):
    hold = threading.Event()
    make_cell.cell.connect = lambda: hold.wait(8) and {}

    def connect():
        client.post("/api/v1/machines/current:connect")

    threads = [threading.Thread(target=connect) for _ in range(45)]
    for thread in threads:
        thread.start()
    wait_until(
        lambda: service.machines.first.cell.status.state == "connecting", "the device"
    )
    begun = time.monotonic()
    assert client.post("/api/v1/stop").status_code == 202
    assert time.monotonic() - begun < 2
    hold.set()
    for thread in threads:
        thread.join()


def test_stop_names_the_jobs_it_has_reached(client, armed):
    jobs = client.post("/api/v1/stop").json()["jobs"]
    assert [(job["id"], job["desired_state"]) for job in jobs] == [
        (armed["id"], "aborted")
    ]


def test_stop_takes_a_plain_form_of_the_page(client):
    answer = client.post("/api/v1/stop", data={"why": "no script runs"})
    assert answer.status_code == 202


def test_a_second_measurement_is_refused_with_the_first_ones_address(
    client, ready, order, is_problem
):
    problem = is_problem(client.post("/api/v1/jobs", json=order), 409, "busy")
    assert problem["current_job"] == f"/api/v1/jobs/{ready['id']}"
    assert client.get("/api/v1/system").json()["current_job"] == ready["id"]


def test_a_verb_the_state_does_not_allow_is_a_conflict(client, ready, is_problem):
    answer = client.post(f"/api/v1/jobs/{ready['id']}/pause")
    problem = is_problem(answer, 409, "illegal-transition")
    assert "cannot pause a job that is ready" in problem["detail"]


@pytest.mark.parametrize(
    "path",
    [
        "",
        "/plan",
        "/events",
        "/result",
        "/result/error-tables.json",
        "/result/error-tables.csv",
        "/result/report.html",
    ],
)
def test_an_unknown_job_is_not_found(client, is_problem, path):
    is_problem(client.get(UNKNOWN + path), 404, "not-found")


@pytest.mark.parametrize("verb", ["arming", "arm", "pause", "resume", "abort"])
def test_verbs_of_an_unknown_job_are_not_found(client, is_problem, verb):
    answer = client.post(
        f"{UNKNOWN}/{verb}", headers={"If-Match": '"1"'}, json={"token": "of nobody"}
    )
    is_problem(answer, 404, "not-found")


@pytest.mark.parametrize(
    "path", ["/result", "/result/error-tables.json", "/result/report.html"]
)
def test_a_result_that_does_not_stand_yet_is_not_found(client, ready, is_problem, path):
    answer = client.get(f"/api/v1/jobs/{ready['id']}{path}")
    assert "ready) has no" in is_problem(answer, 404, "not-found")["detail"]


def test_a_result_file_of_a_job_that_has_not_succeeded_is_not_given_out(
    client, ready, service, is_problem
):
    folder = service.results / ready["id"]
    folder.mkdir()
    (folder / "result.json").write_text('{"half": "made"')
    answer = client.get(f"/api/v1/jobs/{ready['id']}/result")
    assert "ready) has no" in is_problem(answer, 404, "not-found")["detail"]


def test_a_retried_request_makes_one_job(client, order, until):
    headers = {"Idempotency-Key": "0d9f-retry"}
    first = client.post("/api/v1/jobs", json=order, headers=headers)
    until(first.json(), "ready")
    again = client.post("/api/v1/jobs", json=order, headers=headers)
    assert again.status_code == 202
    assert again.json()["id"] == first.json()["id"]
    assert len(client.get("/api/v1/jobs").json()["items"]) == 1


def test_a_key_with_another_body_is_refused(client, order, is_problem):
    headers = {"Idempotency-Key": "0d9f-retry"}
    client.post("/api/v1/jobs", json=order, headers=headers)
    other = {**order, "feed_mm_min": 99}
    answer = client.post("/api/v1/jobs", json=other, headers=headers)
    is_problem(answer, 409, "idempotency-key-reuse")


def test_lists_come_in_pages_that_lead_to_each_other(client, order, until):
    ids = []
    for _ in range(3):
        job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        until(job, "aborted")
        ids.append(job["id"])
    first = client.get("/api/v1/jobs?limit=2&state=aborted")
    assert first.headers["link"].endswith('>; rel="next"')
    address = first.headers["link"][1:].partition(">")[0]
    assert "state=aborted" in address
    second = client.get(address)
    assert "link" not in second.headers
    assert second.json()["next"] is None
    found = [job["id"] for page in (first, second) for job in page.json()["items"]]
    assert found == ids[::-1]
    assert client.get("/api/v1/jobs?state=ready").json()["items"] == []


def test_jobs_are_found_by_kind_and_by_when_they_were_created(client, order, until):
    jobs = []
    for _ in range(3):
        job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        jobs.append(until(job, "aborted"))

    def find(**query):
        items = client.get("/api/v1/jobs", params=query).json()["items"]
        return [item["id"] for item in items][::-1]

    ids, middle = [job["id"] for job in jobs], jobs[1]["created"]
    assert find(kind=order["kind"]) == ids
    assert find(kind=["plan", "trend"]) == []
    assert find(since=middle) == ids[1:]
    assert find(until=middle) == ids[:1]
    shifted = datetime.fromisoformat(middle).astimezone(timezone(timedelta(hours=5)))
    assert find(since=shifted.isoformat()) == ids[1:]


@pytest.mark.parametrize("after", ["czpub25l", "bm9wZQ==", "Zm9vOjE=", "====", "_"])
def test_a_cursor_of_somebody_elses_is_bad_input(client, is_problem, after):
    is_problem(client.get(f"/api/v1/jobs?after={after}"), 422, "bad-input")


@pytest.mark.parametrize(
    "query",
    [
        "limit=0",
        "limit=many",
        "state=asleep",
        "after=%0a",
        "kind=dance",
        "since=yesterday",
        "until=2026-01-31T08:00:00",
    ],
)
def test_a_query_that_is_not_as_documented_is_named(client, is_problem, query):
    problem = is_problem(client.get(f"/api/v1/jobs?{query}"), 422, "validation")
    name = query.partition("=")[0]
    assert problem["errors"][0]["location"][:2] == ["query", name]


@pytest.mark.parametrize(
    ("body", "where", "text"),
    [
        ({}, ["body", "kind"], "Field required"),
        ({"kind": "dance"}, ["body", "kind"], "Input should be"),
        ({"kind": "analyse"}, ["body"], "needs a run_id"),
        (
            {"kind": "analyse", "run_id": "a", "run_ids": ["b"]},
            ["body"],
            "stands beside run_ids",
        ),
        ({"kind": "analyse", "run_ids": ["a", "a"]}, ["body"], "names a Run twice"),
        ({"kind": "analyse", "run_ids": []}, ["body", "run_ids"], "at least 1"),
        ({"kind": "analyse", "run_id": "../etc"}, ["body", "run_id"], "holds"),
        ({"kind": "measure-otf", "points": [{}]}, ["body"], "points is not for"),
        ({"kind": "measure-otf", "hurry": 1}, ["body", "hurry"], "Extra inputs"),
        ({"kind": "measure-otf", "path": [{}]}, ["body", "path"], "at least 2"),
        (
            {"kind": "measure-otf", "path": [{"x_mm": "a"}, {}]},
            ["body", "path", "0", "x_mm"],
            "valid number",
        ),
        ({"kind": "measure-otf", "feed_mm_min": -1}, ["body", "feed_mm_min"], "than"),
        ([1, 2], ["body"], "valid dictionary"),
    ],
)
def test_a_body_that_is_not_as_documented_is_named(
    client, is_problem, body, where, text
):
    answer = client.post("/api/v1/jobs", json=body)
    errors = is_problem(answer, 422, "validation")["errors"]
    assert errors[0]["location"] == where
    assert text in errors[0]["message"]
    assert set(errors[0]) == {"location", "message", "type"}


@pytest.mark.parametrize(
    ("kind", "key", "places", "said"),
    [
        ("measure-otf", "path", [10, 200], "the path has the target stand at 2 places"),
        ("measure-otf", "path", [10, 200, 10], "the path lies on one straight line"),
        ("measure-standstill", "points", [10], "stand at 1 place; .* add rows"),
        ("measure-standstill", "points", [10, 90, 200], "points lies on one straight"),
    ],
)
def test_rows_that_no_analysis_could_take_are_refused_before_there_is_a_job(
    client, is_problem, kind, key, places, said
):
    rows = [{"x_mm": x, "y_mm": x, "z_mm": x} for x in places]
    answer = client.post("/api/v1/jobs", json={"kind": kind, key: rows})
    assert re.search(said, is_problem(answer, 422, "plan")["detail"])
    assert client.get("/api/v1/jobs").json()["items"] == []


@pytest.mark.parametrize(
    "change",
    [
        {"tolerance_um": True},
        {"tolerance_um": "5"},
        {"seed": True},
        {"perpendicular_only": "yes"},
    ],
)
def test_a_value_of_another_type_is_refused(client, is_problem, change):
    body = {"kind": "verify", "result_id": "0190a4a1", **change}
    said = is_problem(client.post("/api/v1/jobs", json=body), 422, "validation")
    assert next(iter(change)) in said["detail"]


@pytest.mark.parametrize(
    "body", [b"{", b"\xff\xfe", b'{"kind": NaN}', b"[" * 5000, b'{"kind":"analyse"']
)
def test_a_body_that_is_not_json_is_a_problem(client, is_problem, body):
    headers = {"content-type": "application/json"}
    answer = client.post("/api/v1/jobs", content=body, headers=headers)
    assert answer.status_code in (400, 422)
    assert answer.headers["content-type"] == "application/problem+json"


def test_infinite_numbers_are_refused(client, is_problem):
    body = b'{"kind": "measure-otf", "feed_mm_min": 1e999}'
    headers = {"content-type": "application/json"}
    answer = client.post("/api/v1/jobs", content=body, headers=headers)
    is_problem(answer, 422, "validation")


def test_a_plan_out_of_travel_names_the_row_the_axis_and_the_remedy(
    client, order, is_problem
):
    order["path"][1] = {**order["path"][1], "y_mm": 401}
    problem = is_problem(client.post("/api/v1/jobs", json=order), 422, "out-of-travel")
    assert "row 2: Y = 401 mm exceeds 400 mm" in problem["detail"]
    assert client.get("/api/v1/jobs").json()["items"] == []


def test_a_row_without_an_axis_is_named(client, order, is_problem):
    order["path"] = [{"x_mm": 1, "y_mm": 1, "z_mm": 1}, {"x_mm": 2, "y_mm": 2}]
    problem = is_problem(client.post("/api/v1/jobs", json=order), 422, "plan")
    assert problem["detail"] == "row 2: z_mm is missing"


def test_an_analysis_of_an_unknown_run_is_not_found(client, is_problem):
    body = {"kind": "analyse", "run_id": "nowhere"}
    is_problem(client.post("/api/v1/jobs", json=body), 404, "not-found")


def test_a_catalogue_that_is_away_is_no_fault_of_the_client(
    client, is_problem, service
):
    def away(*_):
        raise StorageUnavailable("the catalogue does not answer: locked")

    service.store.get = away
    problem = is_problem(client.get(UNKNOWN), 503, "storage")
    assert "Try again" in problem["action"]


def test_a_failure_of_ours_is_a_problem_that_tells_no_secrets(
    client, is_problem, service
):
    def broken(*_):
        raise KeyError("the password is secret")

    service.store.get = broken
    answer = client.get(UNKNOWN)
    problem = is_problem(answer, 500, "internal-error")
    assert "secret" not in answer.text
    assert problem["request_id"]


def test_a_job_that_failed_carries_its_problem(client, armed, make_cell, until):
    make_cell.cell.fault("motion-alarm", "servo alarm", "clear it")
    make_cell.cell.end("faulted")
    error = until(armed, "faulted")["error"]
    assert (error["code"], error["detail"], error["action"]) == (
        "motion-alarm",
        "servo alarm",
        "clear it",
    )
    assert error["status"] is None


def test_a_failure_nobody_foresaw_tells_nothing_but_that(
    client, armed, make_cell, until, science
):
    science.raises = KeyError("secret")
    make_cell.cell.end()
    error = until(armed, "failed")["error"]
    assert error["code"] == "internal-error"
    assert "secret" not in str(error)
