"""Many Runs over REST: a machine over time, and analyses that are made again."""

import json

import pytest

from truepath_simulators.scenario import load_machine

pytestmark = pytest.mark.database
JOBS = "/api/v1/jobs"


@pytest.fixture
def upload_at(upload):
    """Take in a Run that begins at some time of the tracker's clock."""

    def taken(begin_s, name="mill.zip", **members):
        rows = "".join(f"{begin_s + n / 500:.3f},{n},0,0\n" for n in range(100))
        return upload(name, tracker_csv="t_s,x_mm,y_mm,z_mm\n" + rows, **members)["id"]

    return taken


@pytest.fixture
def ask(client):
    order = {"kind": "trend"}
    return lambda *ids, **more: client.post(JOBS, json=order | {"run_ids": ids} | more)


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


def test_runs_without_a_trend_make_no_job(upload_at, ask, is_problem):
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
