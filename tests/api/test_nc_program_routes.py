from __future__ import annotations

import numpy as np
import pytest

from truepath.motion.nc_programs.programs import read_program


def test_a_ready_job_gives_its_path_as_a_program_of_each_control(client, ready):
    offered = client.get("/api/v1/nc-dialects").json()["items"]
    assert {item["name"] for item in offered} >= {"siemens-840d", "heidenhain"}
    assert all(item["control"] for item in offered)
    plan = client.get(f"/api/v1/jobs/{ready['id']}/plan").json()
    for item in offered:
        answer = client.get(
            f"/api/v1/jobs/{ready['id']}/nc-program", params={"dialect": item["name"]}
        )
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/plain; charset=utf-8"
        assert answer.text.isascii()
        motion = read_program(answer.text, item["name"])
        np.testing.assert_allclose(motion.position, plan["position"])
        np.testing.assert_allclose(motion.feed_mm_min, plan["feed_mm_min"])


@pytest.mark.parametrize(
    ("dialect", "suffix"), [("heidenhain", ".h"), ("siemens-840d", ".mpf")]
)
def test_a_program_is_called_as_its_control_wants_it(client, ready, dialect, suffix):
    answer = client.get(
        f"/api/v1/jobs/{ready['id']}/nc-program", params={"dialect": dialect}
    )
    name = read_program(answer.text, dialect).name
    disposition = answer.headers["content-disposition"]
    assert disposition == f'attachment; filename="{name}{suffix}"'


def test_standstill_points_are_a_program_as_well(client, until):
    points = [{"x_mm": 1, "y_mm": 2, "z_mm": 3}, {"x_mm": 4, "y_mm": 5, "z_mm": 6}]
    points.append({"x_mm": 90, "y_mm": 5, "z_mm": 6})
    order = {"kind": "measure-standstill", "points": points}
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    answer = client.get(
        f"/api/v1/jobs/{job['id']}/nc-program", params={"dialect": "linuxcnc"}
    )
    motion = read_program(answer.text, "linuxcnc")
    np.testing.assert_allclose(motion.position, [[1, 2, 3], [4, 5, 6], [90, 5, 6]])


def test_an_unknown_control_is_answered_with_those_that_are_installed(
    client, ready, is_problem
):
    address = f"/api/v1/jobs/{ready['id']}/nc-program"
    problem = is_problem(
        client.get(address, params={"dialect": "mazatrol"}), 422, "bad-input"
    )
    assert "fanuc, heidenhain, linuxcnc, siemens-840d" in problem["detail"]
    is_problem(client.get(address), 422, "validation")


def test_a_job_that_commands_nothing_has_no_program(client, bundle, is_problem):
    files = {"bundle": ("mill.zip", bundle())}
    run = client.post("/api/v1/runs", files=files).json()
    order = {"kind": "analyse", "run_id": run["id"]}
    job = client.post("/api/v1/jobs", json=order).json()
    answer = client.get(
        f"/api/v1/jobs/{job['id']}/nc-program", params={"dialect": "fanuc"}
    )
    is_problem(answer, 404, "not-found")
    unknown = "/api/v1/jobs/019a0000-0000-7000-8000-000000000000/nc-program"
    is_problem(client.get(unknown, params={"dialect": "fanuc"}), 404, "not-found")
