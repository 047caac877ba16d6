"""Machines over REST: who they are, their configurations, devices and calibrations."""

import json
from dataclasses import replace
from shutil import copytree

import pytest

from api_builders import add_calibration, arm_over_http, edited
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State
from truepath.files.earlier.temperature_file import temperature_model_from_json
from truepath.machines.machine_setup import show_devices
from truepath.service.api.routes.machines import NewMachine
from truepath_simulators.machine_file import load_machine

pytestmark = pytest.mark.database
BASE = "/api/v1/machines"
TRACKER, MOTION = {"port": "/dev/tracker-7"}, {"host": "192.0.2.7"}
DEVICES = {"tracker_options": TRACKER, "motion_options": MOTION}


def add(client, machine_id="mill-3", name="mill 3"):
    content = load_machine("demo") | {"name": name}
    body = {"id": machine_id, "machine_file": content, "identity": {"place": "hall 3"}}
    return client.post(BASE, json=body)


@pytest.fixture
def chosen(client, service):
    """A machine that was added, with devices chosen; its cell ends with the test."""
    assert add(client).status_code == 201
    answer = client.put(f"{BASE}/mill-3/devices", json=DEVICES)
    assert answer.status_code == 200, answer.text
    yield answer.json()
    for cell in service.machines.list_all():
        if cell.id == "mill-3":
            cell.close()


def test_a_machine_is_listed_and_its_identity_kept(client, is_problem):
    (one,) = client.get(BASE).json()["items"]
    assert (one["id"], one["name"], one["version"]) == ("default", "demo", 1)
    assert (one["cell"], one["current_job"]) == ("disconnected", None)
    detail = client.get(f"{BASE}/default").json()
    assert detail["machine_file"]["kinematic_chain"]
    assert detail["devices"] == {"simulated": True}
    assert len(detail["versions"][0]["sha256"]) == 64
    body = {"serial_number": "4711", "customer": "Example Ltd", "tolerance_um": 15}
    changed = client.patch(f"{BASE}/default", json=body).json()
    assert (changed["serial_number"], changed["tolerance_um"]) == ("4711", 15.0)
    again = client.patch(f"{BASE}/default", json={"tolerance_um": None}).json()
    assert (again["customer"], again["tolerance_um"]) == ("Example Ltd", None)
    is_problem(client.patch(f"{BASE}/press", json=body), 404, "not-found")
    is_problem(client.patch(f"{BASE}/default", json={"id": "x"}), 422, "validation")


def test_what_is_not_printed_identifies_no_machine(client, is_problem):
    """A certificate would state it."""
    as_json = {"content-type": "application/json"}
    machine = json.dumps(load_machine("demo") | {"name": "NAME"})
    for code in ("0000", "000a", "202e", "2066", "d800"):
        text = f'"a\\u{code}b"'
        file = machine.replace('"NAME"', text)
        stated = f'{{"identity": {{"serial_number": {text}}}}}'
        for method, address, body, said in (
            ("PATCH", "machines/default", f'{{"serial_number": {text}}}', "validation"),
            ("POST", "jobs/any/certificates", stated, "validation"),
            ("POST", "machines", f'{{"id": "m-9", "machine_file": {file}}}', "bundle"),
        ):
            at = f"/api/v1/{address}"
            answer = client.request(method, at, content=body, headers=as_json)
            is_problem(answer, 422, said)


def test_what_contradicts_another_machine_is_refused(chosen, client, is_problem):
    is_problem(add(client), 409, "machine-known")
    same_name = add(client, "mill-4", name="mill 3")
    assert "both named" in is_problem(same_name, 409, "machine-known")["detail"]
    assert add(client, "mill-4", name="mill 4").status_code == 201
    shared = client.put(f"{BASE}/mill-4/devices", json=DEVICES)
    assert "tracker-7" in is_problem(shared, 409, "machine-known")["detail"]
    unknown = {**DEVICES, "tracker_options": {"prot": 3}}
    wrong = client.put(f"{BASE}/mill-4/devices", json=unknown)
    assert "did you mean port" in is_problem(wrong, 422, "bad-input")["detail"]
    is_problem(add(client, "current", name="x"), 422, "validation")


def test_a_machine_file_anew_keeps_the_devices(chosen, client, service, is_problem):
    assert chosen["devices"]["tracker_options"] == TRACKER
    first, added = client.get(BASE).json()["items"]
    assert (first["id"], added["id"], added["place"]) == ("default", "mill-3", "hall 3")
    content = load_machine("demo") | {"name": "mill 3"}
    content["axes"]["X"]["max_mm"] += 25.0
    at, body = f"{BASE}/mill-3/machine-file", {"machine_file": content}
    before = service.machines.get("mill-3")
    stale, newest = ({"If-Match": f'"{number}"'} for number in (1, 2))
    for address, sent in ((at, body), (f"{BASE}/mill-3/devices", DEVICES)):
        is_problem(client.put(address, json=sent, headers=stale), 412, "stale-version")
    changed = client.put(at, json=body, headers=newest).json()
    assert [v["number"] for v in changed["versions"]] == [3, 2, 1]
    assert len({v["sha256"] for v in changed["versions"]}) == 3
    axis = changed["machine_file"]["axes"]["X"]
    assert axis["max_mm"] == content["axes"]["X"]["max_mm"]
    assert changed["devices"] == chosen["devices"]
    now = service.machines.get("mill-3")
    assert (now.version, now is before) == (3, False)
    assert client.put(at, json=body).json()["version"] == 3
    assert service.machines.get("mill-3") is now
    content["axes"]["X"]["max_mm"] = -1e4
    assert "axes.X" in is_problem(client.put(at, json=body), 422, "bundle")["detail"]
    taken = {"machine_file": load_machine("demo")}
    is_problem(client.put(at, json=taken), 409, "machine-known")
    for path, sent in (("devices", DEVICES), ("machine-file", taken)):
        answer = client.put(f"{BASE}/default/{path}", json=sent)  # of the settings
        is_problem(answer, 409, "set-elsewhere")


def test_a_changed_machine_is_audited_with_what_was_and_what_is(client, chosen):
    def read_change():
        row = client.get("/api/v1/audit").json()["items"][0]
        return row["old"], row["new"]

    old, new = read_change()
    assert (old["version"], new["version"]) == (1, 2)
    assert new["devices.tracker_options"] == '{"port": "/dev/tracker-7"}'
    client.patch(f"{BASE}/mill-3", json={"tolerance_um": 15, "place": "hall 4"})
    assert read_change() == (
        {"place": "hall 3", "tolerance_um": None},
        {"place": "hall 4", "tolerance_um": 15.0},
    )
    content = load_machine("demo") | {"name": "mill 3b"}
    client.put(f"{BASE}/mill-3/machine-file", json={"machine_file": content})
    old, new = read_change()
    assert (old["machine_file.name"], new["machine_file.name"]) == ("mill 3", "mill 3b")
    assert remove(client).status_code == 204
    assert read_change()[0]["machine_file.name"] == "mill 3b"


def test_a_trial_says_what_a_tracker_sends(client, make_cell, order, take, is_problem):
    trial = f"{BASE}/default/devices:try"
    answer = client.post(trial)
    assert answer.status_code == 200, answer.text
    assert answer.json()["text"] == "42 samples, 0 lost, target 1.2 m away"
    assert make_cell.cell.heard == ["connect", "try"]
    job = take("ready", **order)
    assert arm_over_http(client, job).status_code == 202
    assert make_cell.cell.begun.wait(5)
    problem = is_problem(client.post(trial), 409, "busy")
    assert problem["current_job"].endswith(job["id"])


def test_no_password_of_a_device_is_shown():
    options = {"host": "192.0.2.7", "password": "EMC", "enable_password": "x"}
    shown = show_devices({"motion_driver": "linuxcnc", "motion_options": options})
    hidden = {"password": "***", "enable_password": "***"}
    assert shown["motion_options"] == options | hidden


def remove(client, machine_id="mill-3", version=None):
    if version is None:
        version = client.get(f"{BASE}/{machine_id}").json()["version"]
    return client.delete(f"{BASE}/{machine_id}", headers={"If-Match": f'"{version}"'})


def test_a_machine_that_is_removed_keeps_its_history(client, service, is_problem):
    (example,) = NewMachine.model_config["json_schema_extra"]["examples"]
    answer = client.post(BASE, json=example)  # of the description
    assert answer.status_code == 201, answer.text
    assert client.put(f"{BASE}/mill-3/devices", json=DEVICES).status_code == 200
    assert remove(client).status_code == 204
    assert [one["id"] for one in client.get(BASE).json()["items"]] == ["default"]
    assert "mill-3" not in [one.id for one in service.machines.list_all()]
    assert client.get(f"{BASE}/mill-3").json()["origin"] == "removed"
    assert client.get(f"{BASE}/mill-3/standing").status_code == 200
    order = {"kind": "measure-otf", "machine": "mill-3"}
    is_problem(client.post("/api/v1/jobs", json=order), 404, "not-found")
    is_problem(client.put(f"{BASE}/mill-3/devices", json=DEVICES), 404, "not-found")
    again = add(client)
    assert again.status_code == 201
    assert (again.json()["origin"], again.json()["version"]) == ("catalogue", 3)


def test_a_machine_is_removed_while_it_stands_free(client, service, chosen, is_problem):
    is_problem(client.delete(f"{BASE}/mill-3"), 428, "version-required")
    stale = remove(client, version=chosen["version"] - 1)
    assert is_problem(stale, 412, "stale-version")["current_version"] == 2
    is_problem(remove(client, "press", version=1), 404, "not-found")
    is_problem(remove(client, "default"), 409, "set-elsewhere")
    job, _ = service.store.create(Job(JobKind.MEASURE_OTF, machine="mill-3"), None, {})
    is_problem(remove(client), 409, "busy")
    service.store.change(job.id, lambda one: replace(one, state=State.FAILED))
    cell = service.machines.get("mill-3").cell
    cell.status = replace(cell.status, state="running")
    moving = is_problem(remove(client), 409, "illegal-transition")
    assert "is running" in moving["detail"]


def test_history_is_every_calibration(client, calibrated, service, is_problem):
    answer = client.get(f"{BASE}/default/history").json()
    assert answer["schema"] == "machine-history/1"
    assert [c["job_id"] for c in answer["calibrations"]] == list(calibrated)
    assert [c["value"][1] for c in answer["calibrations"]] == [20.0, 30.0]
    one, _ = answer["calibrations"]
    file = service.results / one["job_id"] / "result.json"
    stated = json.loads(file.read_text())["volumetric_error"]["after_expected"]
    figures = [stated[name]["value_um"] for name in ("mean", "p95", "largest")]
    assert one["expected_after"] == figures
    assert one["expected_after"][0] < one["value"][0]
    exx = client.get(f"{BASE}/default/history", params={"quantity": "EXX"}).json()
    assert exx["unit"] == "um"
    assert len(exx["entries"]) == len(exx["calibrations"][0]["uncertainty"]) > 4
    assert set(exx["calibrations"][0]["expected_after"]) == {None}
    at = {"quantity": "EXX", "position": 33.3}
    is_problem(client.get(f"{BASE}/default/history", params=at), 422, "bad-input")
    is_problem(client.get(f"{BASE}/press/history"), 404, "not-found")
    changes, since = f"{BASE}/default/changes", {"since": calibrated[0]}
    change = client.get(changes, params=since).json()
    assert change["until"]["job_id"] == calibrated[1]
    assert (change["has_changed"], change["significant"]) == (False, [])
    assert change["text"][0].startswith("No change is seen")
    is_problem(client.get(changes, params={"since": "job-9"}), 404, "not-found")
    same = client.get(changes, params={**since, "until": "job-1"})
    assert "one Run" in is_problem(same, 422, "bad-input")["detail"]


def test_an_old_run_that_is_uploaded_late_is_not_the_newest(calibrated, service):
    def state(job_id, started, digest):
        with edited(service.results / job_id / "result.json") as content:
            for run in content["runs"]:
                run["source"].pop("started", None)
                run["source"].update({"started": started} if started else {})
            content["provenance"]["runs"] = [{"name": "r", "input_sha256": digest}]

    def list_jobs():
        return [one.job_id for one in service.calibrations.list_of("default")]

    state("job-1", "2026-02-01T08:00:00+00:00", "1" * 64)
    state("job-2", "2025-02-01T08:00:00+00:00", "2" * 64)
    assert list_jobs() == ["job-2", "job-1"]
    state("job-2", None, "2" * 64)
    assert list_jobs() == ["job-2", "job-1"]
    state("job-2", None, "1" * 64)
    assert len(list_jobs()) == 1


def test_references_are_calibrations(client, calibrated, service, finished, is_problem):
    at, standing = f"{BASE}/default", f"{BASE}/default/standing"
    (service.results / finished["id"] / "result.json").unlink()  # as a verification
    for other in (finished["id"], "job-9"):
        refused = client.patch(at, json={"reference_job": other})
        assert "is no calibration" in is_problem(refused, 422, "bad-input")["detail"]
    assert client.get(at).json()["reference_job"] is None
    assert client.patch(at, json={"reference_job": calibrated[0]}).status_code == 200
    assert client.get(standing).json()["has_changed"] is False
    (service.results / calibrated[0] / "result.json").unlink()
    service.calibrations.update_status("default")
    lost = client.get(standing).json()
    assert (lost["has_changed"], lost["reference_job"]) == (None, calibrated[0])
    assert lost["change_text"].startswith("changes are not watched")


@pytest.fixture
def told(service):
    told = []
    service.event_bus.subscribe(lambda n: n.type == "machine" and told.append(n.body))
    return told


def test_a_machine_over_its_tolerance_raises_an_alarm(client, calibrated, told):
    (one,) = client.get("/api/v1/machines:compare").json()["machines"]  # by the newest
    assert (one["machine"], one["job_id"], one["value"]) == ("default", "job-2", 30.0)
    client.patch(f"{BASE}/default", json={"tolerance_um": 25})
    standing = client.get(f"{BASE}/default/standing").json()
    assert (standing["is_alarm"], standing["tolerance"]) == (True, "over")
    assert (standing["has_changed"], standing["reference_job"]) == (False, "job-1")
    assert [body["is_alarm"] for body in told] == [True]
    client.patch(f"{BASE}/default", json={"tolerance_um": 40})
    assert client.get(f"{BASE}/default/standing").json()["tolerance"] == "within"


def test_a_machine_that_has_changed_raises_an_alarm(client, calibrated, service, told):
    """EXX of the second calibration has a bump of 60 µm in the middle of the travel."""
    with edited(service.results / calibrated[1] / "result.json") as content:
        (exx,) = (e for e in content["model"]["effects"] if e.get("symbol") == "EXX")
        middle = len(exx["values_um"]) // 2
        for knot in range(middle - 3, middle + 4):
            exx["values_um"][knot] += 60.0
    service.calibrations.update_status("default")
    standing = client.get(f"{BASE}/default/standing").json()
    assert (standing["is_alarm"], standing["has_changed"]) == (True, True)
    assert (standing["reference_job"], standing["tolerance"]) == (calibrated[0], None)
    assert "EXX" in standing["change_text"]
    (event,) = told
    assert (event["is_alarm"], event["calibration"]) == (True, calibrated[1])


def test_three_calibrations_show_temperature(client, calibrated, service, is_problem):
    at = f"{BASE}/default/temperature"

    def state(job_id, celsius):
        shown = {"mean": celsius, "low": celsius, "high": celsius, "used": True}
        with edited(service.results / job_id / "result.json") as content:
            axes = content["machine"]["axes"]
            for run in content["runs"]:
                sensors = [{"name": name, **shown} for name in axes]
                run["environment"]["sensors"] = sensors

    for job_id, celsius in zip(calibrated, (18.0, 24.0), strict=True):
        state(job_id, celsius)
    refused = is_problem(client.get(at), 422, "bad-input")
    assert "needs three or more" in refused["detail"]
    third = service.results / add_calibration(service, 3)
    copytree(service.results / "job-1", third, dirs_exist_ok=True)
    file = third / "result.json"
    file.write_text(file.read_text().replace(f"{1:064d}", f"{3:064d}"))
    state("job-3", 21.0)
    told = client.get(at).json()
    assert [c["temperature_degC"] for c in told["calibrations"]] == [18.0, 24.0, 21.0]
    assert told["text"][0].endswith("nothing is seen to depend on temperature.")
    file = client.get(f"{at}/temperature.json", params={"reference_degC": 21.0})
    assert 'filename="temperature.json"' in file.headers["content-disposition"]
    model = temperature_model_from_json(file.json(), file="temperature.json")
    assert (model.reference_degc, model.measured_degc) == (21.0, (18.0, 24.0))
    missing = client.get(at, params={"sensor": "bed"})
    assert "no temperature of bed" in is_problem(missing, 422, "bad-input")["detail"]
