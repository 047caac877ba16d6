"""The grade of a job's set-up over REST, while it waits to be armed."""

from __future__ import annotations

import pytest


def test_a_ready_job_is_graded_before_it_is_armed(client, ready):
    answer = client.get(f"/api/v1/jobs/{ready['id']}/plan/grade")
    assert answer.status_code == 200, answer.text
    grade = answer.json()
    assert grade["verdict"] in ("good", "usable", "poor")
    assert grade["tracker"]["assumed"] is True
    assert grade["tracker"]["best_number"] <= grade["number"]
    expected = grade["number"] * grade["sample_sigma_um"]
    assert grade["expected_uncertainty_um"] == pytest.approx(expected)
    assert client.get(f"/api/v1/jobs/{ready['id']}").json()["state"] == "ready"


def test_the_place_of_the_tracker_counts_where_it_is_known(client, ready):
    address = f"/api/v1/jobs/{ready['id']}/plan/grade"
    near, far = (
        client.get(address, params={"tracker_mm": place}).json()
        for place in ([900.0, 0.0, 0.0], [9000.0, 0.0, 0.0])
    )
    assert near["tracker"] == {
        "position_mm": [900.0, 0.0, 0.0],
        "assumed": False,
        "best_number": near["number"],
    }
    assert far["expected_uncertainty_um"] > near["expected_uncertainty_um"]


def test_half_a_place_is_refused(client, ready, is_problem):
    address = f"/api/v1/jobs/{ready['id']}/plan/grade"
    is_problem(
        client.get(address, params={"tracker_mm": [1.0, 2.0]}), 422, "validation"
    )


def test_a_job_that_commands_nothing_has_no_grade(client, bundle, is_problem):
    files = {"bundle": ("mill.zip", bundle())}
    run = client.post("/api/v1/runs", files=files).json()
    order = {"kind": "analyse", "run_id": run["id"]}
    job = client.post("/api/v1/jobs", json=order).json()
    is_problem(client.get(f"/api/v1/jobs/{job['id']}/plan/grade"), 404, "not-found")
