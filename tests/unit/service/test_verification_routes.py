"""A result proved over REST: points, arming, answer; and the circle on a bench."""

from dataclasses import replace
from unittest.mock import Mock

import pytest

from api_builders import edited
from described_answers import read_document
from service_process import arm
from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_json import verification_json
from truepath.files.earlier.result_file import read_result
from truepath.machines.setup.simulated_controls import SimulatedControls
from truepath_simulators.worlds import synthetic

JOBS = "/api/v1/jobs"


@pytest.fixture
def result(service, with_result):
    """A job with a real result, of the machine that the service drives."""
    one = service.machines.get("default")
    machine = read_result(service.results / with_result / "result.json").machine
    service.machines.put(replace(one, machine=machine))
    return with_result


@pytest.fixture
def ask(client, result):
    order = {"kind": "verify", "result_id": result}
    return lambda **more: client.post(JOBS, json=order | more)


@pytest.fixture
def look(client, ask, until):
    """Order a verification and abort it once it waits; return job and plan."""

    def looked(**more):
        answer = ask(**more)
        assert answer.status_code == 202, answer.text
        job = until(answer.json(), "ready")
        plan = client.get(job["links"]["plan"]).json()
        client.post(f"{JOBS}/{job['id']}/abort")
        until(job, "aborted")
        return job, plan

    return looked


def test_points_follow_their_seed_and_touch_no_box(ask, look, is_problem):
    asked = {"what": ["random-points", "circles"], "seed": 4, "tolerance_um": 5}
    job, plan = look(**asked)
    assert plan["kind"] == "points"
    assert len(plan["position"]) == 30 + 3 * 49
    assert (job["result"], job["verification"]) == (None, None)
    assert look(**asked)[1]["position"] == plan["position"]
    box = {"name": "vice", "min_mm": [0, 0, 0], "max_mm": [200, 150, 120]}
    said = is_problem(ask(what=["diagonals"], keep_out=[box]), 422, "plan")
    assert "the way to row 2 enters the keep-out box vice" in said["detail"]
    _, plan = look(what=["random-points"], seed=4, keep_out=[box])
    assert plan["keep_out"] == [box]
    inside = [all(0 <= v <= 150 for v in row[:3]) for row in plan["position"]]
    assert not any(inside)


def test_circles_in_motion_ask_for_a_control_with_arcs(ask, look, is_problem, service):
    _, plan = look(what=["circles-in-motion"])
    assert plan["kind"] == "path"
    assert [arc[3] for arc in plan["arc"] if arc] == [732.0, -732.0] * 3
    said = is_problem(ask(what=["circles-in-motion", "diagonals"]), 422, "bad-input")
    assert "ask for each by itself" in said["detail"]
    cell = service.machines.get("default").cell
    cell.status = replace(cell.status, devices={"motion": {"drives_arcs": False}})
    said = is_problem(ask(what=["circles-in-motion"]), 422, "bad-input")
    assert "this control does not drive arcs" in said["detail"]


def test_a_result_is_verified_on_its_machine(client, service, ask, result, is_problem):
    for unknown in (
        {"result_id": "0190a4a1-0000-7000-8000-000000000000"},
        {"compensation_id": "siemens-10-hold"},
    ):
        is_problem(ask(**unknown), 404, "not-found")
    one = service.machines.get("default")
    service.machines.put(replace(one, id="mill-9"))
    said = is_problem(ask(machine="mill-9"), 422, "bad-input")
    assert "is of machine default, not of mill-9" in said["detail"]
    made = ask()
    assert (made.status_code, made.json()["machine"]) == (202, "default"), made.text
    client.post(f"{made.headers['Location']}/abort")
    with edited(service.results / result / "result.json") as content:
        content["machine"]["axes"]["X"]["max_mm"] += 40.0
    said = is_problem(ask(), 422, "bad-input")
    assert "axes.X.max_mm is 500.0, but 540.0 in the result" in said["detail"]


@pytest.mark.usefixtures("few_places")
def test_files_that_apply_are_verified(client, service, ask, look, result, is_problem):
    service.setup.simulated_controls = SimulatedControls({"default": Mock()})
    at = f"{JOBS}/{result}/compensations"
    orders = {"format": "isg-csv", "spacing_mm": 12.5}, {"format": "linuxcnc"}
    first, other = (client.post(at, json=order).json()["id"] for order in orders)
    assert "." in first
    look(compensation_id=first, what=["diagonals"])
    query = {"state": "after", "compensation": first, "grid": 2}
    seen = client.get(f"{JOBS}/{result}/result/volumetric-map", params=query)
    assert seen.status_code == 200, seen.text
    off = ask(compensation_id=first, control_compensation="off")
    said = is_problem(off, 422, "bad-input")
    assert "control_compensation is off" in said["detail"]
    tables = "/api/v1/machines/default/simulated-tables"
    loaded = {"job_id": result, "compensation_id": other}
    assert client.put(tables, json=loaded).status_code == 200
    said = is_problem(ask(compensation_id=first), 422, "bad-input")
    assert f"has the files {other} of job {result}" in said["detail"]
    look(compensation_id=other)


def test_a_verification_links_to_its_answer_and_report(
    client, service, ask, until, result, make_cell, verifier, record
):
    """What the task of science writes is what the routes give out."""
    setting = synthetic.Setting(machine_seed=1)
    again, _ = record(101, "standstill", rows=30, feed=6000.0, setting=setting)
    found = verify(read_result(service.results / result / "result.json"), again)
    content = {**verification_json(found), "asked": {"seed": 4}, "compensation": None}
    verifier.content = content
    job = ask(what=["random-points"], seed=4, tolerance_um=3).json()
    ready = until(job, "ready")
    make_cell.cell.begun.clear()
    arm(client, ready)
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    job = until(job, "succeeded")
    (((run_file,), first_row, result_file, files, told),) = verifier.calls
    assert run_file.split("/")[-1].startswith(job["run_id"])
    assert result_file.split("/")[-2:] == [result, "result.json"]
    assert (first_row, files, told["seed"], told["tolerance_um"]) == ([0], None, 4, 3.0)
    answer = client.get(job["verification"]["verification"])
    assert answer.json()["agreement"]["consistent"]
    report = client.get(job["verification"]["report_html"])
    assert "sandbox" in report.headers["content-security-policy"]
    schema = read_document()["components"]["schemas"]["VerificationOut"]
    assert set(schema["properties"]) == set(content)
