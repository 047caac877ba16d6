"""Backups of a real service that measures, and on PostgreSQL."""

from contextlib import closing

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from service_process import ROWS, arm, create, follow, moving
from truepath.catalogue.store.database import Database
from truepath.errors import BadInput
from truepath.jobs.dispatch.catalogue_rebuild import check_against_disk
from truepath.main import open_service
from truepath.operation.backup import make_backup, restore_backup
from truepath.service.api.application import create_application
from truepath.settings import load_settings


@pytest.mark.long
@pytest.mark.timeout(240)
def test_a_measurement_under_way_is_counted_and_does_not_hinder_a_backup(tmp_path):
    settings = load_settings(
        data_dir=tmp_path / "data", simulated=True, simulated_speed=4.0, port=0
    )
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        client.post("/api/v1/machines/current:connect")
        job = create(client, path=ROWS)
        arm(client, job)
        moving(client, job["id"])
        metrics = client.get("/metrics").text
        kept = make_backup(settings, tmp_path / "kept")
        assert client.get(f"/api/v1/jobs/{job['id']}").json()["state"] == "running"
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        follow(client, job["id"], "aborted")
    assert list(kept.left_out) == [f"runs/{job['id']}.sqlite"]
    restored = load_settings(data_dir=tmp_path / "elsewhere")
    assert restore_backup(restored, tmp_path / "kept").rows["jobs"] == 1
    # It is counted as Prometheus reads it.
    found = {
        sample.name: sample.value
        for family in text_string_to_metric_families(metrics)
        for sample in family.samples
        if sample.labels.get("machine") == "default"
    }
    assert found["truepath_tracker_samples_total"] > 500
    gaps = found["truepath_tracker_gaps_total"]
    assert gaps <= found["truepath_tracker_samples_total"]
    assert found["truepath_recorder_commit_seconds_count"] > 5
    assert found["truepath_recorder_commit_seconds_sum"] > 0
    assert 0 <= found["truepath_recorder_queue_depth"] < 200
    assert found["truepath_cell_connected"] == 1


def test_a_backup_is_restored_to_an_empty_database_of_postgresql(
    backups, postgres_server, tmp_path
):
    name = postgres_server.make_database()
    url, target = postgres_server.url(name), tmp_path / "elsewhere"
    settings = load_settings(data_dir=target, database_url=url)
    kept = restore_backup(settings, backups.folder / "folder")
    with closing(Database(url)) as database:
        found = check_against_disk(database, target / "runs")
        assert (found["jobs"], found["rows_without_file"]) == (kept.rows["jobs"], [])
    other = load_settings(data_dir=tmp_path / "third", database_url=url)
    with pytest.raises(BadInput, match="not empty"):
        restore_backup(other, backups.folder / "folder")
    assert [one.name for one in (tmp_path / "third").iterdir()] == [".lock"]
    postgres_server.drop_database(name)
