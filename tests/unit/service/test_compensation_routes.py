"""Compensation files over REST, and results that are verified by new points."""

import io
import json
import zipfile
from dataclasses import replace
from unittest.mock import Mock

import pytest

from api_builders import edited, set_verdict
from described_answers import read_document
from service_process import arm
from truepath.answers.machine_history import Calibration, changes_json
from truepath.answers.verification.verification import verify
from truepath.answers.verification.verification_json import verification_json
from truepath.compensation.export import export_files
from truepath.compensation.tables.error_map import Unmeasured
from truepath.files.earlier.result_file import read_result
from truepath.machines.simulated_controls import SimulatedControls
from truepath_simulators.worlds import synthetic

pytestmark = pytest.mark.usefixtures("few_places")
TABLES = "/api/v1/machines/default/simulated-tables"
JOBS = "/api/v1/jobs"


@pytest.fixture
def place(with_result):
    return f"/api/v1/jobs/{with_result}/compensations"


def test_files_are_those_of_the_command(client, place, analysed, tmp_path, is_problem):
    choices = {"measuring_system": "X=2,Y=1"}
    order = {"format": "siemens", "unmeasured": "fade", "choices": choices}
    answer = client.post(place, json={**order, "spacing_mm": 25})
    assert answer.status_code == 201
    made = answer.json()
    at = made["links"]["self"]
    assert answer.headers["location"] == at
    files = analysed / "result.json", "siemens", tmp_path / "compensation"
    chosen = {"spacing_mm": 25, "unmeasured": Unmeasured.FADE, "choices": choices}
    account = export_files(*files, **chosen)
    shared = (set(made) & set(account)) - {"files", "verdict", "schema", "id", "links"}
    assert shared >= {"volumetric_error_um", "left_um", "tables", "unmeasured", "note"}
    told = {key: account[key] for key in shared - {"provenance"}}
    del told["basis"]["active"]  # whole files
    assert {key: made[key] for key in told} == json.loads(json.dumps(told))
    assert made["verdict"] == account["verdict"]["state"]
    assert client.get(at).json() == made
    assert len(made["files"]) == len(account["files"]) > 1
    for name, file in zip(made["files"], account["files"], strict=True):
        taken = client.get(f"{at}/files/{name}")
        assert taken.content == (tmp_path / file).read_bytes()
        assert name in taken.headers["content-disposition"]
    packed = client.get(made["links"]["archive"])
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert set(archive.namelist()) == {*made["files"], "compensation.json"}
    for name in ("result.json", "..%2F..%2Fresult.json", "compensation-Q.tbl"):
        is_problem(client.get(f"{at}/files/{name}"), 404, "not-found")
    is_problem(client.get(f"{place}/linuxcnc-11-hold"), 404, "not-found")
    for spacing_mm in (12.345678, 12.345681, 12.345678):
        order = {"format": "fanuc", "spacing_mm": spacing_mm}
        assert client.post(place, json=order).status_code == 201
    kept = [item["id"] for item in client.get(place).json()["items"]]
    assert kept[:2] == ["fanuc-12.345678-hold", "fanuc-12.345681-hold"]
    assert len(kept) == 3, "made once for each spacing"
    is_problem(client.get(f"{place}/..%2F..%2F../archive"), 404, "not-found")


def test_what_cannot_be_made_says_why(client, service, place, with_result, is_problem):
    for name in ("vcs", "../linuxcnc"):
        answer = client.post(place, json={"format": name})
        refusal = is_problem(answer, 422, "bad-input")
        assert "installed: csv, etalon" in json.dumps(refusal)
    for word in ("X=3", "A=2"):
        order = {"format": "siemens", "choices": {"measuring_system": word}}
        is_problem(client.post(place, json=order), 422, "bad-input")
    set_verdict(service, with_result, "not-usable")
    asked = {"format": "linuxcnc"}
    refusal = is_problem(client.post(place, json=asked), 422, "not-usable")
    assert "accept_verdict" in refusal["action"]
    assert client.get(place).json()["items"] == []
    taken = client.post(place, json={**asked, "accept_verdict": True})
    assert (taken.status_code, taken.json()["verdict"]) == (201, "not-usable")


def say_on(file, active=None):
    """Let the control say that it compensated, by these files where it is told."""
    with edited(file) as content:
        for one in (content["provenance"], *content["runs"]):
            one["source"] = {**one["source"], "control_compensation": "on"}
        content["provenance"]["active_tables"] = active


def test_unknown_tables_must_be_given(client, service, with_result, place, is_problem):
    file = service.results / with_result / "result.json"

    def make(**more):
        return client.post(place, json={"format": "linuxcnc", **more})

    first = make().json()
    assert first["basis"]["holds"] == "as-measured"
    at = f"{place}/{first['id']}/files"
    texts = {name: client.get(f"{at}/{name}").text for name in first["files"]}
    say_on(file)
    is_problem(make(), 422, "active-tables-unknown")
    given, part = make(active_files=texts).json(), make(difference=True).json()
    holds = [one["basis"]["holds"] for one in (given, part)]
    assert holds == ["combined", "difference"]
    assert len({first["id"], given["id"], part["id"]}) == 3
    bad = {**texts, "compensation-X.tbl": "no table"}
    is_problem(make(active_files=bad), 422, "bad-input")
    is_problem(make(active_files={"../x.tbl": "0 0 0"}), 422, "validation")
    say_on(file, first["files_sha256"])  # those that the service has loaded
    made = make().json()
    assert made["basis"]["holds"] == "combined"
    assert made["id"].startswith("linuxcnc-10-hold-combined-")


def test_a_compensation_that_was_loaded_is_no_change_of_the_machine(analysed, tmp_path):
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    for file in (before, after):
        file.write_bytes((analysed / "result.json").read_bytes())
    with edited(before) as content:
        for run in content["provenance"]["runs"]:
            run["input_sha256"], run["sketch"] = "0" * 64, ""
        for one in (content["provenance"], *content["runs"]):
            one["source"] = {**one["source"], "control_compensation": "off"}
        for one in content["model"]["effects"]:  # by far more than its uncertainty
            if "values_um" in one:
                one["values_um"] = [1.5 * value for value in one["values_um"]]
    say_on(after)
    since, until = (
        Calibration("m", name, (), "2026-03-02T08:00:00Z", 1, "usable", file)
        for name, file in (("a", before), ("b", after))
    )
    found = changes_json(since, until)
    assert found["has_changed"] is False
    assert "compensation of the control was another" in found["text"][0]


def test_files_of_a_result_are_given_to_a_simulated_control_alone_and_taken_away(
    client, service, with_result, place, is_problem, until
):
    def name_files(**order):
        made = client.post(place, json=order).json()["id"]
        return {"job_id": with_result, "compensation_id": made}

    asked = name_files(format="linuxcnc")
    assert client.get(TABLES).json()["simulated"] is False
    for answer in (client.put(TABLES, json=asked), client.delete(TABLES)):
        is_problem(answer, 409, "not-simulated")
    load = Mock(side_effect=ValueError("the axes move"))
    controls = {"default": Mock(load_compensation=load)}
    service.setup.simulated_controls = SimulatedControls(controls)

    def read_given():
        places, rules = load.call_args.args
        return [place.name for place in places], rules

    wrong = {**asked, "compensation_id": "none"}
    is_problem(client.put(TABLES, json=wrong), 404, "not-found")
    is_problem(client.put(TABLES, json={"job_id": "any"}), 422, "validation")
    elsewhere = TABLES.replace("default", "other")
    is_problem(client.put(elsewhere, json=asked), 404, "not-found")
    said = is_problem(client.put(TABLES, json=asked), 422, "bad-input")
    assert "the axes move" in said["detail"]
    made = client.post("/api/v1/jobs", json={"kind": "measure-otf"}).json()
    load.reset_mock(side_effect=True)
    is_problem(client.put(TABLES, json=asked), 409, "busy")
    is_problem(client.delete(TABLES), 409, "busy")
    client.post(f"/api/v1/jobs/{made['id']}/abort")
    until(made, "aborted")
    assert client.get(TABLES).json()["compensation_id"] is None
    load.assert_not_called()
    answer = client.put(TABLES, json=asked)
    assert answer.status_code == 200, answer.text
    files = [f"compensation-{axis}.tbl" for axis in "XYZ"]
    told = {"machine": "default", "simulated": True, **asked, "files": files}
    assert answer.json() == told
    assert read_given() == (files, {})
    assert client.get(TABLES).json() == answer.json()
    assert client.delete(TABLES).status_code == 204
    assert read_given()[0] == client.get(TABLES).json()["files"] == []
    for name, choices in (
        ("heidenhain", {"backlash_reading": "difference"}),
        ("siemens-lec", {"measuring_system": "2"}),
    ):
        asked = name_files(format=name, choices=choices)
        assert client.put(TABLES, json=asked).status_code == 200
        assert read_given()[1] == choices, "the control is set as the files were made"


@pytest.fixture
def result(service, with_result):
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
    rows = (row[:3] for row in plan["position"])
    assert not any(min(row) >= 0 and max(row) <= 150 for row in rows)


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
    nobody = "0190a4a1-0000-7000-8000-000000000000"
    for unknown in ({"result_id": nobody}, {"compensation_id": "siemens-10-hold"}):
        is_problem(ask(**unknown), 404, "not-found")
    service.machines.put(replace(service.machines.get("default"), id="mill-9"))
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
    loaded = {"job_id": result, "compensation_id": other}
    assert client.put(TABLES, json=loaded).status_code == 200
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
