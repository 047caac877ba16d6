"""Jobs over REST: from the order to the result, and what a waiting job gives."""

from datetime import datetime, timedelta, timezone
from unittest.mock import Mock

import numpy as np
import pytest

from api_builders import arm_over_http
from scripted_cell import wait_until
from truepath.catalogue.errors import StorageUnavailable
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.measurement.messages import PartRequested
from truepath.motion.nc_programs.programs import read_program
from truepath.planning.adaptive_plan import Part
from truepath_drivers.interfaces.records import Path

pytestmark = pytest.mark.database
JOBS = "/api/v1/jobs"
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})
UNKNOWN = f"{JOBS}/019a0000-0000-7000-8000-000000000000"


def test_a_job_has_an_address_and_is_one_for_a_key(client, order, until, is_problem):
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
    counted = {"lost_samples": 0, "crc_errors": 0, "gaps": 0, "repeats": 0}
    assert finished["health"] == {"samples": 50, **counted}
    assert (finished["machine"], finished["machine_version"]) == ("default", 1)
    links = finished["result"]
    tables = client.get(links["error_tables_json"]).json()
    assert (*tables["error_tables"], *tables["squareness_urad"]) == ("EXX", "C0Y")
    csv = client.get(links["error_tables_csv"])
    assert csv.text.startswith("error,position_mm")
    assert 'filename="error_tables.csv"' in csv.headers["content-disposition"]
    run = client.get(finished["links"]["run"]).json()
    assert (run["origin"], run["samples"], run["complete"]) == ("measured", 50, True)
    assert client.get(run["links"]["bundle"]).content.startswith(b"PK")
    policy = client.get(links["report_html"]).headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts")
    assert "default-src 'none'" in policy


@pytest.mark.parametrize("verb", ["arm", "resume"])
def test_motion_needs_the_version_read(client, ready, is_problem, make_cell, verb):
    address, body = f"{JOBS}/{ready['id']}/{verb}", {"token": "of nobody"}
    for headers in ({}, {"If-Match": "*"}):
        is_problem(client.post(address, headers=headers), 428, "version-required")
    odd = client.post(address, headers={"If-Match": '"three"'})
    is_problem(odd, 412, "stale-version")
    for tag in (f'W/"{ready["version"]}"', '"1"'):
        stale = client.post(address, headers={"If-Match": tag}, json=body)
        problem = is_problem(stale, 412, "stale-version")
    assert problem["current_version"] == ready["version"]
    assert "begin" not in make_cell.cell.heard


def test_what_a_waiting_job_lacks_is_refused(client, ready, order, service, is_problem):
    assert ready["verdict"] is None
    problem = is_problem(client.post(JOBS, json=order), 409, "busy")
    assert problem["current_job"] == f"{JOBS}/{ready['id']}"
    assert client.get("/api/v1/system").json()["current_job"] == ready["id"]
    answer = client.post(f"{JOBS}/{ready['id']}/pause")
    problem = is_problem(answer, 409, "illegal-transition")
    assert "cannot pause a job that is ready" in problem["detail"]
    for path in ("error-tables.json", "report.html", "volumetric-map"):
        is_problem(client.get(f"{JOBS}/{ready['id']}/result/{path}"), 404, "not-found")
    address = f"{JOBS}/{ready['id']}/compensations"
    assert client.get(address).json() == {"items": []}
    is_problem(client.post(address, json={"format": "linuxcnc"}), 404, "not-found")
    folder = service.results / ready["id"]  # left by a job that has not succeeded
    folder.mkdir()
    (folder / "result.json").write_text('{"half": "made"')
    answer = client.get(f"{JOBS}/{ready['id']}/result")
    assert "ready) has no" in is_problem(answer, 404, "not-found")["detail"]


def test_an_unknown_job_is_not_found(client, is_problem):
    paths = "", "/plan", "/events", "/result", "/result/error-tables.json"
    for path in (*paths, "/result/error-tables.csv", "/result/report.html"):
        is_problem(client.get(UNKNOWN + path), 404, "not-found")
    for verb in ("arming", "arm", "pause", "resume", "abort"):
        headers, body = {"If-Match": '"1"'}, {"token": "of nobody"}
        answer = client.post(f"{UNKNOWN}/{verb}", headers=headers, json=body)
        is_problem(answer, 404, "not-found")


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


def test_what_nobody_foresaw_is_a_problem_of_job_or_request_that_tells_no_secrets(
    client, armed, make_cell, until, science, service, is_problem
):
    science.raises = KeyError("secret")
    make_cell.cell.end()
    job = until(armed, "failed")
    assert job["error"]["code"] == "internal-error"
    assert "secret" not in str(job["error"])
    assert client.get(job["links"]["run"]).json()["complete"]
    for error, status, code in (
        (StorageUnavailable("the catalogue is locked"), 503, "storage"),
        (KeyError("the password is secret"), 500, "internal-error"),
    ):
        service.store.get = Mock(side_effect=error)
        answer = client.get(UNKNOWN)
        problem = is_problem(answer, status, code)
        assert ("Try again" in problem["action"]) == (code == "storage")
        assert "secret" not in answer.text
        assert problem["request_id"]


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
        for said in ("is not to be used: ", str(OPEN), str(BEYOND)):
            assert said in refusal["detail"]
        assert "accept_verdict=true" in refusal["action"]
        address += "?accept_verdict=true"
    assert client.get(address).text.startswith("error,position_mm")


@pytest.fixture
def growing(client, take, make_cell):
    """A job that is planned while its machine moves; it was armed once."""
    planning = {"mode": "otf", "minutes": 5}
    job = take("ready", kind="measure-adaptive", target_um=2.0, planning=planning)
    assert "begin" not in make_cell.cell.heard
    assert arm_over_http(client, job).status_code == 202
    assert make_cell.cell.begun.wait(5)
    return job


def asked(cell, estimates):
    cell.say(PartRequested(0))
    wait_until(lambda: "request_part" in estimates[-1].heard, "the question")


def test_a_job_goes_on_with_the_part_that_the_estimate_asks_for(
    client, growing, make_cell, estimates, service, until
):
    told, cell = [], make_cell.cell
    service.event_bus.subscribe(told.append)
    assert cell.order.grows
    request = estimates[-1].order.request
    assert (request["mode"], request["minutes"]) == ("otf", 5.0)
    first = cell.order.commanded
    asked(cell, estimates)
    position = np.outer([1.0, 0.5, 0.25], first.position[-1])
    path = Path(first.axes, position, np.full(3, 6000.0), np.full(3, 0.4))
    estimates[-1].parts.append(Part(path, 2, 9.5, 1.1e-3))
    wait_until(lambda: cell.parts, "the part")
    np.testing.assert_array_equal(cell.parts[0].position[0], first.position[-1])
    address = f"{JOBS}/{growing['id']}/plan"
    grown = len(first) + 2
    wait_until(lambda: len(client.get(address).json()["position"]) == grown, "rows")
    (body,) = [notice.body for notice in told if notice.type == "plan"]
    times = {"duration_s": 9.5, "predicted_um": 1.1}
    assert body == {"part": 2, "rows": 2, "total": grown - 1, **times}
    estimate = f"{JOBS}/{growing['id']}/estimate"
    assert client.get(estimate).status_code == 204, "there is none yet"
    estimates[-1].publish(2.5, done=8)
    assert client.get(estimate).json()["course"]["done"] == [8]
    estimates[-1].publish(1.9, done=9)
    assert until(growing, "succeeded")["early_end"]["reached_um"] == 1.9
    assert cell.heard[-1] == "conclude"


@pytest.mark.parametrize("is_over", [False, True])
def test_a_job_without_a_part_ends(growing, make_cell, estimates, until, is_over):
    cell, estimates[-1].is_over = make_cell.cell, is_over
    asked(cell, estimates)
    if not is_over:
        estimates[-1].parts.append(Part(None))
    assert until(growing, "succeeded")["early_end"] is None
    assert cell.heard[-1] == "conclude"


def at(job_id, what):
    return f"/api/v1/jobs/{job_id}/{what}"


def test_a_ready_job_has_a_grade_and_programs(client, ready, run, take, is_problem):
    address = at(ready["id"], "plan/grade")
    grade = client.get(address).json()
    assert grade["tracker"]["assumed"] is True
    assert grade["tracker"]["best_number"] <= grade["number"]
    expected = grade["number"] * grade["sample_sigma_um"]
    assert grade["expected_uncertainty_um"] == pytest.approx(expected)
    assert client.get(f"/api/v1/jobs/{ready['id']}").json()["state"] == "ready"
    near, far = (
        client.get(address, params={"tracker_mm": place}).json()
        for place in ([900.0, 0.0, 0.0], [9000.0, 0.0, 0.0])
    )
    place = {"position_mm": [900.0, 0.0, 0.0], "assumed": False}
    assert near["tracker"] == {**place, "best_number": near["number"]}
    assert far["expected_uncertainty_um"] > near["expected_uncertainty_um"]
    half = client.get(address, params={"tracker_mm": [1.0, 2.0]})
    is_problem(half, 422, "validation")
    plan = client.get(at(ready["id"], "plan")).json()
    programs = at(ready["id"], "nc-program")
    for item in client.get("/api/v1/nc-dialects").json()["items"]:
        answer = client.get(programs, params={"dialect": item["name"]})
        motion = read_program(answer.text, item["name"])
        np.testing.assert_allclose(motion.position, plan["position"])
        np.testing.assert_allclose(motion.feed_mm_min, plan["feed_mm_min"])
        named = f'attachment; filename="{motion.name}.'
        assert answer.headers["content-disposition"].startswith(named)
    problem = client.get(programs, params={"dialect": "mazatrol"})
    said = is_problem(problem, 422, "bad-input")["detail"]
    assert "fanuc, heidenhain, linuxcnc, siemens-840d" in said
    analysed = take(kind="analyse", run_id=run["id"])["id"]
    is_problem(client.get(at(analysed, "plan/grade")), 404, "not-found")
    for job_id in (analysed, "nowhere"):
        answer = client.get(at(job_id, "nc-program"), params={"dialect": "fanuc"})
        is_problem(answer, 404, "not-found")


def test_effects_are_listed_in_the_words_of_a_language(client):
    for language, title in (("en", "Backlash"), ("de", "Umkehrspiel")):
        answer = client.get("/api/v1/effects", params={"language": language})
        found = {one["name"]: one for one in answer.json()["items"]}
        assert found["backlash"]["title"] == title
        assert found["backlash"]["enters_analyse"]
        assert not found["table-drift"]["enters_analyse"]
    assert client.get("/api/v1/effects?language=fr").status_code == 422
