"""The volumetric error over REST: its size against a tolerance, and its map."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from truepath.files.earlier.result_file import read_result
from truepath.results.prediction import predict


@pytest.fixture
def place(service, finished, analysed):
    """Address of the result of a job with those files."""
    target = service.results / finished["id"]
    shutil.copytree(analysed, target, dirs_exist_ok=True)
    return f"/api/v1/jobs/{finished['id']}/result"


def lengths(found):
    return np.linalg.norm(found["error_um"], axis=1)


def test_the_map_is_the_prediction_at_its_positions(client, place, analysed):
    found = client.get(f"{place}/volumetric-map?grid=3").json()
    result = read_result(analysed / "result.json")
    predicted = predict(result, np.array(found["position"]))
    assert found["axes"] == ["X", "Y", "Z"]
    assert len(found["position"]) == 27
    np.testing.assert_allclose(found["error_um"], predicted.error_um, atol=1e-3)
    u = predicted.uncertainty_um
    np.testing.assert_allclose(found["uncertainty_um"], u, atol=1e-3)
    np.testing.assert_allclose(found["length_um"], lengths(found), atol=1e-3)


def test_a_full_correction_leaves_what_the_uncertainty_allows(client, place):
    stated = client.get(f"{place}/volumetric-error").json()["after_expected"]
    found = client.get(f"{place}/volumetric-map?state=after").json()
    assert lengths(found).max() == 0.0
    mean_um = np.mean(found["length_um"])
    assert mean_um == pytest.approx(stated["mean"]["value_um"], rel=0.02)


def test_files_leave_what_their_format_does_not_carry(client, place):
    made = client.post(
        place.replace("/result", "/compensations"), json={"format": "linuxcnc"}
    ).json()
    address = f"{place}/volumetric-map?state=after&compensation={made['id']}"
    found = client.get(address).json()
    before = client.get(f"{place}/volumetric-map").json()
    said = made["volumetric_error_um"]
    assert 0.0 < lengths(found).mean() < lengths(before).mean()
    # Its account is of the even travel, where ends of a grid count half.
    each = np.r_[0.5, np.ones(found["points"] - 2), 0.5]
    weight = np.multiply.outer(np.multiply.outer(each, each), each).ravel()
    mean_um = np.average(found["length_um"], weights=weight)
    assert mean_um == pytest.approx(said["after"]["mean"], rel=0.1)


def test_a_map_is_computed_once_and_kept_with_the_result(client, service, place):
    first = client.get(f"{place}/volumetric-map?grid=2").json()
    kept = service.results / place.split("/")[-2] / "maps" / "before-2.json"
    content = json.loads(kept.read_text())
    kept.write_text(json.dumps({**content, "target": "the kept one"}))
    again = client.get(f"{place}/volumetric-map?grid=2").json()
    assert again == {**first, "target": "the kept one"}


@pytest.mark.parametrize(
    ("query", "status", "said"),
    [
        ("grid=1", 422, "grid"),
        ("grid=12", 422, "grid"),
        ("state=cured", 422, "state"),
        ("compensation=linuxcnc-10-hold", 422, "state=after"),
        ("state=after&compensation=linuxcnc-10-hold", 404, "linuxcnc-10-hold"),
        ("state=after&compensation=..%2F..", 422, "compensation"),
    ],
)
def test_a_map_that_cannot_be_says_why(client, place, query, status, said):
    answer = client.get(f"{place}/volumetric-map?{query}")
    assert answer.status_code == status
    assert said in json.dumps(answer.json())


def test_a_job_without_a_result_has_no_volumetric_error(client, ready, is_problem):
    for what in ("volumetric-map", "volumetric-error"):
        answer = client.get(f"/api/v1/jobs/{ready['id']}/result/{what}")
        is_problem(answer, 404, "not-found")


def test_each_mean_is_held_against_a_tolerance(client, place):
    plain = client.get(f"{place}/volumetric-error").json()
    assert plain["before"]["conformity"] is None
    before, after = (plain[state]["mean"] for state in ("before", "after_expected"))
    between = 0.5 * (before["value_um"] + after["value_um"])
    found = client.get(f"{place}/volumetric-error?tolerance_um={between}").json()
    assert found["before"]["conformity"] == "outside"
    assert found["after_expected"]["conformity"] == "within"
    near = before["value_um"] + before["uncertainty_um"]
    found = client.get(f"{place}/volumetric-error?tolerance_um={near}").json()
    assert found["before"]["conformity"] == "undecided"


def test_what_most_places_do_is_held_against_the_tolerance_of_the_machine(
    client, place
):
    plain = client.get(f"{place}/volumetric-error").json()
    assert plain["machine_tolerance_um"] is None
    assert plain["before"]["conformity_p95"] is None
    before, after = (plain[state]["p95"] for state in ("before", "after_expected"))

    def judge(tolerance_um):
        change = {"tolerance_um": tolerance_um}
        assert client.patch("/api/v1/machines/default", json=change).status_code == 200
        found = client.get(f"{place}/volumetric-error").json()
        assert found["machine_tolerance_um"] == pytest.approx(tolerance_um)
        assert found["before"]["conformity"] is None
        states = ("before", "after_expected")
        return [found[state]["conformity_p95"] for state in states]

    between_um = 0.5 * (before["value_um"] + after["value_um"])
    assert judge(between_um) == ["outside", "within"]
    near_um = before["value_um"] + before["uncertainty_um"]
    assert judge(near_um) == ["undecided", "within"]
