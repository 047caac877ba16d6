"""Files of a machine whose control compensated, and what has changed by that."""

from __future__ import annotations

import json
import shutil

import pytest

from truepath.answers.history.machine_documents import Calibration, changes_json


@pytest.fixture
def job(service, finished, analysed):
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return finished["id"]


@pytest.fixture
def say_on(service, job):
    """Make the control say that it compensated, by these files where it is told."""

    def say(active=None):
        file = service.results / job / "result.json"
        content = json.loads(file.read_text())
        for one in (content["provenance"], *content["runs"]):
            one["source"] = {**one["source"], "control_compensation": "on"}
        content["provenance"]["active_tables"] = active
        file.write_text(json.dumps(content))

    return say


def shift_values(model):
    """Change what a model states by far more than its uncertainty."""
    for one in model["effects"]:
        if "values_um" in one:
            one["values_um"] = [1.5 * value for value in one["values_um"]]


def make(client, job, **order):
    return client.post(f"/api/v1/jobs/{job}/compensations", json=order)


def test_files_that_would_undo_unknown_tables_are_refused_until_these_are_given(
    client, job, say_on, is_problem
):
    first = make(client, job, format="linuxcnc").json()
    assert first["basis"]["holds"] == "as-measured"
    place = f"/api/v1/jobs/{job}/compensations/{first['id']}/files"
    texts = {name: client.get(f"{place}/{name}").text for name in first["files"]}
    say_on()
    is_problem(make(client, job, format="linuxcnc"), 422, "active-tables-unknown")
    given = make(client, job, format="linuxcnc", active_files=texts).json()
    assert given["basis"]["holds"] == "combined"
    part = make(client, job, format="linuxcnc", difference=True).json()
    assert part["basis"]["holds"] == "difference"
    assert len({first["id"], given["id"], part["id"]}) == 3
    bad = {**texts, "compensation-X.tbl": "no table"}
    is_problem(make(client, job, format="linuxcnc", active_files=bad), 422, "bad-input")
    named = {"../x.tbl": "0 0 0"}
    answer = make(client, job, format="linuxcnc", active_files=named)
    is_problem(answer, 422, "validation")


def test_tables_that_the_service_has_loaded_need_not_be_given(client, job, say_on):
    first = make(client, job, format="linuxcnc").json()
    say_on(first["files_sha256"])
    made = make(client, job, format="linuxcnc").json()
    assert made["basis"]["holds"] == "combined"
    assert made["id"].startswith("linuxcnc-10-hold-combined-")


def test_a_compensation_that_was_loaded_is_no_change_of_the_machine(
    service, job, say_on, tmp_path
):
    file = service.results / job / "result.json"
    content = json.loads(file.read_text())
    for run in content["provenance"]["runs"]:
        run["input_sha256"], run["sketch"] = "0" * 64, ""
    for one in (content["provenance"], *content["runs"]):
        one["source"] = {**one["source"], "control_compensation": "off"}
    shift_values(content["model"])
    before = tmp_path / "result.json"
    before.write_text(json.dumps(content))
    say_on()
    since, until = (
        Calibration("m", name, (), "2026-03-02T08:00:00Z", 1, "usable", place)
        for name, place in (("a", before), ("b", file))
    )
    found = changes_json(since, until)
    assert found["has_changed"] is False
    assert "compensation of the control was another" in found["text"][0]
