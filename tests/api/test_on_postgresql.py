"""A few routes with the catalogue on PostgreSQL; --database runs all of them on it."""

from __future__ import annotations

import pytest

from truepath.jobs.dispatch.catalogue_rebuild import (
    check_against_disk,
    rebuild_catalogue,
)


@pytest.fixture
def database_kind():
    return "postgresql"


def test_a_measurement_ends_with_its_run_in_the_catalogue(client, finished, service):
    assert service.database.engine.dialect.name == "postgresql"
    run = client.get(f"/api/v1/runs/{finished['run_id']}").json()
    assert run["samples"] > 0
    assert client.get("/api/v1/jobs").json()["items"][0]["id"] == finished["id"]


def test_nul_in_texts_is_refused(client):
    for method, address in (
        ("POST", "/api/v1/jobs/%00/abort"),
        ("GET", "/api/v1/runs/%00"),
    ):
        assert client.request(method, address).status_code == 400
    key = {"Idempotency-Key": "a\0b"}
    answer = client.post("/api/v1/jobs", json={"kind": "measure-otf"}, headers=key)
    assert 400 <= answer.status_code < 500
    order = {"kind": "analyse", "run_id": "a\0b"}
    assert 400 <= client.post("/api/v1/jobs", json=order).status_code < 500


def test_a_catalogue_that_lost_its_rows_is_checked_and_rebuilt(
    finished, service, make_catalogue_url
):
    database = type(service.database)(make_catalogue_url("postgresql"))
    folder = service.results.parent / "runs"
    assert check_against_disk(database, folder)["runs_without_row"] == [
        finished["run_id"]
    ]
    recovered = rebuild_catalogue(database, folder, service.results)
    assert (recovered.runs, recovered.aside) == (1, None)
    assert check_against_disk(database, folder)["runs_without_row"] == []
    database.close()
