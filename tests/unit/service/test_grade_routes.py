"""What a job that waits to be armed gives: the grade of its set-up, an NC program."""

import numpy as np
import pytest

from truepath.motion.nc_programs.programs import read_program

UNKNOWN = "019a0000-0000-7000-8000-000000000000"


def at(job_id, what):
    return f"/api/v1/jobs/{job_id}/{what}"


def test_a_ready_job_is_graded_before_it_is_armed_from_where_the_tracker_stands(
    client, ready, is_problem
):
    address = at(ready["id"], "plan/grade")
    answer = client.get(address)
    assert answer.status_code == 200, answer.text
    grade = answer.json()
    assert grade["verdict"] in ("good", "usable", "poor")
    assert grade["tracker"]["assumed"] is True
    assert grade["tracker"]["best_number"] <= grade["number"]
    expected = grade["number"] * grade["sample_sigma_um"]
    assert grade["expected_uncertainty_um"] == pytest.approx(expected)
    assert client.get(f"/api/v1/jobs/{ready['id']}").json()["state"] == "ready"
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
    half = client.get(address, params={"tracker_mm": [1.0, 2.0]})
    is_problem(half, 422, "validation")


def test_a_ready_job_gives_its_path_as_a_program_of_each_control(
    client, ready, is_problem
):
    offered = client.get("/api/v1/nc-dialects").json()["items"]
    assert {item["name"] for item in offered} >= {"siemens-840d", "heidenhain"}
    assert all(item["control"] for item in offered)
    plan = client.get(at(ready["id"], "plan")).json()
    address, suffixes = at(ready["id"], "nc-program"), {}
    for item in offered:
        answer = client.get(address, params={"dialect": item["name"]})
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/plain; charset=utf-8"
        assert answer.text.isascii()
        motion = read_program(answer.text, item["name"])
        np.testing.assert_allclose(motion.position, plan["position"])
        np.testing.assert_allclose(motion.feed_mm_min, plan["feed_mm_min"])
        named = f'attachment; filename="{motion.name}.'
        disposition = answer.headers["content-disposition"]
        assert disposition.startswith(named)
        suffixes[item["name"]] = disposition.removeprefix(named)
    assert suffixes["heidenhain"] == 'h"'
    assert suffixes["siemens-840d"] == 'mpf"'
    unknown = client.get(address, params={"dialect": "mazatrol"})
    problem = is_problem(unknown, 422, "bad-input")
    assert "fanuc, heidenhain, linuxcnc, siemens-840d" in problem["detail"]


def test_a_job_that_commands_nothing_has_no_grade_and_no_program(
    client, run, take, is_problem
):
    job, dialect = take(kind="analyse", run_id=run["id"]), {"dialect": "fanuc"}
    is_problem(client.get(at(job["id"], "plan/grade")), 404, "not-found")
    for job_id in (job["id"], UNKNOWN):
        answer = client.get(at(job_id, "nc-program"), params=dialect)
        is_problem(answer, 404, "not-found")
