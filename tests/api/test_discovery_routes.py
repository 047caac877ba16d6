"""Discovery and models over REST."""

from __future__ import annotations

import pytest
from arming import arm_over_http
from scripted_cell import wait_until

JOBS, MODELS = "/api/v1/jobs", "/api/v1/models"


@pytest.fixture
def run(client, bundle):
    return client.post("/api/v1/runs", files={"bundle": ("mill.zip", bundle())}).json()


@pytest.fixture
def discover(client, run):
    """Make a discovery and wait for its end."""

    def made(**more):
        order = {"kind": "discover", "run_id": run["id"], **more}
        answer = client.post(JOBS, json=order)
        assert answer.status_code == 202, answer.text
        at = answer.headers["Location"]
        wait_until(lambda: client.get(at).json()["state"] == "succeeded")
        return client.get(at).json()

    return made


def test_a_discovery_links_to_its_answer_report_and_model(client, discover):
    job = discover()
    assert job["result"] is None
    links = job["discovery"]
    found = client.get(links["discovery"])
    assert found.json()["schema"] == "discovery/1"
    report = client.get(links["report_html"])
    assert report.headers["content-type"].startswith("text/html")
    assert "sandbox" in report.headers["content-security-policy"]
    assert client.get(links["model"]).json()["version"] == 2


def test_other_jobs_have_no_discovery_and_a_discovery_no_tables(
    client, run, discover, is_problem
):
    job = discover()
    is_problem(client.get(f"{JOBS}/{job['id']}/result"), 404, "not-found")
    order = {"kind": "analyse", "run_id": run["id"]}
    analysed = client.post(JOBS, json=order).json()["id"]
    wait_until(lambda: client.get(f"{JOBS}/{analysed}").json()["state"] == "succeeded")
    is_problem(client.get(f"{JOBS}/{analysed}/discovery"), 404, "not-found")
    is_problem(client.get(f"{MODELS}/{analysed}"), 404, "not-found")


def test_models_are_listed_newest_first_with_what_they_added(client, discover):
    first = discover()["id"]
    second = discover(model_id=first)["id"]
    page = client.get(MODELS, params={"limit": 1})
    (newest,) = page.json()["items"]
    assert (newest["id"], newest["version"]) == (second, 3)
    assert newest["parent"] == {"version": 2, "source": first, "sha256": None}
    assert newest["difference"][0]["text"].startswith("backlash X")
    assert page.links["next"]["url"]
    rest = client.get(MODELS, params={"limit": 1, "after": page.json()["next"]})
    assert [m["id"] for m in rest.json()["items"]] == [first]


def test_a_model_knows_the_versions_it_came_from(client, discover):
    first = discover()["id"]
    second = discover(model_id=first)["id"]
    chain = client.get(f"{MODELS}/{second}/versions").json()
    assert [(m["id"], m["version"]) for m in chain] == [(second, 3), (first, 2)]
    told = client.get(f"{MODELS}/{second}/difference").json()
    assert (told["before"], told["after"]) == (first, second)
    assert told["changes"][0]["kind"] == "added"


ROWS = [
    {"x_mm": 10.0, "y_mm": 10.0, "z_mm": 10.0, "feed_mm_min": 6000.0, "dwell_s": 0.35},
    {"x_mm": 400.0, "y_mm": 10.0, "z_mm": 10.0, "feed_mm_min": 900.0, "dwell_s": 0.35},
]


def test_extra_lines_end_with_a_discovery_and_a_model_of_their_own(
    client, run, discover, explorer, until, make_cell
):
    explorer.rows = ROWS
    first = discover()
    order = {"kind": "measure-extra", "discovery_id": first["id"]}
    job = until(client.post(JOBS, json=order).json(), "ready")
    plan = client.get(job["links"]["plan"]).json()
    assert plan["position"][1] == [400.0, 10.0, 10.0]
    assert plan["discovery_id"] == first["id"]
    arm_over_http(client, job)
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    job = until(job, "succeeded")
    assert job["result"] is None
    assert job["run_ids"] == [run["id"], job["run_id"]]
    assert client.get(job["discovery"]["discovery"]).json()["effects"]
    listed = [m["id"] for m in client.get(MODELS).json()["items"]]
    assert listed == [job["id"], first["id"]]


def test_extra_lines_that_nobody_asks_for_are_refused(client, discover, is_problem):
    def asked(**order):
        return client.post(JOBS, json={"kind": "measure-extra", **order})

    is_problem(asked(), 422, "validation")
    is_problem(asked(discovery_id="no-such-job"), 404, "not-found")
    nothing = discover()["id"]
    problem = is_problem(asked(discovery_id=nothing), 422, "plan")
    assert "asks for no extra lines" in problem["detail"]
    lines = {"discovery_id": nothing, "path": ROWS}
    is_problem(asked(**lines), 422, "validation")


def test_what_cannot_be_is_refused(client, run, discover, is_problem):
    def asked(**order):
        return client.post(JOBS, json={"kind": "discover", **order})

    is_problem(asked(), 422, "validation")
    is_problem(asked(run_id=run["id"], target_um=1.0), 422, "validation")
    is_problem(asked(run_id=run["id"], model_id="no-such-job"), 404, "not-found")
    is_problem(asked(run_id="no-such-run"), 404, "not-found")
    is_problem(client.get(f"{MODELS}/no-such-job"), 404, "not-found")
    model = discover()["id"]
    other = {"against": "no-such-job"}
    address = f"{MODELS}/{model}/difference"
    is_problem(client.get(address, params=other), 404, "not-found")
