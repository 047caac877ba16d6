"""Of a result over REST: certificates, comparisons, its volumetric error."""

import json
import shutil

import numpy as np
import pytest

from api_builders import edited, set_verdict
from truepath.answers.certificate import issued_certificates
from truepath.catalogue.job import Job, JobKind
from truepath.service.api.routes import certificates

HEADER = "error,position_mm,direction,value,unit\n"


@pytest.fixture
def place(with_result):
    return f"/api/v1/jobs/{with_result}/certificates"


class Here:
    def __init__(self, name):
        self.call, self.close = (lambda function: function()), (lambda: None)


@pytest.fixture
def quick_print(monkeypatch):
    """Certificates are issued without the process that lays out their PDF."""
    monkeypatch.setattr(certificates, "WorkerProcess", Here)
    monkeypatch.setattr(issued_certificates, "require_printer", lambda: None)
    monkeypatch.setattr(issued_certificates, "print_pdf", lambda _: b"%PDF-1.7")


def test_what_was_stated_is_kept(client, service, with_result, place, quick_print):
    service.setup.registry.change("default", serial_number="4711", place="Hall 3")
    known = {"serial_number": "4711", "place": "Hall 3"}
    assert client.get(place).json()["identity"] == known
    stated = {"place": "Hall 4", "operator": "A. Weiß", "warm_up": "2 h"}
    identity = {**stated, "tracker_serial": "7"}  # by its earlier name
    answer = client.post(place, json={"language": "de", "identity": identity})
    assert answer.status_code == 201, answer.text
    first = answer.json()
    tracker = {"tracker_serial_number": "7"}
    assert answer.headers["location"] == first["links"]["self"]
    assert first["identity"] == {"serial_number": "4711", **stated, **tracker}
    record, kept = service.setup.registry.get("default"), {"operator": "A. Weiß"}
    assert (record.place, record.stated) == ("Hall 4", kept | tracker)
    client.patch("/api/v1/machines/default", json={"serial_number": "4712"})
    second = client.post(place, json={}).json()
    assert second["number"] != first["number"]
    kept = {"serial_number": "4712", "place": "Hall 4", **record.stated}
    listed = client.get(place).json()
    assert second["identity"] == listed["identity"] == kept
    numbers = [one["number"] for one in listed["items"]]
    assert numbers == [first["number"], second["number"]]
    page = client.get(first["links"]["html"])
    assert "Kalibrierschein" in page.text
    assert first["number"] in page.text
    assert "sandbox" in page.headers["content-security-policy"]
    printed = client.get(first["links"]["pdf"]).content
    assert printed.startswith(b"%PDF")
    set_verdict(service, with_result, "doubtful")
    assert client.get(first["links"]["self"]).json() == first
    assert client.get(first["links"]["pdf"]).content == printed
    assert client.put(first["links"]["self"], json={}).status_code == 405
    assert client.delete(first["links"]["self"]).status_code == 405


def test_a_preview_is_as_issued_and_keeps_nothing(client, service, place, quick_print):
    service.setup.registry.change("default", tolerance_um=1000.0)
    before = service.setup.registry.get("default").stated
    order = {"identity": {"operator": "A. Weiß", "laboratory": "Room 1"}}
    seen = client.post(f"{place}/preview", json=order)
    assert seen.status_code == 200, seen.text
    assert client.get(place).json()["items"] == []
    assert service.setup.registry.get("default").stated == before
    issued = client.post(place, json=order).json()
    assert seen.json()["results"] == issued["results"]
    (decided,) = issued["results"]["conformity"]
    assert (decided["of"], decided["conformity"]) == ("before", "within")
    assert decided["tolerance_um"] == 1000.0
    html, page = seen.json()["html"], client.get(issued["links"]["html"]).text
    assert "PREVIEW: not issued" in html
    assert issued["number"] not in html
    assert "PREVIEW" not in page
    for text in ("A. Weiß", "Room 1", "ISO 14253-1"):
        assert text in html
        assert text in page


def test_a_result_not_to_be_used_has_one_only_if_that_is_accepted(
    client, service, with_result, place, is_problem, quick_print
):
    for asked, status, code in (
        ({"as_left_job": "019a3f6b"}, 404, "not-found"),
        ({"as_left_job": with_result}, 422, "bundle"),  # it is no machine as left
    ):
        problem = is_problem(client.post(place, json=asked), status, code)
    assert "measure again with the compensation active" in json.dumps(problem)
    set_verdict(service, with_result, "not-usable")
    is_problem(client.post(place, json={}), 422, "not-usable")
    assert client.get(place).json()["items"] == []
    taken = client.post(place, json={"accept_verdict": True}).json()
    assert taken["verdict"] == "not-usable"
    assert "NOT TO BE USED" in client.get(taken["links"]["html"]).text
    (service.results / with_result / "result.json").unlink()
    is_problem(client.post(place, json={}), 404, "not-found")


@pytest.mark.usefixtures("few_places")
def test_verified_files_are_stated(client, service, with_result, place, quick_print):
    at = f"/api/v1/jobs/{with_result}/compensations"
    kept = client.post(at, json={"format": "json"}).json()
    asked = {"result_id": with_result, "compensation_id": kept["id"]}
    proof, _ = service.store.create(Job(JobKind.VERIFY), plan={"request": asked})
    folder = service.results / proof.id
    folder.mkdir()
    active = {"format": "json", "files_sha256": kept["files_sha256"]}
    content = {"schema": "verification/1", "compensated": True, "compensation": active}
    (folder / "verification.json").write_text(json.dumps(content))
    order = {"verification_job": proof.id}
    page = client.get(client.post(place, json=order).json()["links"]["html"]).text
    assert "With the files, as the control reads them" in page
    shutil.rmtree(service.results / with_result / "compensations")
    page = client.get(client.post(place, json=order).json()["links"]["html"]).text
    assert "these files of the format json active" in page


def test_a_reference_is_compared_or_refused(client, with_result, analysed, is_problem):
    at = f"/api/v1/jobs/{with_result}/comparisons"

    def send(rows, **query):
        file = {"reference": ("reference.csv", (HEADER + rows).encode())}
        return client.post(at, files=file, params=query)

    table = json.loads((analysed / "result.json").read_text())["error_tables"]["EXX"]
    pairs = zip(table["position_mm"], table["value_um"], strict=True)
    rows = "".join(f"EXX,{at},{d},{v},um\n" for at, v in pairs for d in "+-")
    made = send(rows, reference_um=0.5)
    assert made.status_code == 201, made.text
    content = made.json()
    assert content["errors"]["EXX"]["largest_difference_um"] < 0.1
    assert made.headers["location"] == content["links"]["self"]
    assert client.get(content["links"]["self"]).json() == content
    page = client.get(content["links"]["report_html"])
    assert "sandbox" in page.headers["content-security-policy"]
    assert send(rows, reference_um=0.5).json()["id"] == content["id"]
    assert send(rows, reference_um=1.0).json()["id"] != content["id"]
    said = is_problem(send("EXX,one,+,1,um\n"), 422, "bundle")
    assert said["detail"].startswith("reference.csv, row 2")
    is_problem(send("EXQ,1,+,1,um\n"), 422, "bad-input")
    is_problem(client.get(f"{at}/nothing"), 404, "not-found")


@pytest.fixture
def at(with_result):
    return f"/api/v1/jobs/{with_result}/result"


def lengths(found):
    return np.linalg.norm(found["error_um"], axis=1)


def test_a_map_is_that_of_the_result_computed_once(client, service, at, with_result):
    found = client.get(f"{at}/volumetric-map?grid=3").json()
    assert (found["axes"], len(found["position"])) == (["X", "Y", "Z"], 27)
    np.testing.assert_allclose(found["length_um"], lengths(found), atol=1e-3)
    stated = client.get(f"{at}/volumetric-error").json()["after_expected"]
    after = client.get(f"{at}/volumetric-map?state=after").json()
    assert lengths(after).max() == 0.0, "a full correction leaves the uncertainty"
    mean_um = np.mean(after["length_um"])
    assert mean_um == pytest.approx(stated["mean"]["value_um"], rel=0.02)
    with edited(service.results / with_result / "maps" / "before-3.json") as content:
        content["target"] = "the kept one"
    again = client.get(f"{at}/volumetric-map?grid=3").json()
    assert again == {**found, "target": "the kept one"}
    for query, status, said in (
        ("grid=1", 422, "grid"),
        ("grid=12", 422, "grid"),
        ("state=cured", 422, "state"),
        ("compensation=linuxcnc-10-hold", 422, "state=after"),
        ("state=after&compensation=linuxcnc-10-hold", 404, "linuxcnc-10-hold"),
        ("state=after&compensation=..%2F..", 422, "compensation"),
    ):
        answer = client.get(f"{at}/volumetric-map?{query}")
        assert answer.status_code == status
        assert said in json.dumps(answer.json())


def test_files_leave_what_their_format_does_not_carry(client, at):
    files = at.replace("/result", "/compensations")
    made = client.post(files, json={"format": "linuxcnc"}).json()
    address = f"{at}/volumetric-map?state=after&compensation={made['id']}"
    found = client.get(address).json()
    before = client.get(f"{at}/volumetric-map").json()
    said = made["volumetric_error_um"]
    assert 0.0 < lengths(found).mean() < lengths(before).mean()
    # Its account is of the even travel, where ends of a grid count half.
    each = np.r_[0.5, np.ones(found["points"] - 2), 0.5]
    weight = np.multiply.outer(np.multiply.outer(each, each), each).ravel()
    mean_um = np.average(found["length_um"], weights=weight)
    assert mean_um == pytest.approx(said["after"]["mean"], rel=0.1)


def test_means_have_a_stated_tolerance_most_places_the_machines(client, at):
    states = "before", "after_expected"

    def read(level, **query):
        found = client.get(f"{at}/volumetric-error", params=query).json()
        return [found[state][level] for state in states], found["machine_tolerance_um"]

    neither = [None, None]
    assert read("conformity") == read("conformity_p95") == (neither, None)
    for figure, level in (("mean", "conformity"), ("p95", "conformity_p95")):
        (before, after), _ = read(figure)
        between_um = 0.5 * (before["value_um"] + after["value_um"])
        near_um = before["value_um"] + before["uncertainty_um"]
        for limit_um, said in ((between_um, "outside"), (near_um, "undecided")):
            query = {"tolerance_um": limit_um}
            if figure == "p95":
                changed = client.patch("/api/v1/machines/default", json=query)
                assert changed.status_code == 200
                assert read("conformity") == (neither, pytest.approx(limit_um))
                query = {}
            assert read(level, **query)[0] == [said, "within"]
