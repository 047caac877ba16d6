"""Certificates over REST: issued once, numbered, kept, never changed."""

from __future__ import annotations

import json
import shutil

import pypdf
import pytest

from truepath.catalogue.job import Job, JobKind
from truepath.service.api.models.base import PREFIX
from truepath.service.api.security.route_roles import LEAST_ROLES
from truepath.users.roles import Role


@pytest.fixture
def place(service, finished, analysed):
    """Address of the certificates of a job with that result."""
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return f"/api/v1/jobs/{finished['id']}/certificates"


def edit_verdict(service, place, state):
    file = service.results / place.split("/")[-2] / "result.json"
    content = json.loads(file.read_text())
    content["verdict"] = {"state": state, "reasons": ["too few lines"], "details": []}
    file.write_text(json.dumps(content))


def test_a_certificate_is_numbered_kept_listed_and_never_changed(
    client, service, place, tmp_path
):
    asked = {"language": "de", "identity": {"operator": "A. Weiß", "warm_up": "2 h"}}
    answer = client.post(place, json=asked)
    assert answer.status_code == 201, answer.text
    first = answer.json()
    assert answer.headers["location"] == first["links"]["self"]
    page = client.get(first["links"]["html"])
    assert "Kalibrierschein" in page.text
    assert first["number"] in page.text
    assert "sandbox" in page.headers["content-security-policy"]
    printed = client.get(first["links"]["pdf"]).content
    (tmp_path / "c.pdf").write_bytes(printed)
    assert "A. Weiß" in pypdf.PdfReader(tmp_path / "c.pdf").pages[0].extract_text()
    second = client.post(place, json={}).json()
    assert second["number"] != first["number"]
    assert second["identity"] == {"operator": "A. Weiß"}
    listed = client.get(place).json()
    assert [one["number"] for one in listed["items"]] == [
        first["number"],
        second["number"],
    ]
    assert listed["identity"] == {"operator": "A. Weiß"}
    edit_verdict(service, place, "doubtful")
    assert client.get(first["links"]["self"]).json() == first
    assert client.get(first["links"]["pdf"]).content == printed
    assert client.put(first["links"]["self"], json={}).status_code == 405
    assert client.delete(first["links"]["self"]).status_code == 405


def test_what_the_registry_states_of_the_machine_need_not_be_stated_again(
    client, service, place
):
    job = service.store.get(place.split("/")[-2])
    assert job.machine is not None
    service.setup.registry.change(job.machine, serial_number="4711", place="Hall 3")
    assert client.get(place).json()["identity"] == {
        "machine_serial": "4711",
        "place": "Hall 3",
    }
    asked = {"identity": {"place": "Hall 4"}}
    assert client.post(place, json=asked).json()["identity"] == {
        "machine_serial": "4711",
        "place": "Hall 4",
    }


def test_what_is_stated_on_a_certificate_stands_in_the_registry(client, service, place):
    stated = {"machine_serial": "4711", "operator": "A. Weiß", "warm_up": "2 h"}
    client.post(place, json={"identity": stated})
    record = service.setup.registry.get("default")
    assert (record.serial_number, record.stated) == ("4711", {"operator": "A. Weiß"})
    client.patch("/api/v1/machines/default", json={"serial_number": "4712"})
    assert client.get(place).json()["identity"] == {
        "machine_serial": "4712",
        "operator": "A. Weiß",
    }


def test_a_result_not_to_be_used_has_one_only_if_that_is_accepted(
    client, service, place, is_problem
):
    edit_verdict(service, place, "not-usable")
    is_problem(client.post(place, json={}), 422, "not-usable")
    assert client.get(place).json()["items"] == []
    taken = client.post(place, json={"accept_verdict": True}).json()
    assert taken["verdict"] == "not-usable"
    assert "NOT TO BE USED" in client.get(taken["links"]["html"]).text


@pytest.mark.parametrize(
    ("asked", "status", "code"),
    [
        ({"language": "fr"}, 422, "validation"),
        ({"identity": {"opertor": "A"}}, 422, "validation"),
        ({"identity": {"operator": "A\nB"}}, 422, "validation"),
        ({"compensation_id": "../../x"}, 422, "validation"),
        ({"as_left_job": "019a3f6b"}, 404, "not-found"),
    ],
)
def test_what_cannot_be_issued_is_refused(
    client, place, is_problem, asked, status, code
):
    is_problem(client.post(place, json=asked), status, code)


def test_the_result_itself_does_not_state_the_machine_as_left(
    client, place, is_problem
):
    answer = client.post(place, json={"as_left_job": place.split("/")[-2]})
    problem = is_problem(answer, 422, "bundle")
    assert "measure again with the compensation active" in json.dumps(problem)
    assert client.get(place).json()["items"] == []


def test_the_files_of_a_verification_are_stated_without_being_named_again(
    client, service, place
):
    job = place.split("/")[-2]
    kept = client.post(f"/api/v1/jobs/{job}/compensations", json={"format": "json"})
    asked = {"result_id": job, "compensation_id": kept.json()["id"]}
    proof, _ = service.store.create(Job(JobKind.VERIFY), plan={"request": asked})
    folder = service.results / proof.id
    folder.mkdir()
    active = {"format": "json", "files_sha256": kept.json()["files_sha256"]}
    content = {"schema": "verification/1", "compensated": True, "compensation": active}
    (folder / "verification.json").write_text(json.dumps(content))
    order = {"verification_job": proof.id}
    page = client.get(client.post(place, json=order).json()["links"]["html"]).text
    assert "With the files, as the control reads them" in page
    shutil.rmtree(service.results / job / "compensations")
    page = client.get(client.post(place, json=order).json()["links"]["html"]).text
    assert "these files of the format json active" in page


def test_a_job_without_a_result_has_no_certificate(
    client, service, finished, is_problem
):
    (service.results / finished["id"] / "result.json").unlink(missing_ok=True)
    answer = client.post(f"/api/v1/jobs/{finished['id']}/certificates", json={})
    is_problem(answer, 404, "not-found")


def test_metrologists_issue_and_everybody_reads():
    route = f"{PREFIX}/jobs/{{job_id}}/certificates"
    assert LEAST_ROLES[f"POST {route}"] is Role.METROLOGIST
    assert LEAST_ROLES[f"GET {route}"] is Role.VIEWER
