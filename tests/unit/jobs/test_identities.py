"""What is kept of machines: what certificates state, the order of calibrations."""

import json
from pathlib import Path

import pytest

from truepath.answers.history.machine_documents import Calibration
from truepath.catalogue import machine_registry as kept
from truepath.catalogue.calibrations import sort_by_time
from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.machine_registry import (
    CATALOGUE,
    MachineRegistry,
    describe_identity,
    find_machine,
)


@pytest.fixture
def registry(database):
    found = MachineRegistry(database)
    found.record_configuration("mill-3", CATALOGUE, {"name": "mill"}, {})
    return found


@pytest.mark.database
def test_identities_of_earlier_versions_are_taken_over_once(registry, tmp_path):
    file = tmp_path / "identities.json"
    lathe = {"operator": "B"}
    mill = {"serial_number": "4711", "place": "Hall 3", "tracker_serial_number": "7"}
    earlier = {"machine_serial": "4711", "place": "Hall 3", "tracker_serial": "7"}
    content = {"schema": "identities/1", "machines": {"mill": earlier, "lathe": lathe}}
    file.write_text(json.dumps(content))
    registry.change("mill-3", place="Hall 4")
    kept.take_over_identities(tmp_path, registry)
    assert describe_identity(registry.get("mill-3")) == {**mill, "place": "Hall 4"}
    assert json.loads(file.read_text())["machines"] == {"lathe": lathe}
    registry.change("mill-3", serial_number="4712")
    registry.record_configuration("lathe", CATALOGUE, {"name": "lathe"}, {})
    kept.take_over_identities(tmp_path, registry)
    assert registry.get("mill-3").serial_number == "4712"
    assert registry.get("lathe").stated == lathe
    assert not file.exists()
    kept.take_over_identities(tmp_path, registry)


@pytest.mark.database
def test_a_result_is_of_its_jobs_machine_or_of_the_one_of_its_name(registry):
    mine = find_machine(Job(JobKind.ANALYSE, machine="mill-3"), "other", registry)
    named = find_machine(Job(JobKind.ANALYSE), "mill", registry)
    assert mine == named == registry.get("mill-3")
    assert find_machine(Job(JobKind.ANALYSE), "press", registry) is None
    assert find_machine(Job(JobKind.ANALYSE, machine="gone"), "mill", registry) is None


@pytest.mark.database
def test_what_is_stated_of_a_machine_alone_is_kept_by_the_name_of_today(registry):
    registry.change("mill-3", stated={"tracker_serial": "7"})
    assert describe_identity(registry.get("mill-3")) == {"tracker_serial_number": "7"}
    now = {"tracker_serial_number": "8"}
    kept.store_identity(registry.get("mill-3"), now, registry)
    assert registry.get("mill-3").stated == now
    registry.change("mill-3", stated={})
    assert kept.store_identity(None, {"operator": "A"}, registry) == {"operator": "A"}
    record = registry.get("mill-3")
    now = {"operator": "A", "measured_on": "2026-11-24"}
    assert kept.store_identity(record, now, registry) == now
    assert describe_identity(registry.get("mill-3")) == {"operator": "A"}


def calibration(name, measured, *, is_time_stated=True):
    files = (name,), measured, 1, None, Path(name)
    return Calibration("mill", name, *files, is_time_stated)


def names(*found):
    return [one.job_id for one in sort_by_time(found)]


def test_what_was_recorded_here_stands_in_its_order_whatever_the_clock_said():
    first = calibration("first", "2026-03-01T00:00:00Z")
    wrong = calibration("wrong", "2099-01-01T00:00:00Z")
    newest = calibration("newest", "2026-05-01T00:00:00Z")
    back = calibration("back", "1970-01-01T00:00:00Z")
    assert names((wrong, 5), (newest, 7), (first, 3)) == ["first", "wrong", "newest"]
    assert names((back, 8), (newest, 7), (first, 3)) == ["first", "newest", "back"]
    # What was uploaded stands by its time.
    recorded = calibration("recorded", "2026-03-01T00:00:00Z")
    older = calibration("older", "2026-01-01T00:00:00Z")
    newer = calibration("newer", "2026-04-01T00:00:00Z")
    no_time = calibration("no time", "2026-09-01T00:00:00Z", is_time_stated=False)
    found = names((recorded, 1), (newer, None), (older, None), (no_time, None))
    assert found == ["no time", "older", "recorded", "newer"]
