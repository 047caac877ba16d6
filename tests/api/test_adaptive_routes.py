"""Adaptive jobs over REST, the cell and the live estimate played by the test."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_cell import wait_until

from truepath.measurement.messages import PartRequested
from truepath.planning.adaptive_plan import Part
from truepath_drivers.interfaces.records import Path

REQUEST = {"kind": "measure-adaptive", "target_um": 2.0}


@pytest.fixture
def order():
    return {**REQUEST, "planning": {"mode": "otf", "minutes": 5}}


def part_from(commanded):
    """Return a part of two lines from where the rows end."""
    here = commanded.position[-1]
    position = np.array([here, here * 0.5, here * 0.25])
    path = Path(commanded.axes, position, np.full(3, 6000.0), np.full(3, 0.4))
    return Part(path, 2, 9.5, 1.1e-3)


@pytest.fixture
def cell(armed, make_cell):
    return make_cell.cell


def asked(cell, estimates, times=1):
    cell.say(PartRequested(0))
    wait_until(lambda: estimates[-1].heard.count("ask") == times, "the question")


def test_a_job_goes_on_with_the_part_that_the_estimate_asks_for(
    client, armed, cell, estimates, service, until
):
    told = []
    service.event_bus.subscribe(told.append)
    assert cell.order.grows
    first = cell.order.commanded
    asked(cell, estimates)
    estimates[-1].parts.append(part_from(first))
    wait_until(lambda: cell.parts, "the part")
    np.testing.assert_array_equal(cell.parts[0].position[0], first.position[-1])
    address = f"/api/v1/jobs/{armed['id']}/plan"
    grown = len(first) + 2
    wait_until(lambda: len(client.get(address).json()["position"]) == grown, "rows")
    (body,) = [notice.body for notice in told if notice.type == "plan"]
    assert body == {
        "part": 2,
        "rows": 2,
        "total": grown - 1,
        "duration_s": 9.5,
        "predicted_um": 1.1,
    }
    estimates[-1].publish(1.9, done=9)
    job = until(armed, "succeeded")
    assert job["early_end"]["reached_um"] == 1.9
    assert cell.heard[-1] == "conclude"


def test_a_job_ends_in_order_where_no_part_fits_any_more(armed, cell, estimates, until):
    asked(cell, estimates)
    estimates[-1].parts.append(Part(None))
    job = until(armed, "succeeded")
    assert job["early_end"] is None
    assert cell.heard[-1] == "conclude"


def test_a_live_estimate_that_has_ended_ends_the_measurement_in_order(
    armed, cell, estimates, until
):
    estimates[-1].is_over = True
    asked(cell, estimates)
    assert until(armed, "succeeded")["early_end"] is None
    assert cell.heard[-1] == "conclude"


def test_the_live_estimate_knows_within_what_parts_are_planned(cell, estimates):
    request = estimates[-1].order.request
    assert (request["mode"], request["minutes"]) == ("otf", 5.0)


def test_nothing_moves_before_an_adaptive_job_is_armed_once(client, order, until):
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    plan = client.get(f"/api/v1/jobs/{job['id']}/plan").json()
    assert len(plan["position"]) > 2
    assert plan["predicted_um"] == 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"planning": {"target_um": 1.0}},
        {"planning": {"corner_path": True}},
        {"path": [{"x_mm": 1}, {"x_mm": 2}]},
        {"kind": "measure-otf"},
    ],
)
def test_a_request_that_contradicts_itself_is_refused(
    client, order, change, is_problem
):
    answer = client.post("/api/v1/jobs", json={**order, **change})
    is_problem(answer, 422, "validation")
