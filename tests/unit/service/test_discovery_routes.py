"""Discovery and models over REST, and what rests on a model."""

import pytest

from truepath.files.earlier.verdict import Reason, Verdict

pytestmark = pytest.mark.database
JOBS, MODELS, PLANS = "/api/v1/jobs", "/api/v1/models", "/api/v1/plans"
NOBODY = "0190a1b2-0000-7000-8000-000000000000"


@pytest.fixture
def discover(take, run):
    return lambda **more: take(kind="discover", run_id=run["id"], **more)


def test_a_discovery_has_a_model(client, run, discover, take, is_problem, science):
    job = discover()
    assert job["result"] is None
    report = client.get(job["discovery"]["report_html"])
    assert "sandbox" in report.headers["content-security-policy"]
    is_problem(client.get(f"{JOBS}/{job['id']}/result"), 404, "not-found")
    extra = {"kind": "measure-extra", "discovery_id": job["id"]}
    problem = is_problem(client.post(JOBS, json=extra), 422, "plan")
    assert "asks for no extra lines" in problem["detail"]
    order = {"kind": "analyse", "run_id": run["id"]}
    analysed = take(**order)["id"]
    is_problem(client.get(f"{JOBS}/{analysed}/discovery"), 404, "not-found")
    is_problem(client.get(f"{MODELS}/{analysed}"), 404, "not-found")
    for named in (job["id"], analysed):
        take(**order, model_id=named)
    without, (file, name), (result, _) = science.models
    assert (without, name) == ((None, None), job["id"])
    assert file.endswith(f"{job['id']}/model.json")
    assert result.endswith(f"{analysed}/result.json")


def test_models_are_listed_with_what_they_came_from(client, discover, is_problem):
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
    chain = client.get(f"{MODELS}/{second}/versions").json()
    assert [(m["id"], m["version"]) for m in chain] == [(second, 3), (first, 2)]
    told = client.get(f"{MODELS}/{second}/difference").json()
    assert (told["before"], told["after"]) == (first, second)
    assert told["changes"][0]["kind"] == "added"
    other = {"against": "no-such-job"}
    answer = client.get(f"{MODELS}/{second}/difference", params=other)
    is_problem(answer, 404, "not-found")


def test_what_names_no_run_discovery_or_model_is_not_found(client, run, is_problem):
    for order in (
        {"kind": "discover", "run_id": "no-such-run"},
        {"kind": "discover", "run_id": run["id"], "model_id": NOBODY},
        {"kind": "measure-extra", "discovery_id": "no-such-job"},
        {"kind": "analyse", "run_id": run["id"], "model_id": NOBODY},
        {"kind": "measure-otf", "model_id": NOBODY},
        {"kind": "measure-adaptive", "model_id": NOBODY},
    ):
        is_problem(client.post(JOBS, json=order), 404, "not-found")
    is_problem(client.post(PLANS, json={"model_id": NOBODY}), 404, "not-found")
    is_problem(client.get(f"{MODELS}/no-such-job"), 404, "not-found")
    assert client.get(JOBS).json()["items"] == []


def test_a_bad_model_steers_nothing(client, run, discover, explorer, is_problem):
    explorer.verdict = Verdict((Reason("stated", "not-usable", {"text": "Odd."}),))
    refused = discover()
    assert refused["verdict"] == "not-usable"
    (listed,) = client.get(MODELS).json()["items"]
    assert listed["verdict"] == "not-usable"
    stated = client.get(refused["discovery"]["discovery"]).json()["verdict"]
    assert stated["reasons"] == ["Odd."]
    use = {"model_id": refused["id"]}
    for kind in ("measure-otf", "measure-standstill", "measure-adaptive"):
        is_problem(client.post(JOBS, json={"kind": kind, **use}), 422, "not-usable")
    order = {"kind": "discover", "run_id": run["id"], **use}
    is_problem(client.post(JOBS, json=order), 422, "not-usable")
    order = {"mode": "otf", "minutes": 0.5, **use}
    is_problem(client.post(PLANS, json=order), 422, "not-usable")


def test_plans_and_jobs_keep_their_model(client, discover, until, service, plan_orders):
    model = discover()["id"]
    order = {"mode": "otf", "minutes": 0.5, "model_id": model}
    made = until(client.post(PLANS, json=order).json(), "succeeded")
    assert client.get(f"{PLANS}/{made['id']}").json()["request"]["model_id"] == model
    (asked,) = plan_orders
    assert asked["model_file"].endswith(f"{model}/model.json")
    for kind in ("measure-otf", "measure-standstill", "measure-adaptive"):
        answer = client.post(JOBS, json={"kind": kind, "model_id": model})
        assert answer.status_code == 202, answer.text
        job = answer.json()
        assert service.store.read_plan_request(job["id"])["model_id"] == model
        client.post(f"{JOBS}/{job['id']}/abort")
        until(job, "aborted", "failed")
    order = {"kind": "measure-adaptive", "planning": {"model_id": model}}
    assert client.post(JOBS, json=order).status_code == 422  # named once
