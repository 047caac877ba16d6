"""A machine over its calibrations, over REST, and `truepath machines` for both."""

import json
from shutil import copytree

import pytest

from api_builders import add_calibration, edited
from truepath.files.earlier.temperature_file import temperature_model_from_json

pytestmark = pytest.mark.database
BASE = "/api/v1/machines"


def test_the_history_of_a_machine_is_every_calibration_with_its_uncertainty(
    client, calibrated, service, is_problem
):
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


def test_what_has_changed_since_a_calibration_is_said_in_words(
    client, calibrated, is_problem
):
    since = {"since": calibrated[0]}
    answer = client.get(f"{BASE}/default/changes", params=since)
    assert answer.status_code == 200, answer.text
    change = answer.json()
    assert change["until"]["job_id"] == calibrated[1]
    assert (change["has_changed"], change["significant"]) == (False, [])
    assert change["text"][0].startswith("No change is seen")
    unknown = client.get(f"{BASE}/default/changes", params={"since": "job-9"})
    is_problem(unknown, 404, "not-found")
    same = client.get(f"{BASE}/default/changes", params={**since, "until": "job-1"})
    assert "one Run" in is_problem(same, 422, "bad-input")["detail"]


def test_only_a_usable_calibration_of_the_machine_is_a_reference(
    client, calibrated, service, finished, is_problem
):
    at, standing = f"{BASE}/default", f"{BASE}/default/standing"
    (service.results / finished["id"] / "result.json").unlink()  # as a verification
    for other in (finished["id"], "job-9"):
        refused = client.patch(at, json={"reference_job": other})
        assert "is no calibration" in is_problem(refused, 422, "bad-input")["detail"]
    assert client.get(at).json()["reference_job"] is None
    assert client.patch(at, json={"reference_job": calibrated[0]}).status_code == 200
    assert client.get(standing).json()["has_changed"] is False
    (service.results / calibrated[0] / "result.json").unlink()
    service.calibrations.judge("default")
    lost = client.get(standing).json()
    assert (lost["has_changed"], lost["reference_job"]) == (None, calibrated[0])
    assert lost["change_text"].startswith("changes are not watched")


def test_a_machine_over_its_tolerance_raises_an_alarm(client, calibrated, service):
    told = []
    service.event_bus.subscribe(told.append)
    (one,) = client.get("/api/v1/machines:compare").json()["machines"]  # by the newest
    assert (one["machine"], one["job_id"], one["value"]) == ("default", "job-2", 30.0)
    client.patch(f"{BASE}/default", json={"tolerance_um": 25})
    standing = client.get(f"{BASE}/default/standing").json()
    assert (standing["is_alarm"], standing["tolerance"]) == (True, "over")
    assert (standing["has_changed"], standing["reference_job"]) == (False, "job-1")
    (event,) = [one for one in told if one.type == "machine"]
    assert event.body["is_alarm"]
    client.patch(f"{BASE}/default", json={"tolerance_um": 40})
    assert client.get(f"{BASE}/default/standing").json()["tolerance"] == "within"


def state_temperature(service, job_id, celsius):
    """Write into the result of a job what the scales' thermometers showed."""
    shown = {"mean": celsius, "low": celsius, "high": celsius, "used": True}
    with edited(service.results / job_id / "result.json") as content:
        axes = content["machine"]["axes"]
        for run in content["runs"]:
            run["environment"]["sensors"] = [{"name": name, **shown} for name in axes]


def test_what_depends_on_temperature_is_told_from_three_calibrations_on(
    client, calibrated, service, is_problem
):
    at = f"{BASE}/default/temperature"
    for job_id, celsius in zip(calibrated, (18.0, 24.0), strict=True):
        state_temperature(service, job_id, celsius)
    refused = is_problem(client.get(at), 422, "bad-input")["detail"]
    assert "needs three or more" in refused
    third = service.results / add_calibration(service, 3)
    copytree(service.results / "job-1", third, dirs_exist_ok=True)
    file = third / "result.json"
    file.write_text(file.read_text().replace(f"{1:064d}", f"{3:064d}"))
    state_temperature(service, "job-3", 21.0)
    answer = client.get(at)
    assert answer.status_code == 200, answer.text
    told = answer.json()
    assert [c["temperature_degC"] for c in told["calibrations"]] == [18.0, 24.0, 21.0]
    assert not any(one["is_significant"] for one in told["dependences"])
    assert told["coefficients"].keys() >= {"EXX", "C0Y"}
    assert told["text"][0].endswith("nothing is seen to depend on temperature.")
    file = client.get(f"{at}/temperature.json", params={"reference_degC": 21.0})
    assert 'filename="temperature.json"' in file.headers["content-disposition"]
    model = temperature_model_from_json(file.json(), file="temperature.json")
    assert model.reference_degc == 21.0
    assert model.measured_degc == (18.0, 24.0)
    missing = client.get(at, params={"sensor": "bed"})
    assert "no temperature of bed" in is_problem(missing, 422, "bad-input")["detail"]


def test_a_machine_that_has_changed_raises_an_alarm(client, calibrated, service):
    """EXX of the second calibration has a bump of 60 µm in the middle of the travel."""
    with edited(service.results / calibrated[1] / "result.json") as content:
        (exx,) = (e for e in content["model"]["effects"] if e.get("symbol") == "EXX")
        middle = len(exx["values_um"]) // 2
        for knot in range(middle - 3, middle + 4):
            exx["values_um"][knot] += 60.0
    told = []
    service.event_bus.subscribe(told.append)
    service.calibrations.judge("default")
    standing = client.get(f"{BASE}/default/standing").json()
    assert (standing["is_alarm"], standing["has_changed"]) == (True, True)
    assert (standing["reference_job"], standing["tolerance"]) == (calibrated[0], None)
    assert "EXX" in standing["change_text"]
    (event,) = [one for one in told if one.type == "machine"]
    assert (event.body["is_alarm"], event.body["calibration"]) == (True, calibrated[1])
