"""Plans over REST: made by the real planner, checked, taken away, driven."""

from __future__ import annotations

import copy
import dataclasses
import json
from itertools import pairwise

import numpy as np
import pytest
from arming import arm_over_http
from scripted_cell import wait_until

from truepath.files.bundle.machine_file import machine_from_json, machine_to_json
from truepath.jobs.running.plan_orders import plan_measurement
from truepath.motion.nc_programs.programs import read_program
from truepath_simulators.scenario import load_machine

MACHINE = machine_from_json(load_machine("demo"))
SHORT = {"mode": "otf", "minutes": 0.5, "seed": 3}
BOX = {"name": "probe", "min_mm": [150, 100, 0], "max_mm": [260, 220, 400]}


@pytest.fixture(scope="module")
def plans_made():
    """What was planned in this file, by machine and order."""
    return {}


@pytest.fixture
def planner(plans_made):
    """The real one, which is asked for each plan once."""

    def plan(machine, order, *, on_progress):
        key = json.dumps([machine_to_json(machine), order], sort_keys=True)
        if key not in plans_made:
            made = plan_measurement(machine, order, on_progress=on_progress)
            plans_made[key] = made
        return copy.deepcopy(plans_made[key])

    return plan


@pytest.fixture
def planned(client):
    """Ask for a plan and wait until its job has ended."""

    def make(request):
        answer = client.post("/api/v1/plans", json=request)
        assert answer.status_code == 202, answer.text
        address = answer.headers["location"]

        def ended():
            now = client.get(address).json()
            return now if now["state"] in ("succeeded", "failed") else None

        return wait_until(ended, "the plan")

    return make


@pytest.fixture
def plan(planned):
    made = planned(SHORT)
    assert made["state"] == "succeeded", made["error"]
    return made


def test_a_plan_says_what_it_will_leave_unknown(plan, client):
    assert plan["request"] == {**SHORT, "perpendicular_only": False} | {
        "corner_path": False
    }
    rows = plan["commanded"]
    assert rows["kind"] == "path"
    assert len(rows["position"]) == plan["document"]["rows"] > 4
    assert plan["document"]["duration_s"] <= 30.0
    predicted = plan["document"]["predicted"]
    assert {"EXX", "EBX", "C0Y"} <= set(predicted["errors"])
    assert predicted["volumetric_uncertainty_um"] > 0.0
    curve = [step["volumetric_uncertainty_um"] for step in plan["document"]["curve"]]
    assert curve[-1] == predicted["volumetric_uncertainty_um"]
    assert curve == sorted(curve, reverse=True)
    assert isinstance(plan["document"]["unobservable"], list)
    assert plan["document"]["grade"]["verdict"] in ("good", "usable", "poor")
    job = client.get(plan["links"]["job"]).json()
    assert (job["kind"], job["state"], job["result"]) == ("plan", "succeeded", None)


def test_the_curve_says_how_far_each_beginning_of_a_plan_comes(plan, client):
    found = client.get(plan["links"]["curve"]).json()
    points, document = found["points"], plan["document"]
    assert [p["row"] for p in points] == sorted({p["row"] for p in points})
    assert points[-1]["row"] == document["rows"]
    assert points[-1]["time_s"] == pytest.approx(document["duration_s"])
    numbers = [p["grade"]["number"] for p in points]
    assert numbers == sorted(numbers, reverse=True)
    # From geometry alone and in few shapes it is about the same.
    assert numbers[-1] == pytest.approx(document["grade"]["number"], rel=0.5)
    assert points[0]["grade"]["verdict"] == "poor"
    for point in points:
        at_tool = [weak["at_tool_um"] for weak in point["weakest"]]
        assert at_tool == sorted(at_tool, reverse=True)
        assert len(at_tool) == 3
    assert found["tracker_mm"] == document["tracker"]["position_mm"]


@pytest.mark.parametrize("at", [-1, 3])
def test_a_job_drives_the_beginning_that_the_curve_shows(plan, client, until, at):
    point = client.get(plan["links"]["curve"]).json()["points"][at]
    order = {"kind": "measure-otf", "plan_id": plan["id"], "plan_rows": point["row"]}
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    driven = client.get(f"/api/v1/jobs/{job['id']}/plan").json()
    assert driven["position"] == plan["commanded"]["position"][: point["row"]]
    assert driven["predicted_um"] == point["volumetric_uncertainty_um"]


def test_rows_of_no_plan_are_refused(client, is_problem):
    order = {"kind": "measure-otf", "plan_rows": 9}
    refused = is_problem(client.post("/api/v1/jobs", json=order), 422, "validation")
    assert "plan_rows needs a plan_id" in str(refused)


def test_a_job_that_is_no_plan_has_no_curve(client, ready, is_problem):
    is_problem(client.get(f"/api/v1/plans/{ready['id']}/curve"), 404, "not-found")


def test_more_time_is_foretold_to_tell_more(planned):
    short, long = planned(SHORT), planned({**SHORT, "minutes": 1.5})
    told = [
        each["document"]["predicted"]["volumetric_uncertainty_um"]
        for each in (short, long)
    ]
    assert told[1] < 0.8 * told[0]


@pytest.mark.timeout(200)
def test_a_target_is_a_standard_uncertainty(planned):
    made = planned({"mode": "otf", "target_um": 3.0})
    document = made["document"]
    assert document["target"]["expanded_volumetric_uncertainty_um"] == 6.0
    assert document["target"]["reached"]
    assert document["predicted"]["volumetric_uncertainty_um"] <= 3.0
    commanded = made["commanded"]
    assert commanded["target_um"] == 3.0
    assert commanded["predicted_um"] <= 3.0


def test_no_swept_line_of_a_plan_touches_a_keep_out_box(planned):
    made = planned({**SHORT, "workspace": {"keep_out": [BOX]}})
    assert made["state"] == "succeeded", made["error"]
    assert made["commanded"]["keep_out"] == [BOX]
    stops = np.array(made["commanded"]["position"])
    low, high = np.array(BOX["min_mm"]), np.array(BOX["max_mm"])
    for begin, end in pairwise(stops):
        share = np.linspace(0.0, 1.0, 2001)[:, None]
        swept = begin + share * (end - begin)
        assert not np.all((swept >= low) & (swept <= high), axis=1).any()


def test_a_plan_is_a_program_for_a_control(plan, client):
    answer = client.get(plan["links"]["nc_program"], params={"dialect": "heidenhain"})
    motion = read_program(answer.text, "heidenhain")
    np.testing.assert_allclose(motion.position, plan["commanded"]["position"])


def test_a_measuring_job_drives_a_plan(plan, client, until, make_cell):
    order = {"kind": "measure-otf", "plan_id": plan["id"], "target_um": 1.0}
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    driven = client.get(job["links"]["plan"]).json()
    assert driven["position"] == plan["commanded"]["position"]
    predicted = plan["document"]["predicted"]["volumetric_uncertainty_um"]
    assert driven["predicted_um"] == predicted
    assert job["target_um"] == 1.0
    arm_over_http(client, job)
    assert make_cell.cell.begun.wait(5)
    stops = make_cell.cell.order.commanded.position
    np.testing.assert_array_equal(stops, plan["commanded"]["position"])
    make_cell.cell.end()
    until(job, "succeeded")


def test_points_are_planned_and_driven_as_points(planned, client, until):
    made = planned({"mode": "standstill", "minutes": 1})
    assert made["commanded"]["kind"] == "points"
    order = {"kind": "measure-standstill", "plan_id": made["id"]}
    job = until(client.post("/api/v1/jobs", json=order).json(), "ready")
    assert len(client.get(job["links"]["plan"]).json()["position"]) > 4


def test_a_plan_of_the_other_mode_is_refused(plan, client, is_problem):
    order = {"kind": "measure-standstill", "plan_id": plan["id"]}
    problem = is_problem(client.post("/api/v1/jobs", json=order), 422, "plan")
    assert "one for measure-otf" in problem["detail"]


def test_a_plan_for_a_machine_that_has_changed_is_refused(
    plan, client, service, is_problem
):
    axis = dataclasses.replace(MACHINE.axes[0], high=MACHINE.axes[0].high + 1.0)
    changed = dataclasses.replace(MACHINE, axes=(axis, *MACHINE.axes[1:]))
    service.machines.put(dataclasses.replace(service.machines.first, machine=changed))
    order = {"kind": "measure-otf", "plan_id": plan["id"]}
    problem = is_problem(client.post("/api/v1/jobs", json=order), 422, "plan")
    assert "plan again" in problem["detail"]


def test_rows_beside_a_plan_are_refused(client, order, is_problem):
    body = {**order, "plan_id": "019a3f5e"}
    is_problem(client.post("/api/v1/jobs", json=body), 422, "validation")


def test_what_is_no_plan_cannot_be_driven_as_one(client, ready, is_problem):
    client.post("/api/v1/stop")
    order = {"kind": "measure-otf", "plan_id": ready["id"]}
    is_problem(client.post("/api/v1/jobs", json=order), 404, "not-found")
    is_problem(client.get(f"/api/v1/plans/{ready['id']}"), 404, "not-found")


def test_a_plan_that_cannot_be_ends_with_the_reason(planned):
    axes = MACHINE.linear_axes
    everything = {
        "min_mm": [axis.low - 1.0 for axis in axes],
        "max_mm": [axis.high + 1.0 for axis in axes],
    }
    made = planned({**SHORT, "workspace": {"keep_out": [everything]}})
    assert made["state"] == "failed"
    assert made["error"]["code"] == "plan"
    assert "keep-out" in made["error"]["detail"]
    assert made["commanded"] is None
    assert made["document"] is None


@pytest.mark.parametrize(
    "change",
    [
        {"mode": "flying"},
        {"minutes": 0},
        {"minutes": 1e9},
        {"corner_path": True},
        {"workspace": {"blocks_sight": [BOX]}},
        {"workspace": {"keep_out": [{**BOX, "max_mm": BOX["min_mm"]}]}},
        {"workspace": {"tracker": {"position_mm": [0, 0, 0], "nearest_mm": 5}}}
        | {"word": 1},
    ],
)
def test_a_request_that_makes_no_sense_is_refused_at_once(client, change, is_problem):
    answer = client.post("/api/v1/plans", json={**SHORT, **change})
    is_problem(answer, 422, "validation")


def test_the_same_key_makes_one_plan(client):
    headers = {"Idempotency-Key": "plan-1"}
    first, again = (
        client.post("/api/v1/plans", json=SHORT, headers=headers).json()
        for _ in range(2)
    )
    assert first["id"] == again["id"]


@pytest.mark.parametrize("feed", [5e-324, 1e-9, 1e6])
def test_rows_with_a_feed_of_no_machine_are_refused(client, is_problem, feed):
    rows = [
        {"x_mm": 10, "y_mm": 10, "z_mm": 100},
        {"x_mm": 400, "y_mm": 300, "z_mm": 100, "feed_mm_min": feed},
    ]
    answer = client.post("/api/v1/plans:validate", json={"path": rows})
    (said,) = is_problem(answer, 422, "validation")["errors"]
    assert said["location"] == ["body", "path", "1", "feed_mm_min"]


@pytest.mark.parametrize("feed", [5e-324, 0.99, 100_000.0])
@pytest.mark.parametrize(
    ("route", "order", "where"),
    [
        ("plans", lambda feed: {"feeds_mm_min": [6000, feed]}, "feeds_mm_min"),
        ("plans", lambda feed: {"max_feed_mm_min": feed}, "max_feed_mm_min"),
        (
            "jobs",
            lambda feed: {"kind": "measure-otf", "feed_mm_min": feed},
            "feed_mm_min",
        ),
    ],
)
def test_every_order_takes_the_feeds_that_some_control_drives(
    client, is_problem, route, order, where, feed
):
    answer = client.post(f"/api/v1/{route}", json=order(feed))
    (said,) = is_problem(answer, 422, "validation")["errors"]
    assert said["location"][1] == where
    assert ("to 1" in said["message"]) == (feed < 1)


@pytest.mark.parametrize("feed", [1.0, 6000.0, 99_999.0])
def test_rows_that_may_be_driven_have_a_duration(client, feed):
    rows = [
        {"x_mm": 10, "y_mm": 10, "z_mm": 100, "dwell_s": 3600},
        {"x_mm": 400, "y_mm": 300, "z_mm": 100, "feed_mm_min": feed},
        {"x_mm": 10, "y_mm": 300, "z_mm": 100},
    ]
    answer = client.post("/api/v1/plans:validate", json={"path": rows})
    assert answer.status_code == 200, answer.text
    assert answer.json()["duration_s"] > 3600.0


@pytest.mark.parametrize(
    "body",
    [
        {"path": [{"x_mm": x, "y_mm": x, "z_mm": x} for x in (10, 200)]},
        {"path": [{"x_mm": x, "y_mm": x, "z_mm": x} for x in (10, 200, 90)]},
        {"points": [{"x_mm": 10, "y_mm": 10, "z_mm": 10}]},
        {"points": [{"x_mm": x, "y_mm": x, "z_mm": x} for x in (10, 90, 200)]},
    ],
)
def test_rows_that_no_measurement_takes_are_refused_as_its_order_refuses_them(
    client, is_problem, body
):
    checked = is_problem(client.post("/api/v1/plans:validate", json=body), 422, "plan")
    kind = "measure-otf" if "path" in body else "measure-standstill"
    ordered = is_problem(
        client.post("/api/v1/jobs", json={"kind": kind, **body}), 422, "plan"
    )
    assert (checked["code"], checked["detail"]) == (ordered["code"], ordered["detail"])


def test_what_rows_alone_leave_open_is_said_and_they_are_taken_all_the_same(client):
    rows = [
        {"x_mm": 10, "y_mm": 10, "z_mm": 10},
        {"x_mm": 400, "y_mm": 300, "z_mm": 200},
        {"x_mm": 90, "y_mm": 350, "z_mm": 40},
        {"x_mm": 450, "y_mm": 20, "z_mm": 250},
    ]
    address = "/api/v1/plans:validate"
    assert client.post(address, json={"path": rows}).json()["stays_open"] == ""
    two = client.post(address, json={"path": rows[:3]})
    assert two.status_code == 200, two.text
    assert "do not determine A0Z, B0Z, C0Y" in two.json()["stays_open"]
    order = {"kind": "measure-otf", "path": rows[:3]}
    assert client.post("/api/v1/jobs", json=order).status_code == 202


def test_rows_are_checked_over_the_whole_swept_path(client, is_problem):
    rows = [
        {"x_mm": 10, "y_mm": 10, "z_mm": 100},
        {"x_mm": 400, "y_mm": 300, "z_mm": 100},
        {"x_mm": 400, "y_mm": 10, "z_mm": 100},
    ]
    free = client.post("/api/v1/plans:validate", json={"path": rows})
    assert free.status_code == 200, free.text
    assert free.json()["rows"] == 3
    assert free.json()["duration_s"] > 4.0
    body = {"path": rows, "workspace": {"keep_out": [BOX]}}
    refused = is_problem(client.post("/api/v1/plans:validate", json=body), 422, "plan")
    assert "row 2 enters the keep-out box probe" in refused["detail"]
    rows[1]["y_mm"] = 401
    body = {"points": rows}
    is_problem(client.post("/api/v1/plans:validate", json=body), 422, "out-of-travel")
    is_problem(client.post("/api/v1/plans:validate", json={}), 422, "validation")
    assert client.get("/api/v1/jobs").json()["items"] == []
