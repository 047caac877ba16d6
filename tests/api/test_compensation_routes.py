"""Compensation files over REST: what they leave is said before they are taken."""

from __future__ import annotations

import io
import json
import shutil
import zipfile

import pytest

from truepath.compensation.export import export_files
from truepath.compensation.tables.unmeasured import Unmeasured


@pytest.fixture
def place(service, finished, analysed):
    """Address of the compensations of a job with that result."""
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return f"/api/v1/jobs/{finished['id']}/compensations"


def edit_verdict(service, place, reason):
    file = service.results / place.split("/")[-2] / "result.json"
    content = json.loads(file.read_text())
    content["verdict"] = {"state": reason, "reasons": ["too few lines"], "details": []}
    file.write_text(json.dumps(content))


def test_formats_say_what_each_carries(client):
    items = client.get("/api/v1/compensation-formats").json()["items"]
    known = {item["name"]: item for item in items}
    assert known["linuxcnc"]["carries"].startswith("positioning of each axis")
    assert known["linuxcnc"]["sign"]["verified"]
    assert not known["heidenhain"]["sign"]["verified"]
    assert known["siemens"]["most_rows"] == 500


def test_what_files_leave_is_said_before_they_are_taken(client, place):
    answer = client.post(place, json={"format": "linuxcnc"})
    assert answer.status_code == 201
    made = answer.json()
    assert answer.headers["location"] == made["links"]["self"]
    error = made["volumetric_error_um"]
    assert 0.0 < error["after"]["mean"] < error["before"]["mean"]
    assert error["after"]["mean_uncertainty"] > 0.0
    assert made["left_um"]["not_carried"] > made["left_um"]["rounding"]
    assert client.get(made["links"]["self"]).json() == made


def test_the_files_are_those_of_the_command_line(client, place, analysed, tmp_path):
    made = client.post(place, json={"format": "linuxcnc", "spacing_mm": 25}).json()
    output = tmp_path / "compensation"
    account = export_files(analysed / "result.json", "linuxcnc", output, spacing_mm=25)
    assert len(made["files"]) == len(account["files"]) == 3
    for name, file in zip(made["files"], account["files"], strict=True):
        taken = client.get(f"{made['links']['self']}/files/{name}")
        assert taken.content == (tmp_path / file).read_bytes()
        assert name in taken.headers["content-disposition"]
    packed = client.get(made["links"]["archive"])
    with zipfile.ZipFile(io.BytesIO(packed.content)) as archive:
        assert set(archive.namelist()) == {*made["files"], "compensation.json"}


def test_the_account_is_that_of_the_command_line(client, place, analysed, tmp_path):
    choices = {"measuring_system": "X=2,Y=1"}
    order = {"format": "siemens", "unmeasured": "fade", "choices": choices}
    made = client.post(place, json=order).json()
    account = export_files(
        analysed / "result.json",
        "siemens",
        tmp_path / "compensation",
        unmeasured=Unmeasured.FADE,
        choices=choices,
    )
    own = {"files", "verdict", "schema", "id", "links"}
    shared = (set(made) & set(account)) - own
    assert shared >= {"volumetric_error_um", "left_um", "tables", "unmeasured", "note"}
    told = {key: account[key] for key in shared - {"provenance"}}
    del told["basis"]["active"]  # whole files
    assert {key: made[key] for key in told} == json.loads(json.dumps(told))
    assert made["verdict"] == account["verdict"]["state"]
    assert client.get(made["links"]["self"]).json() == made
    lec = client.get(f"{made['links']['self']}/files/compensation-lec.ini")
    assert "$AA_ENC_COMP[1,0,X1]" in lec.text


def test_a_choice_by_axis_is_listed_and_refused_like_another(client, place, is_problem):
    formats = client.get("/api/v1/compensation-formats").json()["items"]
    by_axis = {one["name"]: one["by_axis"] for one in formats}
    assert by_axis["siemens"] == by_axis["siemens-lec"] == ["measuring_system"]
    assert by_axis["linuxcnc"] == by_axis["siemens-cec"] == []
    for word in ("X=3", "A=2"):
        order = {"format": "siemens", "choices": {"measuring_system": word}}
        is_problem(client.post(place, json=order), 422, "bad-input")


def test_files_are_kept_with_the_result_and_made_once(client, service, place):
    for name in ("siemens", "fanuc", "siemens"):
        assert client.post(place, json={"format": name}).status_code == 201
    items = client.get(place).json()["items"]
    assert [item["id"] for item in items] == ["fanuc-10-hold", "siemens-10-hold"]


def test_spacings_that_differ_have_files_of_their_own(client, place):
    ids = {
        client.post(place, json={"format": "fanuc", "spacing_mm": spacing}).json()["id"]
        for spacing in (12.345678, 12.345681)
    }
    assert len(ids) == 2


def test_a_result_that_is_not_to_be_used_makes_files_only_if_accepted(
    client, service, place, is_problem
):
    edit_verdict(service, place, "not-usable")
    asked = {"format": "linuxcnc"}
    refusal = is_problem(client.post(place, json=asked), 422, "not-usable")
    assert "accept_verdict" in refusal["action"]
    assert client.get(place).json()["items"] == []
    taken = client.post(place, json={**asked, "accept_verdict": True})
    assert taken.status_code == 201
    assert taken.json()["verdict"] == "not-usable"


@pytest.mark.parametrize(
    ("asked", "code", "detail"),
    [
        ({"format": "vcs"}, "bad-input", "installed: csv, etalon"),
        ({"format": "linuxcnc", "spacing_mm": 0}, "validation", "spacing_mm"),
        ({"format": "linuxcnc", "unmeasured": "guess"}, "validation", "unmeasured"),
        ({"format": "../linuxcnc"}, "bad-input", "installed: csv, etalon"),
    ],
)
def test_what_cannot_be_made_says_why(client, place, is_problem, asked, code, detail):
    refusal = is_problem(client.post(place, json=asked), 422, code)
    assert detail in json.dumps(refusal)
    assert client.get(place).json()["items"] == []


@pytest.mark.parametrize(
    "name", ["result.json", "..%2F..%2Fresult.json", "compensation-Q.tbl"]
)
def test_no_other_file_is_given_out(client, place, is_problem, name):
    made = client.post(place, json={"format": "linuxcnc"}).json()
    answer = client.get(f"{made['links']['self']}/files/{name}")
    is_problem(answer, 404, "not-found")
    is_problem(client.get(f"{place}/linuxcnc-11-hold"), 404, "not-found")
    is_problem(client.get(f"{place}/..%2F..%2F../archive"), 404, "not-found")


def test_a_job_without_a_result_has_no_files(client, ready, is_problem):
    address = f"/api/v1/jobs/{ready['id']}/compensations"
    assert client.get(address).json() == {"items": []}
    is_problem(client.post(address, json={"format": "linuxcnc"}), 404, "not-found")
