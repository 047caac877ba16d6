"""The whole circle over REST: measured, asked, driven by simulated devices, decided.

The truth of the bench hides an effect; the service knows nothing of it. Extra lines are
driven as any other motion: armed by whoever has looked at them.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import httpx2
import numpy as np
import pytest

from real_services import drive, service_of, write_machine
from service_process import (
    ENDS,
)
from truepath.settings import load_settings
from truepath_simulators.hidden.effect import HiddenEffect
from truepath_simulators.hidden.effects_by_name import as_json
from truepath_simulators.hidden.guides import Squareness
from truepath_simulators.hidden.screws import LateralBacklash
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine
from truepath_simulators.worlds import synthetic
from truepath_simulators.worlds.bundle_files import write_bundle_files

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]

MACHINE = 5
FEW = 10  # extra lines
LEANS = {"lateral-backlash", "squareness"}
CONTENT = load_machine("demo")
LOW, HIGH = parse_machine(CONTENT).low_mm + 15.0, parse_machine(CONTENT).high_mm - 15.0


@contextmanager
def bench_that_hides(hidden: HiddenEffect, folder: Path) -> Iterator[httpx2.Client]:
    """Run the service over a bench whose machine has an effect that no model knows."""
    settings = load_settings(
        data_dir=folder / "data",
        simulated=True,
        machine_file=write_machine(folder.with_name("machine.json"), 500),
        simulated_speed=15.0,
        simulated_seed=MACHINE,
        simulated_hidden=(json.dumps(as_json(hidden)),),
        port=0,
    )
    with service_of(settings) as (_, client):
        yield client


def two_sides_of_y() -> list[dict[str, float]]:
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


def calibration(folder: Path) -> bytes:
    """Return a bundle of the machine before anything happened to it."""
    program = paths.chord_path(parse_machine(CONTENT), 9, 40, 6000.0)
    setting = synthetic.Setting(machine_seed=MACHINE)
    files = folder / "bundle"
    files.mkdir()
    write_bundle_files(files, synthetic.record(CONTENT, program, 9, setting=setting))
    return Path(shutil.make_archive(str(files), "zip", files)).read_bytes()


class Discovered(NamedTuple):
    """A model of before, a Run of points, and the discovery of that Run."""

    model_id: str
    run_id: str
    discovery_id: str


def discover_at_points(client: httpx2.Client, folder: Path) -> Discovered:
    sent = {"bundle": ("r.zip", calibration(folder))}
    before = client.post("/api/v1/runs", files=sent).json()["id"]
    model_id = drive(client, kind="discover", run_id=before)["id"]
    points = two_sides_of_y()
    run_id = drive(client, kind="measure-standstill", points=points)["run_id"]
    job = drive(client, kind="discover", run_id=run_id, model_id=model_id)
    return Discovered(model_id, run_id, job["id"])


def read_discovery(client: httpx2.Client, job_id: str) -> dict[str, Any]:
    return client.get(f"/api/v1/jobs/{job_id}/discovery").json()


def check_what_is_asked(found: dict[str, Any]) -> None:
    effect = found["effects"][0]
    names = {effect["name"], *(e["name"] for e in effect["indistinguishable_from"])}
    assert names == LEANS
    asked = found["ask"]
    assert asked["lines"] < FEW
    assert asked["lines"] == len(asked["rows"]) - 1
    assert asked["decides"]
    assert all(name in asked["reason"] for name in LEANS)


def check_what_is_decided(
    found: dict[str, Any], hidden: HiddenEffect, parameter: str = "half_width"
) -> None:
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


@pytest.mark.parametrize(
    ("hidden", "parameter"),
    [
        (LateralBacklash("Y", "EXY", 5.0, 0.3), "half_width"),
        (Squareness("C0Y", -27.0), "value_urad"),
    ],
    ids=["lateral-backlash", "squareness"],
)
def test_lateral_backlash_and_squareness_are_told_apart_by_the_machine(
    tmp_path, hidden, parameter
):
    with bench_that_hides(hidden, tmp_path) as client:
        first = discover_at_points(client, tmp_path)
        check_what_is_asked(read_discovery(client, first.discovery_id))
        extra = {"kind": "measure-extra", "discovery_id": first.discovery_id}
        found = read_discovery(client, drive(client, **extra)["id"])
        check_what_is_decided(found, hidden, parameter)


def test_the_lines_may_be_driven_as_a_path_of_ones_own(tmp_path):
    hidden = LateralBacklash("Y", "EXY", 5.0, 0.3)
    with bench_that_hides(hidden, tmp_path) as client:
        first = discover_at_points(client, tmp_path)
        found = read_discovery(client, first.discovery_id)
        check_what_is_asked(found)
        # So few lines need not determine tables of their own; their Run stands.
        extra = drive(client, *ENDS, path=found["ask"]["rows"])
        order = {"run_ids": [first.run_id, extra["run_id"]], "model_id": first.model_id}
        second = drive(client, kind="discover", **order)
        check_what_is_decided(read_discovery(client, second["id"]), hidden)
