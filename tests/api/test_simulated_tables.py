"""Compensation files in a simulated control over REST; none in a real one."""

from __future__ import annotations

import shutil

import pytest

from truepath.machines.setup.simulated_controls import SimulatedControls

TABLES = "/api/v1/machines/default/simulated-tables"


class Control:
    """A control that keeps what it is given, or refuses it."""

    def __init__(self):
        self.given, self.rules, self.refusal = [], {}, ""

    def load_compensation(self, compensation, rules=None):
        if self.refusal:
            raise ValueError(self.refusal)
        self.given, self.rules = [place.name for place in compensation], rules


@pytest.fixture
def control(service):
    one = Control()
    service.setup.simulated_controls = SimulatedControls({"default": one})
    return one


@pytest.fixture
def job(service, finished, analysed):
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return finished["id"]


@pytest.fixture
def make_files(client, job):
    def make(**order):
        place = f"/api/v1/jobs/{job}/compensations"
        return client.post(place, json=order).json()["id"]

    return make


def test_files_of_a_result_are_given_to_the_control_and_taken_away(
    client, control, job, make_files
):
    asked = {"job_id": job, "compensation_id": make_files(format="linuxcnc")}
    answer = client.put(TABLES, json=asked)
    assert answer.status_code == 200, answer.text
    files = [f"compensation-{axis}.tbl" for axis in "XYZ"]
    told = {"machine": "default", "simulated": True, **asked, "files": files}
    assert answer.json() == told
    assert control.given == files
    assert client.get(TABLES).json() == answer.json()
    assert client.delete(TABLES).status_code == 204
    assert control.given == client.get(TABLES).json()["files"] == []


def test_the_control_is_set_as_the_files_were_made(client, control, job, make_files):
    for order, rules in (
        (
            {"format": "heidenhain", "choices": {"backlash_reading": "difference"}},
            {"backlash_reading": "difference"},
        ),
        (
            {"format": "siemens-lec", "choices": {"measuring_system": "2"}},
            {"measuring_system": "2"},
        ),
        ({"format": "isg-csv"}, {}),
    ):
        asked = {"job_id": job, "compensation_id": make_files(**order)}
        assert client.put(TABLES, json=asked).status_code == 200
        assert control.rules == rules


def test_a_machine_with_real_devices_is_refused(client, job, make_files, is_problem):
    asked = {"job_id": job, "compensation_id": make_files(format="linuxcnc")}
    assert client.get(TABLES).json()["simulated"] is False
    for answer in (client.put(TABLES, json=asked), client.delete(TABLES)):
        is_problem(answer, 409, "not-simulated")


def test_what_cannot_be_loaded_is_refused_and_changes_nothing(
    client, control, job, make_files, is_problem
):
    kept = make_files(format="linuxcnc")
    asked = {"job_id": job, "compensation_id": kept}
    is_problem(
        client.put(TABLES, json={**asked, "compensation_id": "none"}), 404, "not-found"
    )
    is_problem(client.put(TABLES, json={"job_id": job}), 422, "validation")
    elsewhere = TABLES.replace("default", "other")
    is_problem(client.put(elsewhere, json=asked), 404, "not-found")
    control.refusal = "the axes move; load tables while they stand"
    is_problem(client.put(TABLES, json=asked), 422, "bad-input")
    assert client.get(TABLES).json()["compensation_id"] is None


def test_nothing_is_loaded_while_a_job_holds_the_machine(
    client, control, job, make_files, is_problem
):
    asked = {"job_id": job, "compensation_id": make_files(format="linuxcnc")}
    made = client.post("/api/v1/jobs", json={"kind": "measure-otf"}).json()
    is_problem(client.put(TABLES, json=asked), 409, "busy")
    is_problem(client.delete(TABLES), 409, "busy")
    assert control.given == []
    client.post(f"/api/v1/jobs/{made['id']}/abort")
