"""Many Runs analysed again over REST and by the command line."""

from __future__ import annotations

import json

import pytest
from scripted_cell import wait_until

from truepath.cli.command import run
from truepath.jobs.workers.reanalysis import keep_outcome

JOBS = "/api/v1/jobs"


@pytest.fixture
def service(service):
    """Its Runs are analysed in no time."""

    def analyse(order, perpendicular_only, *, on_progress):
        after = {"verdict": "usable", "volumetric_error_um": 5, "uncertainty_um": 1}
        keep_outcome(order, after=after)
        folder = service.results / order.folder
        (folder / "result.json").write_text('{"schema": "result/1"}')

    object.__setattr__(service.dispatcher._context, "reanalyser", analyse)
    return service


@pytest.fixture
def run_ids(client, bundle):
    def send(number):
        files = {"bundle": (f"run-{number}.zip", bundle())}
        return client.post("/api/v1/runs", files=files).json()["id"]

    return [send(number) for number in range(2)]


def test_a_reanalysis_links_to_its_summary_and_results(client, run_ids):
    answer = client.post(JOBS, json={"kind": "reanalyse", "run_ids": run_ids})
    assert answer.status_code == 202, answer.text
    at = answer.headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "succeeded", "the end")
    job = client.get(at).json()
    assert job["progress"]["unit"] == "runs"
    summary = client.get(job["reanalysis"]["reanalysis"]).json()
    assert (summary["schema"], summary["analysed"]) == ("reanalysis/1", 2)
    assert [one["name"] for one in summary["analyses"]] == ["run-0", "run-1"]
    own = client.get(f"{at}/reanalysis/runs/{run_ids[0]}")
    assert own.json()["schema"] == "result/1"
    other = "019a0000-0000-7000-8000-000000000000"
    assert client.get(f"{at}/reanalysis/runs/{other}").status_code == 404


def test_the_command_line_says_what_has_changed(live, service, client, run_ids, capsys):
    address = str(live.base_url).rstrip("/")
    assert run(["reanalyse", "--machine", "default", "--address", address]) == 0
    assert "2 of 2 Runs analysed, 0 failed" in capsys.readouterr().out
    words = ["--address", address, "--json"]
    assert run(["reanalyse", *run_ids, *words]) == 0
    assert json.loads(capsys.readouterr().out)["total"] == 2


@pytest.mark.parametrize(
    "more",
    [{}, {"run_ids": ["a"], "machine": "default"}, {"run_ids": []}, {"run_id": "a"}],
)
def test_runs_are_named_or_chosen_and_not_both(client, is_problem, more):
    answer = client.post(JOBS, json={"kind": "reanalyse", **more})
    assert answer.status_code == 422, answer.text


def test_other_jobs_keep_their_bound(client):
    ids = [f"019a0000-0000-7000-8000-{n:012d}" for n in range(51)]
    answer = client.post(JOBS, json={"kind": "analyse", "run_ids": ids})
    assert answer.status_code == 422
    assert "more than 50" in answer.text
    answer = client.post(JOBS, json={"kind": "reanalyse", "run_ids": ids})
    assert answer.status_code == 404
