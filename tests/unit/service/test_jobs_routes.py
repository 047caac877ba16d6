import threading
import time
from datetime import datetime, timedelta, timezone

import pytest

from arming import arm_over_http
from scripted_cell import wait_until
from truepath.catalogue.errors import ArmTokenExpired, ArmTokenUsed, StorageUnavailable
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.jobs.dispatch.arm_tokens import ArmTokens

pytestmark = pytest.mark.database
JOBS = "/api/v1/jobs"
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})
UNKNOWN = f"{JOBS}/019a0000-0000-7000-8000-000000000000"


def test_a_job_is_taken_on_with_its_address_and_version_once_for_a_key(
    client, order, until, is_problem
):
    headers = {"Idempotency-Key": "0d9f-retry"}
    answer = client.post(JOBS, json=order, headers=headers)
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"{JOBS}/{job['id']}"
    assert answer.headers["etag"] == f'"{job["version"]}"'
    assert job["links"]["events"] == f"{JOBS}/{job['id']}/events"
    until(job, "ready")
    again = client.post(JOBS, json=order, headers=headers)
    assert (again.status_code, again.json()["id"]) == (202, job["id"])
    assert len(client.get(JOBS).json()["items"]) == 1
    other = client.post(JOBS, json={**order, "feed_mm_min": 99}, headers=headers)
    is_problem(other, 409, "idempotency-key-reuse")


def test_the_main_job_over_rest(client, finished):
    assert finished["stage"] == "reporting"
    assert finished["error"] is None
    counted = {"lost_samples": 0, "crc_errors": 0, "gaps": 0, "repeats": 0}
    assert finished["health"] == {"samples": 50, **counted}
    assert (finished["machine"], finished["machine_version"]) == ("default", 1)
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
    report = client.get(links["report_html"])
    assert report.headers["content-type"] == "text/html; charset=utf-8"
    policy = report.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "default-src 'none'" in policy


def test_the_plan_is_what_was_asked_for_and_points_have_no_feed(client, ready, take):
    plan = client.get(f"{JOBS}/{ready['id']}/plan").json()
    assert plan["axes"] == ["X", "Y", "Z"]
    assert plan["position"] == [[10, 10, 10], [400, 300, 200], [100, 350, 50]]
    assert plan["feed_mm_min"][1] == 1000
    assert plan["dwell_s"][1] == 0.5
    assert plan["kind"] == "path"
    client.post("/api/v1/stop")
    points = [{"x_mm": x, "y_mm": x * x, "z_mm": 3} for x in (1, 9, 17)]
    job = take("ready", kind="measure-standstill", points=points)
    plan = client.get(job["links"]["plan"]).json()
    assert (plan["kind"], plan["feed_mm_min"]) == ("points", [])


@pytest.mark.parametrize("verb", ["arm", "resume"])
def test_what_moves_the_machine_needs_the_version_that_was_read(
    client, ready, is_problem, make_cell, verb
):
    address, body = f"{JOBS}/{ready['id']}/{verb}", {"token": "of nobody"}
    is_problem(client.post(address), 428, "version-required")
    every = client.post(address, headers={"If-Match": "*"})
    is_problem(every, 428, "version-required")
    odd = client.post(address, headers={"If-Match": '"three"'})
    is_problem(odd, 412, "stale-version")
    for tag in (f'W/"{ready["version"]}"', '"1"'):
        stale = client.post(address, headers={"If-Match": tag}, json=body)
        problem = is_problem(stale, 412, "stale-version")
    assert problem["current_version"] == ready["version"]
    assert "begin" not in make_cell.cell.heard


def test_arming_shows_what_moves_and_its_token_arms_once(
    client, ready, is_problem, make_cell
):
    address = f"{JOBS}/{ready['id']}"
    shown = client.post(f"{address}/arming").json()
    assert (shown["job"], shown["machine"]) == (ready["id"], "default")
    assert {one["axis"] for one in shown["envelope"]} == {"X", "Y", "Z"}
    assert (shown["obstacles"], shown["expires_in_s"]) == ([], 60.0)
    headers = {"If-Match": f'"{shown["version"]}"'}
    body = {"token": shown["token"]}
    weak = {"If-Match": f'W/"{shown["version"]}"'}
    answer = client.post(f"{address}/arm", headers=weak, json=body)
    is_problem(answer, 412, "stale-version")
    other = client.post(f"{address}/arm", headers=headers, json={"token": "other"})
    is_problem(other, 409, "arm-token-other")
    is_problem(client.post(f"{address}/arm", headers=headers), 422, "validation")
    assert "begin" not in make_cell.cell.heard
    assert client.post(f"{address}/arm", headers=headers, json=body).status_code == 202
    again = client.post(f"{address}/arm", headers=headers, json=body)
    is_problem(again, 409, "illegal-transition")


def test_a_token_that_is_no_longer_good_is_a_problem(
    client, ready, is_problem, monkeypatch
):
    for error, code in (
        (ArmTokenExpired, "arm-token-expired"),
        (ArmTokenUsed, "arm-token-used"),
    ):

        def refuse(*_, error=error):
            raise error("it is not good any more")

        monkeypatch.setattr(ArmTokens, "use", refuse)
        is_problem(arm_over_http(client, ready), 409, code)


def test_pause_and_resume(client, armed, until):
    address = f"{JOBS}/{armed['id']}"
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


def test_a_job_that_stands_or_failed_says_why(armed, make_cell, until):
    make_cell.cell.fault("beam-lost", "the beam is lost", "lock it, then press Resume")
    make_cell.cell.say_state("paused")
    error = until(armed, "paused")["error"]
    assert error["code"] == "beam-lost"
    assert error["type"] == "/problems/beam-lost"
    assert error["detail"] == "the beam is lost"
    assert error["action"] == "lock it, then press Resume"
    make_cell.cell.fault("motion-alarm", "servo alarm", "clear it")
    make_cell.cell.end("faulted")
    error = until(armed, "faulted")["error"]
    assert (error["code"], error["detail"], error["action"]) == (
        "motion-alarm",
        "servo alarm",
        "clear it",
    )
    assert error["status"] is None


@pytest.mark.parametrize("verb", ["abort", "stop"])
def test_abort_and_stop_need_nothing(client, armed, until, verb, make_cell):
    address = "/api/v1/stop" if verb == "stop" else f"{JOBS}/{armed['id']}/abort"
    answer = client.post(address)
    assert answer.status_code == 202
    if verb == "stop":
        reached = [(job["id"], job["desired_state"]) for job in answer.json()["jobs"]]
        assert reached == [(armed["id"], "aborted")]
    until(armed, "aborted")
    assert "abort" in make_cell.cell.heard
    form = {"why": "no script runs"}  # of the page
    assert client.post(address, data=form).status_code == 202


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


def test_what_does_not_go_with_a_job_that_waits_is_refused(
    client, ready, order, service, is_problem
):
    assert ready["verdict"] is None
    problem = is_problem(client.post(JOBS, json=order), 409, "busy")
    assert problem["current_job"] == f"{JOBS}/{ready['id']}"
    assert client.get("/api/v1/system").json()["current_job"] == ready["id"]
    answer = client.post(f"{JOBS}/{ready['id']}/pause")
    problem = is_problem(answer, 409, "illegal-transition")
    assert "cannot pause a job that is ready" in problem["detail"]
    results = "/result", "/result/error-tables.json", "/result/report.html"
    for path in (*results, "/result/volumetric-map", "/result/volumetric-error"):
        answer = client.get(f"{JOBS}/{ready['id']}{path}")
        detail = is_problem(answer, 404, "not-found")["detail"]
        assert path not in results or "ready) has no" in detail
    address = f"{JOBS}/{ready['id']}/compensations"
    assert client.get(address).json() == {"items": []}
    is_problem(client.post(address, json={"format": "linuxcnc"}), 404, "not-found")
    folder = service.results / ready["id"]  # left by a job that has not succeeded
    folder.mkdir()
    (folder / "result.json").write_text('{"half": "made"')
    answer = client.get(f"{JOBS}/{ready['id']}/result")
    assert "ready) has no" in is_problem(answer, 404, "not-found")["detail"]


def test_an_unknown_job_or_run_is_not_found(client, is_problem):
    paths = "", "/plan", "/events", "/result", "/result/error-tables.json"
    for path in (*paths, "/result/error-tables.csv", "/result/report.html"):
        is_problem(client.get(UNKNOWN + path), 404, "not-found")
    for verb in ("arming", "arm", "pause", "resume", "abort"):
        headers, body = {"If-Match": '"1"'}, {"token": "of nobody"}
        answer = client.post(f"{UNKNOWN}/{verb}", headers=headers, json=body)
        is_problem(answer, 404, "not-found")
    order = {"kind": "analyse", "run_id": "nowhere"}
    is_problem(client.post(JOBS, json=order), 404, "not-found")


def test_jobs_are_found_in_pages_by_state_kind_and_time(client, order, take, until):
    jobs = []
    for _ in range(3):
        job = take("ready", **order)
        client.post(f"{JOBS}/{job['id']}/abort")
        jobs.append(until(job, "aborted"))
    ids, middle = [job["id"] for job in jobs], jobs[1]["created"]
    first = client.get(f"{JOBS}?limit=2&state=aborted")
    assert first.headers["link"].endswith('>; rel="next"')
    address = first.headers["link"][1:].partition(">")[0]
    assert "state=aborted" in address
    second = client.get(address)
    assert "link" not in second.headers
    assert second.json()["next"] is None
    found = [job["id"] for page in (first, second) for job in page.json()["items"]]
    assert found == ids[::-1]

    def find(**query):
        items = client.get(JOBS, params=query).json()["items"]
        return [item["id"] for item in items][::-1]

    assert find(state="ready") == find(kind=["plan", "trend"]) == []
    assert find(kind=order["kind"]) == ids
    assert find(since=middle) == ids[1:]
    assert find(until=middle) == ids[:1]
    shifted = datetime.fromisoformat(middle).astimezone(timezone(timedelta(hours=5)))
    assert find(since=shifted.isoformat()) == ids[1:]


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [
        (StorageUnavailable("the catalogue is locked"), 503, "storage"),
        (KeyError("the password is secret"), 500, "internal-error"),
    ],
    ids=["the catalogue is away", "nobody foresaw it"],
)
def test_what_is_no_fault_of_the_client_is_a_problem_that_tells_no_secrets(
    client, is_problem, service, error, status, code
):
    def broken(*_):
        raise error

    service.store.get = broken
    answer = client.get(UNKNOWN)
    problem = is_problem(answer, status, code)
    assert ("Try again" in problem["action"]) == (code == "storage")
    assert "secret" not in answer.text
    assert problem["request_id"]


def test_a_failure_nobody_foresaw_tells_nothing_but_that(
    armed, make_cell, until, science
):
    science.raises = KeyError("secret")
    make_cell.cell.end()
    error = until(armed, "failed")["error"]
    assert error["code"] == "internal-error"
    assert "secret" not in str(error)


@pytest.mark.parametrize("reasons", [(), (OPEN,), (OPEN, BEYOND)])
def test_a_result_states_its_verdict_and_what_is_not_to_be_used_has_to_be_accepted(
    client, armed, make_cell, until, science, is_problem, reasons
):
    science.verdict = verdict = Verdict(reasons)
    make_cell.cell.end()
    job = until(armed, "succeeded")
    (listed,) = client.get(JOBS).json()["items"]
    assert job["verdict"] == listed["verdict"] == verdict.state
    tables = client.get(job["result"]["error_tables_json"]).json()
    assert tables["verdict"] == verdict_json(verdict)
    assert client.get(job["result"]["result"]).json()["verdict"] == tables["verdict"]
    address = job["result"]["error_tables_csv"]
    if BEYOND in reasons:
        refusal = is_problem(client.get(address), 422, "not-usable")
        assert "is not to be used: " in refusal["detail"]
        assert str(OPEN) in refusal["detail"]
        assert str(BEYOND) in refusal["detail"]
        assert "accept_verdict=true" in refusal["action"]
        address += "?accept_verdict=true"
    accepted = client.get(address)
    assert accepted.status_code == 200
    assert accepted.text.startswith("error,position_mm")


def test_a_result_of_an_earlier_version_says_nothing_against_itself(
    client, service, finished
):
    file = service.results / finished["id"] / "result.json"
    file.write_text('{"machine": {}, "error_tables": {}, "squareness_urad": {}}')
    tables = client.get(finished["result"]["error_tables_json"]).json()
    assert tables["verdict"]["state"] == "usable"
    assert client.get(finished["result"]["error_tables_csv"]).status_code == 200
