import pytest

from truepath.service.api.routes import machine as machine_routes
from truepath_drivers.interfaces.errors import (
    ConnectionLost,
    DeviceTimeout,
    WrongDevice,
)


def test_the_system_says_what_it_is_and_the_machine_who_is_connected(client):
    system = client.get("/api/v1/system").json()
    assert (system["version"], system["simulated"]) == ("1.2.3", True)
    assert system["machine"]["name"] == "demo"
    assert system["machine"]["axes"] == ["X", "Y", "Z"]
    assert system["cell"]["state"] == "disconnected"
    assert system["current_job"] is None
    machine = client.get("/api/v1/machines/current").json()
    assert machine["schema"] == "machine/1"
    assert machine["axes"]["X"]["max_mm"] > 0
    assert machine["tracker_noise"]["rate_hz"] == 500
    assert machine["connected"] is False
    assert machine["tracker"] is None
    answer = client.post("/api/v1/machines/current:connect")
    assert answer.status_code == 200
    assert answer.json()["tracker"]["serial_number"] == "T-1"
    machine = client.get("/api/v1/machines/current").json()
    assert machine["connected"] is True
    assert machine["motion"]["model"] == "Controller"


def test_a_device_that_does_not_answer_as_it_should_is_a_problem(
    client, make_cell, is_problem
):
    for refusal, status, code in (
        (ConnectionLost("no such port"), 502, "device-unreachable"),
        (DeviceTimeout("silence"), 504, "device-silent"),
        (WrongDevice("a printer"), 409, "device-identity"),
    ):
        make_cell.cell.refuses = refusal
        answer = client.post("/api/v1/machines/current:connect")
        assert is_problem(answer, status, code)["detail"] == str(refusal)


def test_the_process_is_alive_and_ready_unless_it_is_short_of_something(
    client, is_problem, monkeypatch
):
    assert client.get("/healthz").json() == {"status": "ok"}
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["checks"] == {"catalogue": True, "disk": True, "cell": True}
    monkeypatch.setattr(machine_routes, "LEAST_FREE_BYTES", 1 << 60)
    problem = is_problem(client.get("/readyz"), 503, "not-ready")
    assert problem["detail"] == "not ready: disk"


class TestWithoutAMachine:
    @pytest.fixture
    def has_machine(self):
        return False

    def test_nothing_is_measured_and_a_stop_is_still_taken(self, client, is_problem):
        system = client.get("/api/v1/system").json()
        assert system["machine"] is None
        assert system["cell"]["state"] == "none"
        ready = client.get("/readyz").json()
        assert (ready["status"], ready["checks"]["cell"]) == ("ready", False)
        is_problem(client.get("/api/v1/machines/current"), 404, "not-found")
        answer = client.post("/api/v1/machines/current:connect")
        is_problem(answer, 409, "no-machine")
        answer = client.post("/api/v1/jobs", json={"kind": "measure-otf"})
        problem = is_problem(answer, 409, "no-machine")
        assert "machine_file" in problem["action"]
        assert client.post("/api/v1/stop").status_code == 202
