"""The system over REST, and `GET /metrics` read by the parser of Prometheus."""

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from scripted_cell import wait_until
from truepath.catalogue.errors import StorageUnavailable
from truepath.machines.cell_counters import CellCounters
from truepath.measurement import messages
from truepath.measurement.time_limits import BOUNDS_S, DurationHistogram
from truepath.service.api.application import create_application
from truepath.service.api.routes import machine as machine_routes
from truepath_drivers.interfaces import errors


@pytest.fixture
def scrape(client):
    def read(http=client):
        answer = http.get("/metrics")
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
        return {
            (sample.name, *sorted(sample.labels.items())): sample.value
            for family in text_string_to_metric_families(answer.text)
            for sample in family.samples
        }

    return read


def progress(samples, **counted):
    known = 1, 2, "lines", "measuring", 1.0, 1.0
    return messages.MeasurementProgress(*known, samples=samples, **counted)


@pytest.mark.database
def test_the_format_is_that_of_prometheus(scrape, service, monkeypatch):
    found = scrape()
    machine = ("machine", "default")
    assert found["truepath_cell_up", machine] == 1
    assert found["truepath_cell_connected", machine] == 0
    assert found["truepath_catalogue_up",] == 1
    assert found["truepath_disk_free_bytes",] > 0
    assert found["truepath_event_streams",] == 0
    info = ("simulated", "true"), ("version", "1.2.3")
    assert found[("truepath_info", *info)] == 1
    assert found["truepath_tracker_crc_errors_total", machine] == 0
    assert found["process_resident_memory_bytes",] > 1e6

    def refuse(_):
        raise StorageUnavailable("away")

    monkeypatch.setattr(type(service.store), "count_by_state", refuse)
    assert scrape()["truepath_catalogue_up",] == 0  # a number and no failure


def test_requests_are_counted_by_the_template_of_their_route(client, service, scrape):
    client.get("/api/v1/jobs/019a0000-0000-7000-8000-000000000000")
    client.get("/nowhere/019a")
    found = scrape()
    template = ("route", "/api/v1/jobs/{job_id}"), ("status", "404")
    key = ("truepath_request_seconds_count", ("method", "GET"), *template)
    assert found[key] == 1
    none = key[0], key[1], ("route", "none"), ("status", "404")
    assert found[none] == 1
    assert not [name for name in found if "019a" in str(name)]
    with TestClient(create_application(service), base_url="http://localhost") as other:
        routes = {dict(key[1:]).get("route") for key in scrape(other)}
    assert "/api/v1/jobs/{job_id}" not in routes


@pytest.mark.database
def test_a_measurement_times_its_commands(client, armed, scrape, make_cell, until):
    client.post(f"/api/v1/jobs/{armed['id']}/abort")
    until(armed, "aborted")
    machine = ("machine", "default")
    count = "truepath_cell_command_seconds_count"
    abort = count, ("command", "abort"), machine
    found = wait_until(lambda: (now := scrape()).get(abort) and now, "the abort")
    key = ("kind", "measure-otf"), ("state", "aborted")
    assert found[("truepath_jobs", *key)] == 1
    assert found[count, ("command", "begin"), machine] == found[abort] == 1
    upto = [
        number
        for (name, *labels), number in found.items()
        if name == count.replace("count", "bucket") and ("command", "abort") in labels
    ]
    assert len(upto) == len(BOUNDS_S) + 1
    assert upto == sorted(upto)
    assert (upto[-1], {*upto}) == (1, {0, 1}), "cumulative, as of a histogram"


def test_counts_of_measurements_add_up_and_never_fall():
    counters = CellCounters()
    commits = DurationHistogram().add(0.02)
    counters.begin_measurement()
    counters.count(progress(100, lost_samples=2, crc_errors=5, gaps=1, commits=commits))
    counters.count(messages.RunClosed("", "finished", samples=110, lost_samples=2))
    counters.begin_measurement()
    counters.count(progress(50, lost_samples=1, crc_errors=6, gaps=1, commits=commits))
    found = counters.read()
    assert (found.samples, found.lost_samples, found.gaps) == (160, 3, 2)
    assert found.crc_errors == 6, "those of a connection, not of a measurement"
    assert sum(found.commits.counts) == 2
    counters.count(progress(60, crc_errors=1))  # connected anew
    assert counters.read().crc_errors == 7


def test_a_repeated_command_is_timed_from_its_first_time(hand_clock):
    counters = CellCounters()
    for hand_clock.time_s in (10.0, 11.0):
        counters.expect_answer(messages.CellVerb.PAUSE)
    hand_clock.time_s = 12.5
    counters.count(messages.StateChanged(messages.CellState.PAUSED))
    counters.count(messages.StateChanged(messages.CellState.PAUSED))
    (pause,) = counters.read().commands.values()
    assert (sum(pause.counts), pause.total_s) == (1, 2.5)


def test_the_system_says_what_it_is_and_lacks(client, is_problem, monkeypatch):
    assert client.get("/healthz").json() == {"status": "ok"}
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["checks"] == {"catalogue": True, "disk": True, "cell": True}
    with monkeypatch.context() as patch:
        patch.setattr(machine_routes, "LEAST_FREE_BYTES", 1 << 60)
        problem = is_problem(client.get("/readyz"), 503, "not-ready")
    assert problem["detail"] == "not ready: disk"
    system = client.get("/api/v1/system").json()
    assert (system["version"], system["simulated"]) == ("1.2.3", True)
    assert (system["machine"]["name"], system["current_job"]) == ("demo", None)
    assert system["cell"]["state"] == "disconnected"
    machine = client.get("/api/v1/machines/current").json()
    assert (machine["connected"], machine["tracker"]) == (False, None)
    assert machine["tracker_noise"]["rate_hz"] == 500
    answer = client.post("/api/v1/machines/current:connect")
    assert answer.json()["tracker"]["serial_number"] == "T-1"
    machine = client.get("/api/v1/machines/current").json()
    assert (machine["connected"], machine["motion"]["model"]) == (True, "Controller")


def test_a_device_that_answers_wrongly_is_a_problem(client, make_cell, is_problem):
    for refusal, status, code in (
        (errors.ConnectionLost("no such port"), 502, "device-unreachable"),
        (errors.DeviceTimeout("silence"), 504, "device-silent"),
        (errors.WrongDevice("a printer"), 409, "device-identity"),
    ):
        make_cell.cell.refuses = refusal
        answer = client.post("/api/v1/machines/current:connect")
        assert is_problem(answer, status, code)["detail"] == str(refusal)


@pytest.mark.parametrize("has_machine", [False])
def test_without_a_machine_a_stop_alone_is_taken(client, is_problem):
    system = client.get("/api/v1/system").json()
    assert (system["machine"], system["cell"]["state"]) == (None, "none")
    ready = client.get("/readyz").json()
    assert (ready["status"], ready["checks"]["cell"]) == ("ready", False)
    is_problem(client.get("/api/v1/machines/current"), 404, "not-found")
    is_problem(client.post("/api/v1/machines/current:connect"), 409, "no-machine")
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf"})
    assert "machine_file" in is_problem(answer, 409, "no-machine")["action"]
    assert client.post("/api/v1/stop").status_code == 202
