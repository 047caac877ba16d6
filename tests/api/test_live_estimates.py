"""The estimate while the machine moves, and the end at a target, over REST."""

from __future__ import annotations

import pytest

from truepath.catalogue.job import decode_job
from truepath.service.api.job_description import describe_job


@pytest.fixture
def order(order):
    """A measurement that may end early."""
    return {**order, "target_um": 2.0}


def test_a_job_shows_its_target_wherever_it_is_shown(client, ready):
    assert ready["target_um"] == 2.0
    assert ready["early_end"] is None
    (listed,) = client.get("/api/v1/jobs").json()["items"]
    assert listed["target_um"] == 2.0
    plan = client.get(f"/api/v1/jobs/{ready['id']}/plan").json()
    assert plan["target_um"] == 2.0


def test_a_job_without_a_target_says_so(client, order, until):
    del order["target_um"]
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    assert job["target_um"] is None
    assert client.get(f"/api/v1/jobs/{job['id']}/plan").json()["target_um"] is None


@pytest.mark.parametrize("target_um", [0, -1, 1e5, "a lot"])
def test_a_target_that_means_nothing_is_refused(client, order, is_problem, target_um):
    answer = client.post("/api/v1/jobs", json={**order, "target_um": target_um})
    problem = is_problem(answer, 422, "validation")
    assert "target_um" in str(problem)


def test_a_target_is_not_for_an_analysis(client, finished, is_problem):
    order = {"kind": "analyse", "run_id": finished["run_id"], "target_um": 1.0}
    is_problem(client.post("/api/v1/jobs", json=order), 422, "validation")


def test_a_job_says_that_and_why_it_ended_early(client, armed, estimates, until):
    estimates[-1].publish(1.75, done=6)
    ended = until(armed, "succeeded")
    assert ended["early_end"] == {
        "reason": "target-reached",
        "reached_um": 1.75,
        "done": 6,
        "total": 10,
    }


def test_the_event_of_an_early_end_says_why(client, armed, estimates, until, service):
    estimates[-1].publish(1.75, done=6)
    until(armed, "succeeded")
    *_, last = service.store.read_events_after(0, job_id=armed["id"])
    end = describe_job(decode_job(last.body)).early_end
    assert end is not None
    assert (end.reached_um, end.done) == (1.75, 6)


def test_the_newest_estimate_comes_with_its_course(client, armed, estimates):
    for sigma_um, done in ((9.0, 2), (9.0, 2), (4.0, 3)):
        estimates[-1].publish(sigma_um, done)
    found = client.get(f"/api/v1/jobs/{armed['id']}/estimate").json()
    assert (found["job_id"], found["done"]) == (armed["id"], 3)
    assert found["course"] == {
        "elapsed_s": [10.0, 15.0],
        "done": [2, 3],
        "volumetric_uncertainty_um": [9.0, 4.0],
    }


def test_no_estimate_before_the_first_lines_is_no_error(client, armed):
    answer = client.get(f"/api/v1/jobs/{armed['id']}/estimate")
    assert (answer.status_code, answer.content) == (204, b"")
