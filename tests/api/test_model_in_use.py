"""Analyses, measurements and plans that rest on a model of the machine."""

from __future__ import annotations

import pytest
from scripted_cell import wait_until

from truepath.files.bundle.commanded_file import encode_commanded_json
from truepath.files.bundle.machine_file import machine_to_json
from truepath.files.earlier.verdict import Reason, Verdict
from truepath.planning.lines.default_path import default_path

JOBS, PLANS = "/api/v1/jobs", "/api/v1/plans"
NOBODY = "0190a1b2-0000-7000-8000-000000000000"


@pytest.fixture
def orders():
    """What has been asked of the planner."""
    return []


@pytest.fixture
def planner(orders):
    """Note what is asked, and plan the usual path."""

    def plan(machine, order, *, on_progress):
        orders.append(dict(order))
        rows = encode_commanded_json(default_path(machine))
        document = {"machine": machine_to_json(machine)}
        return {**rows, "predicted_um": 1.0, "document": document}

    return plan


@pytest.fixture
def run(client, bundle):
    return client.post("/api/v1/runs", files={"bundle": ("mill.zip", bundle())}).json()


def done(client, order):
    """Take on a job and wait for its end."""
    answer = client.post(JOBS, json=order)
    assert answer.status_code == 202, answer.text
    at = answer.headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "succeeded")
    return client.get(at).json()["id"]


@pytest.fixture
def model(client, run):
    """A model that a discovery has made."""
    return done(client, {"kind": "discover", "run_id": run["id"]})


def test_an_analysis_takes_the_model_that_it_names(client, run, model, science):
    done(client, {"kind": "analyse", "run_id": run["id"]})
    done(client, {"kind": "analyse", "run_id": run["id"], "model_id": model})
    without, (file, name) = science.models
    assert without == (None, None)
    assert name == model
    assert file.endswith(f"{model}/model.json")


@pytest.fixture
def refused(client, run, explorer):
    """A model that is not to be used."""
    explorer.verdict = Verdict((Reason("stated", "not-usable", {"text": "Odd."}),))
    model = done(client, {"kind": "discover", "run_id": run["id"]})
    explorer.verdict = Verdict()
    return model


def test_the_verdict_of_a_discovery_stands_in_its_job_and_its_model(client, refused):
    assert client.get(f"{JOBS}/{refused}").json()["verdict"] == "not-usable"
    (listed,) = client.get("/api/v1/models").json()["items"]
    assert listed["verdict"] == "not-usable"
    stated = client.get(f"{JOBS}/{refused}/discovery").json()["verdict"]
    assert stated["reasons"] == ["Odd."]


def test_a_model_that_is_not_to_be_used_steers_no_job(client, run, refused, is_problem):
    for kind in ("measure-otf", "measure-standstill", "measure-adaptive", "discover"):
        order = {"kind": kind, "model_id": refused}
        if kind == "discover":
            order["run_id"] = run["id"]
        is_problem(client.post(JOBS, json=order), 422, "not-usable")
    order = {"mode": "otf", "minutes": 0.5, "model_id": refused}
    is_problem(client.post(PLANS, json=order), 422, "not-usable")


def test_a_result_serves_as_a_model(client, run, science):
    first = done(client, {"kind": "analyse", "run_id": run["id"]})
    done(client, {"kind": "analyse", "run_id": run["id"], "model_id": first})
    assert science.models[-1][0].endswith(f"{first}/result.json")


def test_a_plan_is_made_for_the_model_that_it_names(client, model, orders):
    order = {"mode": "otf", "minutes": 0.5, "model_id": model}
    at = client.post(PLANS, json=order).headers["location"]
    wait_until(lambda: client.get(at).json()["state"] == "succeeded")
    assert client.get(at).json()["request"]["model_id"] == model
    (asked,) = orders
    assert asked["model_file"].endswith(f"{model}/model.json")


@pytest.mark.parametrize(
    "order",
    [
        {"kind": "measure-otf"},
        {"kind": "measure-standstill"},
        {"kind": "measure-adaptive"},
    ],
    ids=lambda order: order["kind"],
)
def test_a_measurement_keeps_the_model_for_its_analysis(client, model, service, order):
    answer = client.post(JOBS, json={**order, "model_id": model})
    assert answer.status_code == 202, answer.text
    job = answer.json()["id"]
    assert service.store.read_plan_request(job)["model_id"] == model
    client.post(f"{JOBS}/{job}/abort")


@pytest.mark.parametrize("kind", ["analyse", "measure-otf", "measure-adaptive"])
def test_a_model_that_is_not_there_is_not_found(client, run, is_problem, kind):
    order = {"kind": kind, "model_id": NOBODY}
    if kind == "analyse":
        order["run_id"] = run["id"]
    is_problem(client.post(JOBS, json=order), 404, "not-found")
    is_problem(client.post(PLANS, json={"model_id": NOBODY}), 404, "not-found")


def test_the_model_of_an_adaptive_measurement_is_named_once(client, model):
    order = {"kind": "measure-adaptive", "planning": {"model_id": model}}
    assert client.post(JOBS, json=order).status_code == 422
