"""The whole service over simulated devices: asked, knocked, and proved.

In the circle the truth of the bench hides an effect; the service knows nothing of it.
Extra lines are driven as any other motion: armed by whoever has looked at them.
"""

import json

import numpy as np
import pytest

from api_builders import rows_at
from real_services import drive, simulated_service
from service_process import ENDS, SPEED, follow
from truepath.files.bundle.bundle import zip_bundle
from truepath_simulators.hidden import drives, effects_by_name, structure
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds.synthetic import Setting

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
MACHINE = 5
FEW = 10  # extra lines
LEANS = {"lateral-backlash", "squareness"}
CONTENT = load_machine("demo")
LOW, HIGH = parse_machine(CONTENT).low_mm + 15.0, parse_machine(CONTENT).high_mm - 15.0
PLAY = drives.LateralBacklash("Y", "EXY", 5.0, 0.3)


@pytest.fixture
def client(hidden, tmp_path):
    """A service over a bench whose machine has an effect that no model knows."""
    bench = {"simulated_speed": 15.0, "simulated_seed": MACHINE}
    bench["simulated_hidden"] = (json.dumps(effects_by_name.as_json(hidden)),)
    with simulated_service(tmp_path / "data", 500, **bench) as (_, client):
        yield client


def two_sides_of_y():
    """Points at the ends of Y, each approached from the other: play looks like a lean.

    The first point, approached from nowhere, is in the middle, where no lean shows.
    """
    rng, n = np.random.default_rng(4), 24
    share = rng.random((n, 3))
    far = np.arange(n) % 2 == 1
    share[:, 1] = np.where(far, 1.0 - 0.03 * share[:, 1], 0.03 * share[:, 1])
    share[0, 1] = 0.5
    return rows_at(*np.round(LOW + share * (HIGH - LOW), 3).tolist(), dwell_s=0.8)


@pytest.fixture
def first(client, record):
    """A discovery at points by a model of before, that has asked for lines."""
    how = {"feed": 6000.0, "chain": CONTENT["kinematic_chain"]}
    calibrated, _ = record(9, rows=40, setting=Setting(MACHINE), **how)
    sent = {"bundle": ("r.zip", zip_bundle(calibrated))}
    before = client.post("/api/v1/runs", files=sent).json()["id"]
    model_id = drive(client, kind="discover", run_id=before)["id"]
    points = two_sides_of_y()
    run_id = drive(client, kind="measure-standstill", points=points)["run_id"]
    job = drive(client, kind="discover", run_id=run_id, model_id=model_id)
    found = read_discovery(client, job["id"])
    effect = found["effects"][0]
    names = {effect["name"], *(e["name"] for e in effect["indistinguishable_from"])}
    assert names == LEANS
    asked = found["ask"]
    assert asked["lines"] < FEW
    assert asked["lines"] == len(asked["rows"]) - 1
    assert asked["decides"]
    assert all(name in asked["reason"] for name in LEANS)
    return {"id": job["id"], "run_id": run_id, "model_id": model_id, "ask": asked}


def read_discovery(client, job_id):
    return client.get(f"/api/v1/jobs/{job_id}/discovery").json()


def check_what_is_decided(found, hidden, parameter):
    effect, *others = found["effects"]
    assert (effect["name"], effect["indistinguishable_from"]) == (hidden.name, [])
    # Before its first motion an axis with play stands as it was left: that is no step.
    assert not {"setup-step", *LEANS} & {e["name"] for e in others}
    said = effect["parameters"][parameter]
    assert abs(said["value"] - getattr(hidden, parameter)) < 3.0 * said["uncertainty"]
    gap = found["gap"]
    assert gap["after"] < 0.6 * gap["before"]
    # A root mean square over so few lines is a third off one time in twenty.
    assert gap["after"] < 1.4 * gap["expected"]


@pytest.mark.parametrize(
    ("hidden", "parameter"),
    [(PLAY, "half_width"), (structure.Squareness("C0Y", -27.0), "value_urad")],
    ids=["lateral-backlash", "squareness"],
)
def test_backlash_and_squareness_are_told_apart(client, first, hidden, parameter):
    job = drive(client, kind="measure-extra", discovery_id=first["id"])
    check_what_is_decided(read_discovery(client, job["id"]), hidden, parameter)


@pytest.mark.parametrize("hidden", [PLAY], ids=["lateral-backlash"])
def test_the_lines_may_be_driven_as_a_path_of_ones_own(client, first, hidden):
    # So few lines need not determine tables of their own; their Run stands.
    extra = drive(client, *ENDS, path=first["ask"]["rows"])
    both = {"run_ids": [first["run_id"], extra["run_id"]]}
    job = drive(client, kind="discover", model_id=first["model_id"], **both)
    check_what_is_decided(read_discovery(client, job["id"]), hidden, "half_width")


SLOW = 4.0
ROWS, KNOCKED_S, KNOCK_MM = 34, 82.0, 0.03  # since the stream began


@pytest.fixture
def knocked(tmp_path):
    fault = f"tracker:knock@{KNOCKED_S}s*{KNOCK_MM}"
    bench = {"simulated_speed": SLOW, "simulated_faults": (fault,)}
    with simulated_service(tmp_path / "data", 500, **bench) as opened:
        yield opened


def measure(client, end, on_notice):
    program = paths.chord_path(parse_machine(load_machine("demo")), 3, ROWS, 8000.0)
    path = rows_at(*program.position.tolist())
    for row, dwell_s in zip(path, program.dwell_s.tolist(), strict=True):
        row["dwell_s"] = dwell_s
    return drive(client, end, path=path, feed_mm_min=8000, on_notice=on_notice)


def count_lines(client, job):
    return len(client.get(job["links"]["plan"]).json()["position"]) - 1


@pytest.mark.fault_row(11)
def test_a_knock_is_told_kept_and_the_line_before_it_driven_again(knocked):
    (service, client), told = knocked, []
    service.event_bus.subscribe(told.append)
    job = measure(client, "succeeded", "check")
    notice = job["notices"][0]
    assert (notice["kind"], notice["grade"]) == ("set-up-moved", "certain")
    assert KNOCKED_S < notice["noticed_s"] < KNOCKED_S + 12.0
    assert notice["noticed_row"] - notice["since_row"] <= 2
    assert abs(notice["size_um"] - 1e3 * KNOCK_MM) < 3.0
    assert notice["action"] == "check"
    assert next(event for event in told if event.type == "notice").body["number"] == 1
    assert count_lines(client, job) >= ROWS - 1 + 4
    result = client.get(job["result"]["result"]).json()
    assert result["notices"] == job["notices"]


def test_a_machine_that_is_held_goes_on_as_it_is_told(knocked):
    _, client = knocked
    held = measure(client, "paused", "pause")
    assert held["notices"]
    version = {"If-Match": f'"{held["version"]}"'}
    resume = f"/api/v1/jobs/{held['id']}/resume?then=replan"
    assert client.post(resume, headers=version).status_code == 202
    job = follow(client, held["id"], "succeeded", patience_s=300.0)
    assert job["notices"][0]["action"] == "replan"
    assert count_lines(client, job) > ROWS - 1


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
