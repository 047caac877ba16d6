"""The registry keeps what certificates state, and takes over what a file kept."""

from __future__ import annotations

import json

import pytest

from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.machine_registry import CATALOGUE, MachineRegistry
from truepath.catalogue.store.database import Database
from truepath.jobs.dispatch.identities import (
    describe_identity,
    find_machine,
    keep_identity,
    take_over_identities,
)


@pytest.fixture
def registry(catalogue_url):
    database = Database(catalogue_url)
    found = MachineRegistry(database)
    found.note("mill-3", CATALOGUE, {"name": "mill"}, {})
    yield found
    database.close()


def test_identities_of_earlier_versions_are_taken_over_once(registry, tmp_path):
    file = tmp_path / "identities.json"
    lathe = {"operator": "B"}
    mill = {"machine_serial": "4711", "place": "Hall 3", "laboratory": "Lab"}
    content = {"schema": "identities/1", "machines": {"mill": mill, "lathe": lathe}}
    file.write_text(json.dumps(content))
    registry.change("mill-3", place="Hall 4")
    take_over_identities(tmp_path, registry)
    assert describe_identity(registry.get("mill-3")) == {**mill, "place": "Hall 4"}
    assert json.loads(file.read_text())["machines"] == {"lathe": lathe}
    registry.change("mill-3", serial_number="4712")
    registry.note("lathe", CATALOGUE, {"name": "lathe"}, {})
    take_over_identities(tmp_path, registry)
    assert registry.get("mill-3").serial_number == "4712"
    assert registry.get("lathe").stated == lathe
    assert not file.exists()
    take_over_identities(tmp_path, registry)


def test_a_result_is_of_its_jobs_machine_or_of_the_one_of_its_name(registry):
    mine = find_machine(Job(JobKind.ANALYSE, machine="mill-3"), "other", registry)
    named = find_machine(Job(JobKind.ANALYSE), "mill", registry)
    assert mine == named == registry.get("mill-3")
    assert find_machine(Job(JobKind.ANALYSE), "press", registry) is None
    assert find_machine(Job(JobKind.ANALYSE, machine="gone"), "mill", registry) is None


def test_what_is_stated_of_an_unknown_machine_or_one_measurement_is_not_kept(registry):
    assert keep_identity(None, {"operator": "A"}, registry) == {"operator": "A"}
    record = registry.get("mill-3")
    now = {"operator": "A", "measured_on": "2026-11-24"}
    assert keep_identity(record, now, registry) == now
    assert describe_identity(registry.get("mill-3")) == {"operator": "A"}
