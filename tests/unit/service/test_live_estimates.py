"""The estimate while the machine moves, the end at a target, plans that grow."""

import numpy as np
import pytest

from arming import arm_over_http
from scripted_cell import wait_until
from truepath.measurement.messages import PartRequested
from truepath.planning.adaptive_plan import Part
from truepath_drivers.interfaces.records import Path

JOBS = "/api/v1/jobs"


def test_the_newest_estimate_comes_with_its_course_once_there_is_one(
    client, armed, estimates
):
    address = f"{JOBS}/{armed['id']}/estimate"
    answer = client.get(address)
    assert (answer.status_code, answer.content) == (204, b"")
    for sigma_um, done in ((9.0, 2), (9.0, 2), (4.0, 3)):
        estimates[-1].publish(sigma_um, done)
    found = client.get(address).json()
    assert (found["job_id"], found["done"]) == (armed["id"], 3)
    assert found["course"] == {
        "elapsed_s": [10.0, 15.0],
        "done": [2, 3],
        "volumetric_uncertainty_um": [9.0, 4.0],
    }


def part_from(commanded):
    """Return a part of two lines from where the rows end."""
    here = commanded.position[-1]
    position = np.array([here, here * 0.5, here * 0.25])
    path = Path(commanded.axes, position, np.full(3, 6000.0), np.full(3, 0.4))
    return Part(path, 2, 9.5, 1.1e-3)


@pytest.fixture
def growing(client, take, make_cell):
    """A job that is planned while its machine moves; it was armed once."""
    planning = {"mode": "otf", "minutes": 5}
    job = take("ready", kind="measure-adaptive", target_um=2.0, planning=planning)
    assert "begin" not in make_cell.cell.heard
    assert arm_over_http(client, job).status_code == 202
    assert make_cell.cell.begun.wait(5)
    return job


def asked(cell, estimates):
    cell.say(PartRequested(0))
    wait_until(lambda: "ask" in estimates[-1].heard, "the question")


def test_a_job_goes_on_with_the_part_that_the_estimate_asks_for(
    client, growing, make_cell, estimates, service, until
):
    told, cell = [], make_cell.cell
    service.event_bus.subscribe(told.append)
    assert cell.order.grows
    request = estimates[-1].order.request
    assert (request["mode"], request["minutes"]) == ("otf", 5.0)
    first = cell.order.commanded
    asked(cell, estimates)
    estimates[-1].parts.append(part_from(first))
    wait_until(lambda: cell.parts, "the part")
    np.testing.assert_array_equal(cell.parts[0].position[0], first.position[-1])
    address = f"{JOBS}/{growing['id']}/plan"
    grown = len(first) + 2
    wait_until(lambda: len(client.get(address).json()["position"]) == grown, "rows")
    (body,) = [notice.body for notice in told if notice.type == "plan"]
    times = {"duration_s": 9.5, "predicted_um": 1.1}
    assert body == {"part": 2, "rows": 2, "total": grown - 1, **times}
    estimates[-1].publish(1.9, done=9)
    job = until(growing, "succeeded")
    assert job["early_end"]["reached_um"] == 1.9
    assert cell.heard[-1] == "conclude"


@pytest.mark.parametrize("is_over", [False, True])
def test_a_job_ends_in_order_where_no_part_fits_or_the_estimate_has_ended(
    growing, make_cell, estimates, until, is_over
):
    cell, estimates[-1].is_over = make_cell.cell, is_over
    asked(cell, estimates)
    if not is_over:
        estimates[-1].parts.append(Part(None))
    assert until(growing, "succeeded")["early_end"] is None
    assert cell.heard[-1] == "conclude"
