"""A measurement with the catalogue on PostgreSQL; --database runs all tests on it."""

import pytest

from truepath.jobs.dispatch import catalogue_rebuild as rebuilding


@pytest.fixture
def database_kind():
    return "postgresql"


def test_a_measurement_and_a_rebuild(client, finished, service, make_catalogue_url):
    assert service.database.engine.dialect.name == "postgresql"
    assert client.get(f"/api/v1/runs/{finished['run_id']}").json()["samples"] > 0
    assert client.get("/api/v1/jobs").json()["items"][0]["id"] == finished["id"]
    for method, address in (("POST", "jobs/%00/abort"), ("GET", "runs/%00")):
        assert client.request(method, f"/api/v1/{address}").status_code == 400
    database = type(service.database)(make_catalogue_url("postgresql"))
    folder = service.results.parent / "runs"
    lost = rebuilding.check_against_disk(database, folder)["runs_without_row"]
    assert lost == [finished["run_id"]]
    recovered = rebuilding.rebuild_catalogue(database, folder, service.results)
    assert (recovered.runs, recovered.aside) == (1, None)
    assert rebuilding.check_against_disk(database, folder)["runs_without_row"] == []
    database.close()
