"""The whole circle over REST: measured, asked, driven by simulated devices, decided.

The truth of the bench hides an effect; the service knows nothing of it. Extra lines are
driven as any other motion: armed by whoever has looked at them.
"""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from arming import arm_over_http
from service_process import (
    acknowledge,
    arm,
    create,
    follow,
    kill,
    process,
    wait_until_done,
)
from truepath.main import open_service
from truepath.service.api.application import create_application
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
from truepath_simulators.worlds.synthetic import Setting

MACHINE = 5
SPEED = 15.0
PATIENCE_S = 120.0
FEW = 10  # extra lines
LEANS = {"lateral-backlash", "squareness"}
JOBS = "/api/v1/jobs"
CONTENT = load_machine("demo")
LOW, HIGH = parse_machine(CONTENT).low_mm + 15.0, parse_machine(CONTENT).high_mm - 15.0
ENDS = {"succeeded", "failed", "faulted", "aborted", "interrupted"}
Rows = list[dict[str, float]]


@dataclass(frozen=True)
class Shop:
    """A program on the shop floor, and the service that it talks to."""

    client: TestClient

    def upload(self, bundle: bytes) -> str:
        answer = self.client.post("/api/v1/runs", files={"bundle": ("r.zip", bundle)})
        assert answer.status_code == 201, answer.text
        return answer.json()["id"]

    def ended(self, **order: Any) -> dict[str, Any]:
        """Order a job, arm it once it is ready, follow it to its end."""
        answer = self.client.post(JOBS, json=order)
        assert answer.status_code == 202, answer.text
        at = answer.headers["Location"]
        job = self._followed(at, {"ready", *ENDS})
        if job["state"] == "ready":
            assert self.client.get(job["links"]["plan"]).json()["position"]
            assert arm_over_http(self.client, job).status_code == 202
            job = self._followed(at, ENDS)
        return job

    def done(self, **order: Any) -> dict[str, Any]:
        job = self.ended(**order)
        assert job["state"] == "succeeded", job["error"]
        return job

    def found(self, job: dict[str, Any]) -> dict[str, Any]:
        return self.client.get(job["discovery"]["discovery"]).json()

    def _followed(self, at: str, states: set[str]) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while (job := self.client.get(at).json())["state"] not in states:
            assert time.monotonic() < end, job
            time.sleep(0.05)
        return job


@contextmanager
def shop_that_hides(hidden: HiddenEffect, folder: Path) -> Iterator[Shop]:
    """Run the service over a bench whose machine has an effect that no model knows."""
    settings = load_settings(
        data_dir=folder,
        simulated=True,
        simulated_speed=SPEED,
        simulated_seed=MACHINE,
        simulated_hidden=(json.dumps(as_json(hidden)),),
        port=0,
    )
    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        yield Shop(client)


def two_sides_of_y() -> Rows:
    """Points at the ends of Y, each approached from the other: play looks like a lean.

    The first point, approached from nowhere, is in the middle, where no lean shows.
    """
    rng, n = np.random.default_rng(4), 24
    share = rng.random((n, 3))
    far = np.arange(n) % 2 == 1
    share[:, 1] = np.where(far, 1.0 - 0.03 * share[:, 1], 0.03 * share[:, 1])
    share[0, 1] = 0.5
    return rows_of(np.round(LOW + share * (HIGH - LOW), 3), dwell_s=0.8)


def rows_of(position: np.ndarray, dwell_s: float, **more: np.ndarray) -> Rows:
    names = ("x_mm", "y_mm", "z_mm")
    rows = [dict(zip(names, place, strict=True)) for place in position.tolist()]
    for name, values in more.items():
        rows = [{**r, name: v} for r, v in zip(rows, values.tolist(), strict=True)]
    return [{**row, "dwell_s": dwell_s} for row in rows]


def calibration(folder: Path) -> bytes:
    """Return a bundle of the machine before anything happened to it."""
    program = paths.chord_path(parse_machine(CONTENT), 9, 40, 6000.0)
    setting = Setting(machine_seed=MACHINE)
    recording = synthetic.record(CONTENT, program, 9, setting=setting)
    write_bundle_files(folder, recording)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for file in folder.iterdir():
            archive.write(file, file.name)
    return packed.getvalue()


def names(effect: dict[str, Any]) -> set[str]:
    """Return the names of an effect and of what may be there in its place."""
    return {effect["name"], *(e["name"] for e in effect["indistinguishable_from"])}


def check_what_is_asked(found: dict[str, Any], competing: set[str]) -> None:
    assert names(found["effects"][0]) == competing
    asked = found["ask"]
    assert asked["lines"] < FEW
    assert asked["lines"] == len(asked["rows"]) - 1
    assert asked["decides"]
    assert all(name in asked["reason"] for name in competing)


def check_what_is_decided(
    found: dict[str, Any], competing: set[str], hidden: HiddenEffect, parameter: str
) -> None:
    effect, *others = found["effects"]
    assert effect["name"] == hidden.name
    assert effect["indistinguishable_from"] == []
    # Before its first motion an axis with play stands as it was left: that is no step.
    assert "setup-step" not in {e["name"] for e in others}
    assert not competing & {e["name"] for e in others}
    said = effect["parameters"][parameter]
    truth = getattr(hidden, parameter)
    assert abs(said["value"] - truth) < 3.0 * said["uncertainty"]
    gap = found["gap"]
    assert gap["after"] < gap["before"]
    assert gap["after"] < 1.3 * gap["noise_floor"]


@pytest.mark.long
@pytest.mark.timeout(300)
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
    (tmp_path / "bundle").mkdir()
    with shop_that_hides(hidden, tmp_path / "data") as context:
        before = context.upload(calibration(tmp_path / "bundle"))
        model = context.done(kind="discover", run_id=before)["id"]
        points = two_sides_of_y()
        run = context.done(kind="measure-standstill", points=points)["run_id"]
        first = context.done(kind="discover", run_id=run, model_id=model)
        check_what_is_asked(context.found(first), LEANS)
        second = context.done(kind="measure-extra", discovery_id=first["id"])
        check_what_is_decided(context.found(second), LEANS, hidden, parameter)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_lines_may_be_driven_as_a_path_of_ones_own(tmp_path):
    (tmp_path / "bundle").mkdir()
    hidden = LateralBacklash("Y", "EXY", 5.0, 0.3)
    with shop_that_hides(hidden, tmp_path / "data") as context:
        before = context.upload(calibration(tmp_path / "bundle"))
        model = context.done(kind="discover", run_id=before)["id"]
        points = two_sides_of_y()
        run = context.done(kind="measure-standstill", points=points)["run_id"]
        job = context.done(kind="discover", run_id=run, model_id=model)
        first = context.found(job)
        check_what_is_asked(first, LEANS)
        # So few lines need not determine tables of their own; their Run stands.
        extra = context.ended(kind="measure-otf", path=first["ask"]["rows"])
        runs = [run, extra["run_id"]]
        second = context.done(kind="discover", run_ids=runs, model_id=model)
        check_what_is_decided(context.found(second), LEANS, hidden, "half_width")


@pytest.mark.long
@pytest.mark.fault_row(25)
@pytest.mark.timeout(400)
def test_extra_lines_whose_service_was_killed_go_on_and_decide(tmp_path):
    (tmp_path / "bundle").mkdir()
    hidden = LateralBacklash("Y", "EXY", 8.0, 0.3)
    settings = {
        "TRUEPATH_SIMULATED_SPEED": "3",  # slow enough to be met between lines
        "TRUEPATH_SIMULATED_SEED": str(MACHINE),
        "TRUEPATH_SIMULATED_HIDDEN": json.dumps([json.dumps(as_json(hidden))]),
    }
    with process(tmp_path, **settings) as (service, client):
        context = Shop(client)
        before = context.upload(calibration(tmp_path / "bundle"))
        model = context.done(kind="discover", run_id=before)["id"]
        points = two_sides_of_y()
        run = context.done(kind="measure-standstill", points=points)["run_id"]
        first = context.done(kind="discover", run_id=run, model_id=model)
        extra = create(client, kind="measure-extra", discovery_id=first["id"])
        arm(client, extra)
        wait_until_done(client, extra["id"], 1)  # of few lines
        kill(service)
    with process(tmp_path, **settings) as (_, client):
        arm(client, acknowledge(client, extra["id"]))
        ended = follow(client, extra["id"], "succeeded", patience_s=PATIENCE_S)
        assert ended["run_ids"][0] == run
        assert len(ended["run_ids"]) == 3
        found = Shop(client).found(ended)
        check_what_is_decided(found, LEANS, hidden, "half_width")
