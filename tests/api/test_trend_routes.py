"""A machine over time over REST: job, answer, and Runs that are refused."""

from __future__ import annotations

import json

import pytest
from scripted_cell import wait_until

from truepath_simulators.scenario import load_machine

JOBS = "/api/v1/jobs"


def stream(begin_s, count=100):
    rows = "".join(f"{begin_s + n / 500:.3f},{n},0,0\n" for n in range(count))
    return "t_s,x_mm,y_mm,z_mm\n" + rows


@pytest.fixture
def upload(client, bundle):
    """Take in a Run that begins at some time of the tracker's clock."""

    def taken(begin_s=0.0, name="mill.zip", **members):
        packed = bundle(tracker_csv=stream(begin_s), **members)
        answer = client.post("/api/v1/runs", files={"bundle": (name, packed)})
        assert answer.status_code == 201, answer.text
        return answer.json()["id"]

    return taken


@pytest.fixture
def ask(client):
    def asked(*run_ids, **more):
        order = {"kind": "trend", "run_ids": list(run_ids), **more}
        return client.post(JOBS, json=order)

    return asked


def test_a_trend_links_to_its_answer_and_report(client, upload, ask, follower):
    runs = upload(0.0), upload(3600.0)
    asked = {"limit_um": 5.0, "later_h": [1.0], "temperature_degC": {"X": 21.5}}
    answer = ask(*runs, **asked)
    assert answer.status_code == 202, answer.text
    at = answer.headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "succeeded")
    job = client.get(at).json()
    assert (job["run_ids"], job["verdict"]) == (list(runs), "usable")
    assert job["result"] is None
    assert client.get(job["trend"]["trend"]).json()["schema"] == "trend/1"
    report = client.get(job["trend"]["report_html"])
    assert report.headers["content-type"].startswith("text/html")
    assert "sandbox" in report.headers["content-security-policy"]
    ((files, names, told),) = follower.calls
    assert (len(files), names) == (2, ["mill", "mill"])
    assert {key: told[key] for key in asked} == asked


def test_the_same_run_twice_is_refused_by_its_content(upload, ask, is_problem):
    first = upload(0.0, "monday.zip")
    again = upload(0.0, "tuesday.zip")
    said = is_problem(ask(first, again, at_h=[0, 1]), 422, "bad-input")["detail"]
    assert "monday (" in said
    assert "tuesday (" in said
    assert "same Run" in said
    is_problem(ask(first, first, at_h=[0, 1]), 422, "validation")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": "lathe"}, "name"),
        ({"tool_offset_mm": [0.0, 0.0, -151.0]}, "another tool"),
        ({"X": 450.0}, "axes.X.max_mm"),
    ],
)
def test_runs_of_different_machines_are_refused(upload, ask, is_problem, change, field):
    machine = json.loads(json.dumps(load_machine("demo")))
    if "X" in change:
        machine["axes"]["X"]["max_mm"] = change["X"]
    else:
        machine |= change
    runs = upload(0.0), upload(3600.0, machine_json=json.dumps(machine))
    answer = ask(*runs)
    assert answer.status_code == 422, answer.text
    assert field in answer.json()["detail"]


def test_runs_whose_order_of_time_is_not_known_are_refused(upload, ask, is_problem):
    early, anew = upload(5.0), upload(0.0)
    assert "at_h" in is_problem(ask(early, anew), 422, "bad-input")["detail"]
    assert ask(early, anew, at_h=[8.0, 9.5]).status_code == 202
    for times, said in (([8.0], "1 times"), ([9.5, 8.0], "do not increase")):
        problem = is_problem(ask(early, anew, at_h=times), 422, "bad-input")
        assert said in problem["detail"]


def test_what_is_not_of_a_trend_is_refused(upload, ask, is_problem):
    run = upload()
    is_problem(ask(run), 422, "validation")
    is_problem(ask(run, "no-such-run"), 404, "not-found")
    is_problem(ask(run, "other", target_um=1.0), 422, "validation")
    is_problem(ask(run, "other", horizon_h=0), 422, "validation")
