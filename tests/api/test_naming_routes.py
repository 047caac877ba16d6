"""Names and notes of jobs and Runs, and lists by them."""

from __future__ import annotations

from dataclasses import replace

import pytest

JOBS, RUNS = "/api/v1/jobs", "/api/v1/runs"


@pytest.fixture
def run(client, bundle):
    file = {"bundle": ("mill.zip", bundle())}
    return client.post(RUNS, files=file).json()


def test_a_job_gets_name_and_note_without_a_new_version(client, service, ready):
    at = f"{JOBS}/{ready['id']}"
    assert (ready["name"], ready["note"]) == ("", "")
    event = service.store.read_last_event_id()
    named = client.patch(at, json={"name": "As found, Müller"})
    assert named.status_code == 200, named.text
    noted = client.patch(at, json={"note": "Warm since 8:00.\nDoor open."}).json()
    assert noted["name"] == "As found, Müller"
    assert noted == client.get(at).json()
    assert noted["version"] == ready["version"]
    assert service.store.read_last_event_id() == event + 2
    client.patch(at, json={"name": "As found, Müller"})
    assert service.store.read_last_event_id() == event + 2
    newest = client.get("/api/v1/audit").json()["items"]
    changed = [one for one in newest if one["what"] == f"PATCH {at}"]
    assert changed[1]["new"] == {"note": noted["note"]}


def test_who_changes_a_job_as_it_was_before_leaves_its_name(client, service, ready):
    client.patch(f"{JOBS}/{ready['id']}", json={"name": "As found"})
    service.store.change(ready["id"], lambda job: replace(job, name="", note="old"))
    job = client.get(f"{JOBS}/{ready['id']}").json()
    assert (job["name"], job["note"]) == ("As found", "")


def test_a_run_is_renamed_and_noted(client, run):
    at = f"{RUNS}/{run['id']}"
    named = client.patch(at, json={"name": "Before", "note": "as found"}).json()
    assert (named["name"], named["note"]) == ("Before", "as found")
    assert client.get(at).json() == named
    assert named["sha256"] == run["sha256"]


@pytest.mark.parametrize(
    "body",
    [
        {"name": "a\x00b"},
        {"name": "two\nlines"},
        {"name": "\u202egnp.exe"},
        {"note": "\x1b[2J"},
        {"name": 200 * "ab"},
        {"note": 2001 * "n"},
        {"owner": "bert"},
    ],
)
def test_names_are_short_and_of_letters(client, ready, run, is_problem, body):
    for at in (f"{JOBS}/{ready['id']}", f"{RUNS}/{run['id']}"):
        is_problem(client.patch(at, json=body), 422, "validation")


def test_a_run_keeps_a_name(client, run, is_problem):
    answer = client.patch(f"{RUNS}/{run['id']}", json={"name": ""})
    is_problem(answer, 422, "validation")


def test_jobs_and_runs_are_listed_by_a_part_of_their_name(client, ready, run):
    client.patch(f"{JOBS}/{ready['id']}", json={"name": "Vor der Spindel ÄÖ 100%_a"})
    client.patch(f"{RUNS}/{run['id']}", json={"name": "Vor der Spindel ÄÖ 100%_a"})
    for at in (JOBS, RUNS):
        for part, count in (("SPINDEL äö", 1), ("0%_", 1), ("0_", 0), ("%x", 0)):
            found = client.get(at, params={"name": part}).json()["items"]
            assert len(found) == count, part


def test_runs_are_listed_by_machine_mode_and_time(client, run):
    for asked, count in (
        ({"machine": run["machine"]}, 1),
        ({"machine": "default"}, 1),
        ({"machine": "another"}, 0),
        ({"mode": "otf"}, 1),
        ({"mode": "standstill"}, 0),
        ({"since": run["created"]}, 1),
        ({"until": run["created"]}, 0),
    ):
        assert len(client.get(RUNS, params=asked).json()["items"]) == count, asked


def test_pages_of_a_filtered_list_lead_on(client, bundle):
    for number in range(5):
        client.post(RUNS, files={"bundle": (f"run {number % 2}.zip", bundle())})
    first = client.get(RUNS, params={"name": "RUN 0", "limit": 2})
    assert "name=RUN" in first.headers["Link"]
    after = {"name": "RUN 0", "limit": 2, "after": first.json()["next"]}
    second = client.get(RUNS, params=after).json()
    assert [len(first.json()["items"]), len(second["items"])] == [2, 1]
    assert second["next"] is None
