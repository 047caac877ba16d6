"""Plans over REST: made by the real planner, checked, taken away, driven."""

import copy
import dataclasses

import pytest

from api_builders import rows_at
from service_fixtures import SHORT
from truepath.files.bundle.machine_file import machine_from_json
from truepath.jobs.running.plan_requests import plan_measurement
from truepath.motion.nc_programs.programs import read_program
from truepath_simulators.machine_file import load_machine

MACHINE = machine_from_json(load_machine("demo"))
USUAL = {"perpendicular_only": False, "corner_path": False}
BOX = {"name": "probe", "min_mm": [150, 100, 0], "max_mm": [260, 220, 400]}


@pytest.fixture
def more():
    return {}


@pytest.fixture
def planner(short_plan, more):
    def plan(machine, order, *, on_progress):
        if {key: order[key] for key in order if order[key]} == SHORT:
            return copy.deepcopy(short_plan | more)
        return plan_measurement(machine, order, on_progress=on_progress)

    return plan


@pytest.fixture
def planned(client, until):
    def make(request):
        answer = client.post("/api/v1/plans", json=request)
        assert answer.status_code == 202, answer.text
        until(answer.json(), "succeeded", "failed")
        return client.get(answer.headers["location"]).json()

    return make


@pytest.fixture
def plan(planned):
    made = planned(SHORT)
    assert made["state"] == "succeeded", made["error"]
    return made


def test_a_plan_and_each_beginning_of_it_say_what_they_will_leave_unknown(plan, client):
    assert plan["request"] == {**SHORT, **USUAL}
    rows, document = plan["commanded"], plan["document"]
    assert rows["kind"] == "path"
    assert len(rows["position"]) == document["rows"] > 4
    predicted = document["predicted"]
    assert {"EXX", "EBX", "C0Y"} <= set(predicted["errors"])
    curve = [step["volumetric_uncertainty_um"] for step in document["curve"]]
    assert curve[-1] == predicted["volumetric_uncertainty_um"] > 0.0
    assert curve == sorted(curve, reverse=True)
    assert document["grade"]["verdict"] in ("good", "usable", "poor")
    job = client.get(plan["links"]["job"]).json()
    assert (job["kind"], job["state"], job["result"]) == ("plan", "succeeded", None)
    found = client.get(plan["links"]["curve"]).json()
    points = found["points"]
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
        assert (at_tool, len(at_tool)) == (sorted(at_tool, reverse=True), 3)
    assert found["tracker_mm"] == document["tracker"]["position_mm"]


def test_a_plan_or_its_beginning_is_driven_as_it_is_shown(plan, client, take):
    position = plan["commanded"]["position"]
    predicted = plan["document"]["predicted"]["volumetric_uncertainty_um"]
    point = client.get(plan["links"]["curve"]).json()["points"][3]
    for asked, rows, predicted_um in (
        ({"target_um": 1.0}, len(position), predicted),
        ({"plan_rows": point["row"]}, point["row"], point["volumetric_uncertainty_um"]),
    ):
        job = take("ready", kind="measure-otf", plan_id=plan["id"], **asked)
        driven = client.get(job["links"]["plan"]).json()
        assert driven["position"] == position[:rows]
        assert driven["predicted_um"] == predicted_um
        assert driven["tracker_mm"] == plan["document"]["tracker"]["position_mm"]
        assert job["target_um"] == driven["target_um"] == asked.get("target_um")
        client.post("/api/v1/stop")


def test_each_station_has_its_program(planned, more, short_plan, client, is_problem):
    by_row = ("position", "feed_mm_min", "dwell_s")
    whole = {name: short_plan[name] for name in ("kind", "axes", *by_row)}
    whole |= {"position_mm": [0.0, -1200.0, 0.0], "duration_s": 30.0, "target": []}
    less = whole | {name: whole[name][:-1] for name in by_row}
    more["stations"] = [whole, less]
    address = planned(SHORT)["links"]["nc_program"]

    def give(**more):
        return client.get(address, params={"dialect": "fanuc", **more})

    lengths = [len(read_program(give(station=n).text, "fanuc")) for n in (1, 2)]
    assert lengths == [len(whole["position"]), len(less["position"])]
    told = is_problem(give(station=3), 404, "not-found")["detail"]
    assert "2 stations, not 3" in told


def test_a_plan_is_of_its_mode_and_machine(plan, client, service, ready, is_problem):
    client.post("/api/v1/stop")

    def refused(kind, plan_id=plan["id"], status=422, code="plan"):
        answer = client.post("/api/v1/jobs", json={"kind": kind, "plan_id": plan_id})
        return is_problem(answer, status, code)["detail"]

    refused("measure-otf", ready["id"], 404, "not-found")
    for path in ("", "/curve"):
        is_problem(client.get(f"/api/v1/plans/{ready['id']}{path}"), 404, "not-found")
    assert "one for measure-otf" in refused("measure-standstill")
    axis = dataclasses.replace(MACHINE.axes[0], high=MACHINE.axes[0].high + 1.0)
    changed = dataclasses.replace(MACHINE, axes=(axis, *MACHINE.axes[1:]))
    service.machines.put(dataclasses.replace(service.machines.first, machine=changed))
    assert "plan again" in refused("measure-otf")


@pytest.mark.database
def test_a_plan_that_cannot_be_says_why_and_is_made_once_for_a_key(planned, client):
    axes = MACHINE.linear_axes
    low, high = [axis.low - 1.0 for axis in axes], [axis.high + 1.0 for axis in axes]
    order = {**SHORT, "workspace": {"keep_out": [{"min_mm": low, "max_mm": high}]}}
    made = planned(order)
    assert (made["state"], made["error"]["code"]) == ("failed", "plan")
    assert "keep-out" in made["error"]["detail"]
    assert (made["commanded"], made["document"]) == (None, None)
    sent = {"json": order, "headers": {"Idempotency-Key": "plan-1"}}
    first, again = (client.post("/api/v1/plans", **sent) for _ in range(2))
    assert first.json()["id"] == again.json()["id"]


def test_rows_are_checked_over_the_swept_path(client, is_problem):
    def check(**body):
        return client.post("/api/v1/plans:validate", json=body)

    rows = rows_at((10, 10, 100), (400, 300, 100), (400, 10, 100))
    free = check(path=rows).json()
    assert free["rows"] == 3
    assert free["duration_s"] > 4.0
    for feed in (1.0, 99_999.0):
        slow = [{**rows[0], "dwell_s": 3600}, {**rows[1], "feed_mm_min": feed}, rows[2]]
        assert check(path=slow).json()["duration_s"] > 3600.0
    refused = is_problem(check(path=rows, workspace={"keep_out": [BOX]}), 422, "plan")
    assert "row 2 enters the keep-out box probe" in refused["detail"]
    rows[1]["y_mm"] = 401
    is_problem(check(points=rows), 422, "out-of-travel")
    rows = rows_at((10, 10, 10), (400, 300, 200), (90, 350, 40), (450, 20, 250))
    assert check(path=rows).json()["stays_open"] == ""
    assert "do not determine A0Z, B0Z, C0Y" in check(path=rows[:3]).json()["stays_open"]
    assert client.get("/api/v1/jobs").json()["items"] == []
    order = {"kind": "measure-otf", "path": rows[:3]}
    assert client.post("/api/v1/jobs", json=order).status_code == 202
