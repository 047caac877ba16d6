"""A result proved by further motion of simulated devices over their real links."""

import pytest

from real_services import drive, simulated_service
from service_process import SPEED

JOBS = "/api/v1/jobs"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench") / "data"
    with simulated_service(folder, simulated_speed=SPEED) as (_, client):
        yield client


@pytest.fixture(scope="module")
def job(bench):
    return drive(bench)["id"]


@pytest.mark.long
@pytest.mark.timeout(600)
def test_circles_are_driven_on_the_fly_and_held_against_the_result(bench, job):
    proved = drive(bench, kind="verify", result_id=job, what=["circles-in-motion"])
    found = bench.get(proved["verification"]["verification"]).json()
    assert found["circles_missing"] == []
    assert [one["plane"] for one in found["circles_in_motion"]] == ["XY", "YZ", "ZX"]
    for one in found["circles_in_motion"]:
        driven = one["driven_feed_mm_min"].values()
        assert list(driven) == pytest.approx([one["feed_mm_min"]] * 2, rel=0.01)
        assert one["figures_um"]["H"] <= 2.0 * one["uncertainty_um"]["H"]
    within = [
        difference["within"]
        for one in found["circles_in_motion"]
        for difference in one["difference_um"].values()
    ]
    assert sum(within) >= len(within) - 1
    assert found["agreement"]["consistent"]


@pytest.mark.long
@pytest.mark.timeout(400)
def test_as_found_compensated_and_as_left_by_one_sequence_of_requests(bench, job):
    tables = "/api/v1/machines/default/simulated-tables"

    def proof(**order):
        asked = {"kind": "verify", "what": ["random-points"], "tolerance_um": 6}
        proved = drive(bench, **asked, **order)
        return bench.get(proved["verification"]["verification"]).json()

    made = bench.post(f"{JOBS}/{job}/compensations", json={"format": "isg-csv"})
    assert made.status_code == 201, made.text
    before = proof(result_id=job, seed=1)
    kept = made.json()["id"]
    loaded = bench.put(tables, json={"job_id": job, "compensation_id": kept})
    assert loaded.status_code == 200, loaded.text
    assert bench.get(tables).json() == loaded.json()
    assert loaded.json()["files"] == made.json()["files"]
    after = proof(result_id=job, compensation_id=kept, seed=2)
    assert bench.delete(tables).status_code == 204
    assert before["conformity"]["measured"]["conformity"] == "outside"
    assert abs(before["map_scale"]["value"] - 1.0) < 0.05
    assert after["compensated"]
    assert abs(after["map_scale"]["value"]) < 0.05
    left, found = (
        one["volumetric_error_um"]["measured"]["mean"] for one in (after, before)
    )
    assert left < 0.15 * found
    assert after["agreement"]["chance"] > 0.001
