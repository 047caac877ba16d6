"""A result proved over REST: points, arming, answer; and the circle on a bench."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from scripted_cell import wait_until
from service_process import SPEED, arm, follow
from starlette.testclient import TestClient

from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_json import verification_json
from truepath.files.earlier.result_file import read_result
from truepath.machines.setup.simulated_controls import SimulatedControls
from truepath.main import open_service
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.worlds import synthetic

JOBS = "/api/v1/jobs"


@pytest.fixture
def result(service, finished, analysed):
    """A job with a real result, of the machine that the service drives."""
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    one = service.machines.get("default")
    machine = read_result(target / "result.json").machine
    service.machines.put(replace(one, machine=machine))
    return finished["id"]


@pytest.fixture
def ask(client, result):
    def asked(**more):
        order = {"kind": "verify", "result_id": result, **more}
        return client.post(JOBS, json=order)

    return asked


def test_points_of_verification_wait_to_be_armed(client, ask):
    answer = ask(what=["random-points", "circles"], seed=4, tolerance_um=5)
    assert answer.status_code == 202, answer.text
    at = answer.headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "ready")
    plan = client.get(f"{at}/plan").json()
    assert plan["kind"] == "points"
    assert len(plan["position"]) == 30 + 3 * 49
    job = client.get(at).json()
    assert (job["result"], job["verification"]) == (None, None)
    client.post(f"{at}/abort")


def test_the_same_seed_drives_the_same_points(client, ask):
    plans = []
    for _ in range(2):
        at = ask(what=["random-points"], seed=4).headers["Location"]
        wait_until(lambda at=at: client.get(at).json()["state"] == "ready")
        plans.append(client.get(f"{at}/plan").json()["position"])
        client.post(f"{at}/abort")
        wait_until(lambda at=at: client.get(at).json()["state"] == "aborted")
    assert plans[0] == plans[1]


def test_circles_in_motion_are_a_path_that_asks_for_a_control_with_arcs(
    client, ask, is_problem, service
):
    made = ask(what=["circles-in-motion"])
    assert made.status_code == 202, made.text
    at = made.headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "ready")
    plan = client.get(f"{at}/plan").json()
    assert plan["kind"] == "path"
    turns = [arc[3] for arc in plan["arc"] if arc]
    assert turns == [732.0, -732.0] * 3
    client.post(f"{at}/abort")
    wait_until(lambda: client.get(at).json()["state"] == "aborted")
    said = is_problem(ask(what=["circles-in-motion", "diagonals"]), 422, "bad-input")
    assert "ask for each by itself" in said["detail"]
    cell = service.machines.get("default").cell
    cell.status = replace(cell.status, devices={"motion": {"drives_arcs": False}})
    said = is_problem(ask(what=["circles-in-motion"]), 422, "bad-input")
    assert "this control does not drive arcs" in said["detail"]


def test_no_point_and_no_way_of_a_verification_touches_a_box(
    client, ask, is_problem, service
):
    box = {"name": "vice", "min_mm": [0, 0, 0], "max_mm": [200, 150, 120]}
    said = is_problem(ask(what=["diagonals"], keep_out=[box]), 422, "plan")
    assert "the way to row 2 enters the keep-out box vice" in said["detail"]
    at = ask(what=["random-points"], seed=4, keep_out=[box]).headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "ready")
    plan = client.get(f"{at}/plan").json()
    assert plan["keep_out"] == [box]
    inside = [all(0 <= v <= 150 for v in row[:3]) for row in plan["position"]]
    assert not any(inside)
    client.post(f"{at}/abort")


@pytest.mark.parametrize(
    ("change", "status", "kind"),
    [
        ({"keep_out": [{"min_mm": [0, 0, 9], "max_mm": [9, 9, 9]}]}, 422, "validation"),
        ({"keep_out_replaces": True}, 422, "validation"),
        ({"what": ["spirals"]}, 422, "validation"),
        ({"what": ["circles", "circles"]}, 422, "validation"),
        ({"run_id": "0" * 8}, 422, "validation"),
        ({"result_id": None}, 422, "validation"),
        ({"result_id": "0190a4a1-0000-7000-8000-000000000000"}, 404, "not-found"),
        ({"compensation_id": "siemens-10-hold"}, 404, "not-found"),
        ({"compensation_id": ".."}, 422, "validation"),
    ],
)
def test_what_cannot_be_verified_is_refused(ask, is_problem, change, status, kind):
    is_problem(ask(**change), status, kind)


def test_files_of_any_spacing_can_be_verified_and_mapped(client, ask, result):
    made = client.post(
        f"{JOBS}/{result}/compensations", json={"format": "fanuc", "spacing_mm": 12.5}
    ).json()
    assert "." in made["id"]
    answer = ask(compensation_id=made["id"], what=["diagonals"])
    assert answer.status_code == 202, answer.text
    client.post(f"{answer.headers['Location']}/abort")
    query = {"state": "after", "compensation": made["id"], "grid": 2}
    seen = client.get(f"{JOBS}/{result}/result/volumetric-map", params=query)
    assert seen.status_code == 200, seen.text


def test_a_result_is_verified_on_its_own_machine_alone(
    client, service, ask, result, is_problem
):
    one = service.machines.get("default")
    service.machines.put(replace(one, id="mill-9"))
    said = is_problem(ask(machine="mill-9"), 422, "bad-input")
    assert "is of machine default, not of mill-9" in said["detail"]
    made = ask()
    assert (made.status_code, made.json()["machine"]) == (202, "default"), made.text
    client.post(f"{made.headers['Location']}/abort")
    file = service.results / result / "result.json"
    content = json.loads(file.read_text())
    content["machine"]["axes"]["X"]["max_mm"] += 40.0
    file.write_text(json.dumps(content))
    said = is_problem(ask(), 422, "bad-input")
    assert "axes.X.max_mm is 500.0, but 540.0 in the result" in said["detail"]


class Control:
    """A simulated control that takes any files."""

    def load_compensation(self, compensation, rules=None):
        pass


def test_files_that_the_control_cannot_apply_are_not_verified(
    client, service, ask, result, is_problem
):
    service.setup.simulated_controls = SimulatedControls({"default": Control()})
    at = f"{JOBS}/{result}/compensations"
    orders = {"format": "isg-csv"}, {"format": "linuxcnc"}
    first, other = (client.post(at, json=order).json()["id"] for order in orders)
    off = ask(compensation_id=first, control_compensation="off")
    said = is_problem(off, 422, "bad-input")
    assert "control_compensation is off" in said["detail"]
    tables = "/api/v1/machines/default/simulated-tables"
    loaded = {"job_id": result, "compensation_id": other}
    assert client.put(tables, json=loaded).status_code == 200
    said = is_problem(ask(compensation_id=first), 422, "bad-input")
    assert f"has the files {other} of job {result}" in said["detail"]
    made = ask(compensation_id=other)
    assert made.status_code == 202, made.text
    client.post(f"{made.headers['Location']}/abort")


def test_a_verification_links_to_its_answer_and_report(
    client, service, ask, result, make_cell, verifier, record
):
    """What the task of science writes is what the routes give out."""
    again, _ = record(
        101,
        "standstill",
        rows=30,
        feed=6000.0,
        setting=synthetic.Setting(machine_seed=1),
    )
    found = verify(read_result(service.results / result / "result.json"), again)
    content = {**verification_json(found), "asked": {"seed": 4}, "compensation": None}
    verifier.content = content
    at = ask(what=["random-points"], seed=4, tolerance_um=3).headers["Location"]
    wait_until(lambda: client.get(at).json()["state"] == "ready")
    make_cell.cell.begun.clear()
    arm(client, client.get(at).json())
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    wait_until(lambda: client.get(at).json()["state"] == "succeeded")
    job = client.get(at).json()
    (((run_file,), first_row, result_file, files, told),) = verifier.calls
    assert first_row == [0]
    assert run_file.split("/")[-1].startswith(job["run_id"])
    assert result_file.split("/")[-2:] == [result, "result.json"]
    assert (files, told["seed"], told["tolerance_um"]) == (None, 4, 3.0)
    answer = client.get(job["verification"]["verification"])
    assert answer.status_code == 200
    assert answer.json()["agreement"]["consistent"]
    report = client.get(job["verification"]["report_html"])
    assert "sandbox" in report.headers["content-security-policy"]
    described = client.get("/api/v1/openapi.json").json()
    schema = described["components"]["schemas"]["VerificationOut"]
    assert set(schema["properties"]) == set(content)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_circles_are_driven_on_the_fly_and_held_against_the_result(tmp_path):
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=SPEED, port=0
    )
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):

        def drive(**order):
            made = client.post(JOBS, json=order)
            assert made.status_code == 202, made.text
            arm(client, follow(client, made.json()["id"], "ready"))
            return follow(client, made.json()["id"], "succeeded")

        job = drive(kind="measure-otf")["id"]
        proved = drive(kind="verify", result_id=job, what=["circles-in-motion"])
        found = client.get(proved["verification"]["verification"]).json()
    assert found["circles_missing"] == []
    assert [one["plane"] for one in found["circles_in_motion"]] == ["XY", "YZ", "ZX"]
    for one in found["circles_in_motion"]:
        driven = one["driven_feed_mm_min"].values()
        assert list(driven) == pytest.approx([one["feed_mm_min"]] * 2, rel=0.01)
        assert one["figures_um"]["H"] <= 2.0 * one["uncertainty_um"]["H"]
    within = [
        difference["within"]
        for one in found["circles_in_motion"]
        for difference in one["difference_um"].values()
    ]
    assert sum(within) >= len(within) - 1
    assert found["agreement"]["consistent"]


@pytest.mark.long
@pytest.mark.timeout(400)
def test_as_found_compensated_and_as_left_by_one_sequence_of_requests(tmp_path):
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=SPEED, port=0
    )
    tables = "/api/v1/machines/default/simulated-tables"

    def drive(client, **order):
        made = client.post(JOBS, json=order)
        assert made.status_code == 202, made.text
        arm(client, follow(client, made.json()["id"], "ready"))
        return follow(client, made.json()["id"], "succeeded")

    def proof(client, **order):
        job = drive(
            client, kind="verify", what=["random-points"], tolerance_um=6, **order
        )
        return client.get(job["verification"]["verification"]).json()

    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        job = drive(client, kind="measure-otf")["id"]
        made = client.post(f"{JOBS}/{job}/compensations", json={"format": "isg-csv"})
        assert made.status_code == 201, made.text
        before = proof(client, result_id=job, seed=1)
        named = {"job_id": job, "compensation_id": made.json()["id"]}
        loaded = client.put(tables, json=named)
        assert loaded.status_code == 200, loaded.text
        assert client.get(tables).json() == loaded.json()
        assert loaded.json()["files"] == made.json()["files"]
        kept = made.json()["id"]
        after = proof(client, result_id=job, compensation_id=kept, seed=2)
    assert before["conformity"]["measured"]["conformity"] == "outside"
    assert abs(before["map_scale"]["value"] - 1.0) < 0.05
    assert after["compensated"]
    assert abs(after["map_scale"]["value"]) < 0.05
    left, found = (
        one["volumetric_error_um"]["measured"]["mean"] for one in (after, before)
    )
    assert left < 0.15 * found
    assert after["agreement"]["chance"] > 0.001
