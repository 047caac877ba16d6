"""A result against a reference file that is sent in."""

from __future__ import annotations

import json
import shutil

import pytest

HEADER = "error,position_mm,direction,value,unit\n"


@pytest.fixture
def place(service, finished, analysed):
    """Address of the comparisons of a job with a real result."""
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return f"/api/v1/jobs/{finished['id']}/comparisons"


@pytest.fixture
def send(client, place):
    def sent(text, **query):
        file = {"reference": ("reference.csv", text.encode())}
        return client.post(place, files=file, params=query)

    return sent


def test_a_reference_is_compared_and_the_answer_kept(client, send, analysed):
    result = json.loads((analysed / "result.json").read_text())
    table = result["error_tables"]["EXX"]
    pairs = zip(table["position_mm"], table["value_um"], strict=True)
    rows = "".join(f"EXX,{at},{d},{v},um\n" for at, v in pairs for d in "+-")
    made = send(HEADER + rows, reference_um=0.5)
    assert made.status_code == 201, made.text
    content = made.json()
    assert content["errors"]["EXX"]["largest_difference_um"] < 0.1
    assert made.headers["location"] == content["links"]["self"]
    assert client.get(content["links"]["self"]).json() == content
    page = client.get(content["links"]["report_html"])
    assert "sandbox" in page.headers["content-security-policy"]
    assert send(HEADER + rows, reference_um=0.5).json()["id"] == content["id"]
    assert send(HEADER + rows, reference_um=1.0).json()["id"] != content["id"]


def test_what_cannot_be_compared_is_refused_with_its_place(
    client, send, place, is_problem
):
    said = is_problem(send(HEADER + "EXX,one,+,1,um\n"), 422, "bundle")
    assert said["detail"].startswith("reference.csv, row 2")
    is_problem(send(HEADER + "EXQ,1,+,1,um\n"), 422, "bad-input")
    is_problem(client.get(f"{place}/../comparisons/nothing"), 404, "not-found")
