"""PostgreSQL restarts, crashes or freezes while the service moves a machine."""

import time

import pytest

from postgres_server import PostgresServer
from real_services import process
from service_process import ENDS, ROWS, begin_moving, wait_for

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]
FROZEN_S = 10.0


@pytest.fixture(scope="module")
def server():
    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture(scope="module")
def service(server, tmp_path_factory):
    folder = tmp_path_factory.mktemp("service")
    with process(folder, TRUEPATH_DATABASE_URL=server.url()) as (_, client):
        yield client


@pytest.fixture
def job(service):
    return begin_moving(service, 3 * ROWS)


@pytest.mark.fault_row(37)
@pytest.mark.parametrize("mode", ["fast", "immediate"])
def test_a_measurement_outlives_a_restart_of_the_database(server, service, job, mode):
    before = service.get(f"/api/v1/jobs/{job}").json()
    server.stop(mode)
    server.start()
    ended = _follow(service, job)
    assert ended["state"] == "succeeded", ended
    run = service.get(f"/api/v1/runs/{ended['run_id']}").json()
    assert run["complete"]
    assert run["samples"] > before["health"]["samples"]
    assert service.get(ended["result"]["error_tables_json"]).status_code == 200


@pytest.mark.fault_row(37)
def test_a_frozen_database_bounds_answers_and_stops(server, service, job, measured):
    server.freeze()
    try:
        end = time.monotonic() + FROZEN_S
        begun = time.monotonic()
        assert service.get(f"/api/v1/jobs/{job}").status_code == 503
        assert time.monotonic() - begun < 9.0
        begun = time.monotonic()
        assert service.post("/api/v1/stop").status_code == 202
        took_s = time.monotonic() - begun
        assert took_s < 5.0
        measured(f"database frozen: stop taken after {took_s:.2f} s")
        time.sleep(max(0.0, end - time.monotonic()))  # what is tested: time passes
    finally:
        server.thaw()
    ended = _follow(service, job)
    assert ended["state"] == "aborted", ended
    assert service.get(f"/api/v1/runs/{ended['run_id']}").json()["samples"] > 0


def _follow(client, job):
    """Wait until the job has ended or waits for somebody, the database being back."""

    def settled():
        answer = client.get(f"/api/v1/jobs/{job}")
        return answer.is_success and answer.json()["state"] in {*ENDS, "paused"}

    wait_for(settled, "the end of the job")
    return client.get(f"/api/v1/jobs/{job}").json()
