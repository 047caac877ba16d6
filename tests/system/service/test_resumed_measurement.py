"""A service that is killed or ended, started again, and goes on where it stopped.

The devices are no children of the service: they go on when it dies, so that a reflector
can be knocked, or the tracker carried to its next station, while nobody looks.
"""

import json
import random

import numpy as np
import pytest

import service_process
from api_builders import rows_at
from real_services import drive, environment_of
from service_process import acknowledge, arm, create, follow, wait_for, wait_until_done
from truepath.cli.demo import compare_with_truth
from truepath.compensation.residual_error import remove_rigid_motion
from truepath.files.bundle.run import digest_run
from truepath.measurement.run_file.run_loader import open_run
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.machine_file import load_machine

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]
SPEED = 12.0
DONE = 6  # of the lines, when the service is killed
KNOCK_MM = 0.05
RNG = random.Random(1)
ENDS_MM = (490, 390, 290)
PLACES = [[round(RNG.uniform(10, end), 1) for end in ENDS_MM] for _ in range(24)]
ROWS = rows_at(*PLACES, dwell_s=0.6)
AREAS = [
    {"min_mm": [-900, -900, 0], "max_mm": [1400, -500, 100]},
    {"min_mm": [900, -900, 0], "max_mm": [1400, 900, 100]},
]
TOOLS = {
    "T1": {"on": "tool", "offset_mm": [20.0, 30.0, -150.0]},
    "T2": {"on": "tool", "offset_mm": [60.0, -20.0, -90.0]},
}
# The change of the target repeats the row where the machine stands.
TWO_TOOLS = [{**row, "target": "T1"} for row in ROWS[:12]]
TWO_TOOLS += [{**row, "target": "T2"} for row in ROWS[11:]]


@pytest.fixture
def machine(tmp_path, request):
    file = tmp_path / "machine.json"
    content, targets = load_machine("demo"), getattr(request, "param", None)
    if targets is not None:
        del content["tool_offset_mm"]
        content["targets"] = targets
    file.write_text(json.dumps(content))
    return file


@pytest.fixture
def rig(machine):
    options = {"speed": SPEED, "tracker": "tcp", "seed": 3, "machine": str(machine)}
    with running_rig(options) as started:
        yield started


@pytest.fixture
def start(tmp_path, rig, machine):
    environment = environment_of(rig.motion_options, rig.tracker_options, machine)
    return lambda: service_process.process(tmp_path, **environment)


def kill_in_motion(service, client, done=DONE, **order):
    job = create(client, **order)
    arm(client, job)
    wait_until_done(client, job["id"], done, order.get("kind", "measure-otf"))
    service_process.kill(service)
    return job["id"]


@pytest.mark.fault_row(25)
@pytest.mark.fault_row(9)
@pytest.mark.parametrize("kind", ["measure-otf", "measure-standstill"])
def test_a_measurement_whose_service_was_killed_goes_on_where_it_was(start, rig, kind):
    rows = "path" if kind == "measure-otf" else "points"
    with start() as opened:
        job_id = kill_in_motion(*opened, **{"kind": kind, rows: ROWS})
    with start() as (_, client):
        assert client.get(f"/api/v1/jobs/{job_id}").json()["state"] == "interrupted"
        ended, first_row = go_on(client, rig, job_id)
        assert DONE - 1 <= first_row <= DONE + 4
        runs = [client.get(f"/api/v1/runs/{i}").json() for i in ended["run_ids"]]
        assert [run["complete"] for run in runs] == [False, True]
        result = client.get(f"/api/v1/jobs/{job_id}/result").json()
        assert ended["verdict"] == "usable", result["verdict"]
        assert len(result["runs"]) == 2
        kinds = [one["kind"] for one in result["verdict"]["details"]]
        assert "path-not-whole" not in kinds


@pytest.mark.fault_row(11)
@pytest.mark.fault_row(25)
def test_a_reflector_knocked_meanwhile_is_refused_with_its_size(start, rig):
    with start() as opened:
        job_id = kill_in_motion(*opened, path=ROWS)
    rig.inject(f"tracker:knock@0s*{KNOCK_MM}")
    with start() as (_, client):
        arm(client, acknowledge(client, job_id))
        job = follow(client, job_id, "faulted")
        assert job["error"]["code"] == "closure"
        size_um = float(job["error"]["detail"].split()[3])
        assert size_um == pytest.approx(1e3 * KNOCK_MM, abs=15.0)
        assert "reflector" in job["error"]["action"]
        assert job["run_ids"] == [job_id]
        assert client.get(f"/api/v1/runs/{job_id}/bundle").status_code == 200
        assert acknowledge(client, job_id)["error"] is None
        client.post("/api/v1/stop")


def go_on(client, rig, job_id):
    """Acknowledge a job and arm it anew, and only then does the machine move.

    Return the job once it has ended, and the row of its plan that it went on from.
    """
    before = rig.read_position()["position"]
    ready = acknowledge(client, job_id)
    assert ready["error"] is None
    plan = client.get(f"/api/v1/jobs/{job_id}/plan").json()
    assert rig.read_position()["position"] == before, "it moved unarmed"
    arm(client, ready)
    ended = follow(client, job_id, "succeeded")
    first, _ = ended["run_ids"]
    assert first == job_id
    return ended, plan["resumption"]["first_row"]


@pytest.mark.fault_row(25)
def test_a_killed_verification_counts_each_place_once(start, rig, tmp_path):
    verify = {"kind": "verify", "what": ["random-points"], "seed": 5}
    with start() as (service, client):
        result_id = drive(client, path=ROWS)["id"]
        job_id = kill_in_motion(service, client, **verify, result_id=result_id)
    with start() as (_, client):
        rows = client.get(f"/api/v1/jobs/{job_id}/plan").json()["position"]
        ended, first_row = go_on(client, rig, job_id)
        assert DONE - 1 <= first_row <= DONE + 4
        found = client.get(ended["verification"]["verification"]).json()
        for run_id, run in zip(ended["run_ids"], found["runs"], strict=True):
            file = tmp_path / "data" / "runs" / f"{run_id}.sqlite"
            assert run["input_sha256"] == digest_run(open_run(file))
        places = found["places"]
        assert places["row"] == list(range(len(rows)))
        assert found["agreement"]["chance"] > 0.001
        assert places["run"] == sorted(places["run"])
        assert places["run"].index(1) in (first_row, first_row + 1)
        position = np.array(places["position"])
        off_um = np.array(places["measured_um"]) - rig.truth_at(position)
        is_later = np.array(places["run"]) == 1
        # Each Run has a pose of its own: a rigid motion is no difference.
        for part in (is_later, ~is_later):
            off_um[part] = remove_rigid_motion(position[part], off_um[part])
        expanded_um = 2.0 * np.array(places["measured_uncertainty_um"])
        assert (np.abs(off_um) <= expanded_um).mean() > 0.8


def assert_agrees_with_truth(client, job, rig):
    """The map is true to a seventh of the errors, and its uncertainty says how true.

    Over one machine the share within twice the uncertainty is no 95 %: its errors are
    smooth, and so is what is wrong of them. Of two tools between 0.79 and 0.93 were
    seen, as the moment of the kill decides.
    """
    result = client.get(job["result"]["result"]).json()
    found = compare_with_truth(result, rig.truth_at)
    assert found.after_um < found.before_um / 7.0, found
    assert found.covered > 0.7, found


def set_down(rig, job, number):
    """Carry the tracker to where the job asks for it, as well as people can."""
    place_mm = np.add(job["station"]["position_mm"], [20.0, -15.0, 5.0])
    rig.move_tracker(place_mm.tolist(), number)


@pytest.mark.fault_row(25)
def test_two_stations_that_were_killed_go_on_and_agree_with_truth(start, rig):
    with start() as (service, client):
        tracker = {"areas": AREAS, "nearest_mm": 300, "move_minutes": 3}
        asked = {"mode": "otf", "minutes": 1.0, "workspace": {"tracker": tracker}}
        answer = client.post("/api/v1/plans", json={**asked, "stations": 2})
        assert answer.status_code == 202, answer.text
        at = f"/api/v1/plans/{answer.json()['id']}"
        wait_for(lambda: client.get(at).json()["state"] == "succeeded", "the plan")
        made = client.get(at).json()
        places_mm = [one["position_mm"] for one in made["document"]["at_stations"]]
        job = create(client, kind="measure-otf", plan_id=made["id"])
        assert job["station"]["position_mm"] == pytest.approx(places_mm[0], abs=0.1)
        set_down(rig, job, 1)
        arm(client, job)
        wait_until_done(client, job["id"], 4)
        service_process.kill(service)
    with start() as (_, client):
        ready = acknowledge(client, job["id"])
        assert ready["station"]["number"] == 1
        plan = client.get(f"/api/v1/jobs/{job['id']}/plan").json()
        assert plan["stations"][0]["resumption"]["first_row"] > 0
        arm(client, ready)
        asked = follow(client, job["id"], "awaiting-move")
        station = asked["station"]
        assert station["number"] == 2
        assert station["position_mm"] == pytest.approx(places_mm[1], abs=0.1)
        assert [c["problem"] for c in station["checks"]] == [""]
        arm(client, asked)  # nobody has moved it
        asked = follow(client, job["id"], "awaiting-move")
        assert asked["station"]["checks"][-1]["problem"] == "not-moved"
        set_down(rig, asked, 2)
        arm(client, asked)
        ended = follow(client, job["id"], "succeeded")
        assert len(ended["run_ids"]) == 3
        check = ended["station"]["checks"][-1]
        assert (check["station"], check["problem"]) == (2, "")
        assert check["place_mm"] == pytest.approx(places_mm[1], abs=30.0)
        assert check["residual_um"] < check["allowed_um"]
        result = client.get(ended["result"]["result"]).json()
        stood = [places_mm[0], *places_mm]
        for run, place_mm in zip(result["runs"], stood, strict=True):
            assert run["tracker_mm"] == pytest.approx(place_mm, abs=30.0)
        left_um = result["volumetric_uncertainty_um"]
        assert result["runs"][-1]["without_it_um"] > left_um
        assert_agrees_with_truth(client, ended, rig)


@pytest.mark.fault_row(25)
@pytest.mark.parametrize("machine", [TOOLS], indirect=True)
@pytest.mark.parametrize("done", [DONE, 15], ids=["first-tool", "second-tool"])
def test_two_tools_that_were_killed_go_on_and_agree_with_truth(start, rig, done):
    with start() as opened:
        job_id = kill_in_motion(*opened, done, path=TWO_TOOLS)
    with start() as (_, client):
        ended, first_row = go_on(client, rig, job_id)
        assert first_row >= done - 4
        assert_agrees_with_truth(client, ended, rig)
