"""The whole circle over REST: measured, asked, driven by simulated devices, decided.

The truth of the bench hides an effect; the service knows nothing of it. Extra lines are
driven as any other motion: armed by whoever has looked at them.
"""

import json

import numpy as np
import pytest

from real_services import drive, simulated_service
from service_process import ENDS
from truepath.files.bundle.bundle import zip_bundle
from truepath_simulators.hidden.effects_by_name import as_json
from truepath_simulators.hidden.guides import Squareness
from truepath_simulators.hidden.screws import LateralBacklash
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds.synthetic import Setting

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]

MACHINE = 5
FEW = 10  # extra lines
LEANS = {"lateral-backlash", "squareness"}
CONTENT = load_machine("demo")
LOW, HIGH = parse_machine(CONTENT).low_mm + 15.0, parse_machine(CONTENT).high_mm - 15.0


@pytest.fixture
def client(hidden, tmp_path):
    """A service over a bench whose machine has an effect that no model knows."""
    bench = {"simulated_speed": 15.0, "simulated_seed": MACHINE}
    bench["simulated_hidden"] = (json.dumps(as_json(hidden)),)
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
    places = np.round(LOW + share * (HIGH - LOW), 3).tolist()
    return [{"x_mm": x, "y_mm": y, "z_mm": z, "dwell_s": 0.8} for x, y, z in places]


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
    assert effect["name"] == hidden.name
    assert effect["indistinguishable_from"] == []
    # Before its first motion an axis with play stands as it was left: that is no step.
    assert not {"setup-step", *LEANS} & {e["name"] for e in others}
    said = effect["parameters"][parameter]
    assert abs(said["value"] - getattr(hidden, parameter)) < 3.0 * said["uncertainty"]
    gap = found["gap"]
    assert gap["after"] < gap["before"]
    # So few lines do not fix all parameters: a complete model leaves that much.
    assert gap["after"] < 1.1 * gap["expected"]


PLAY = LateralBacklash("Y", "EXY", 5.0, 0.3)


@pytest.mark.parametrize(
    ("hidden", "parameter"),
    [(PLAY, "half_width"), (Squareness("C0Y", -27.0), "value_urad")],
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
