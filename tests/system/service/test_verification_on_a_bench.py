"""A result proved by further motion of simulated devices over their real links."""

import pytest

from real_services import drive, simulated_service
from service_process import SPEED


@pytest.mark.long
@pytest.mark.timeout(600)
def test_circles_are_driven_on_the_fly_and_held_against_the_result(tmp_path):
    with simulated_service(tmp_path / "data", simulated_speed=SPEED) as (_, client):
        order = {"kind": "verify", "result_id": drive(client)["id"]}
        proved = drive(client, **order, what=["circles-in-motion"])
        found = client.get(proved["verification"]["verification"]).json()
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
