"""A knock of the tracker during a Run, on simulated devices over their real links."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from arming import arm_over_http
from truepath.catalogue.job import JobEvent
from truepath.main import open_service
from truepath.service.api.application import create_application
from truepath.settings import load_settings
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine

SPEED = 6.0
ROWS, KNOCKED_S, KNOCK_MM = 34, 82.0, 0.03  # since the stream began
JOBS = "/api/v1/jobs"
ENDS = {"succeeded", "failed", "faulted", "aborted", "interrupted"}
PATIENCE_S = 150.0


class Floor:
    """A program on the shop floor, its job, and the notices that it hears."""

    def __init__(self, client: TestClient, told: list[dict[str, Any]]) -> None:
        self.client, self.told, self.at = client, told, ""

    def begin(self, **order: Any) -> None:
        """Order a measurement of random lines, and arm it."""
        program = paths.chord_path(parse_machine(load_machine("demo")), 3, ROWS, 8000.0)
        rows = zip(program.position, program.dwell_s, strict=True)
        path = [
            {"x_mm": p[0], "y_mm": p[1], "z_mm": p[2], "dwell_s": float(dwell)}
            for p, dwell in rows
        ]
        body = {"kind": "measure-otf", "path": path, "feed_mm_min": 8000, **order}
        answer = self.client.post(JOBS, json=body)
        assert answer.status_code == 202, answer.text
        self.at = answer.headers["Location"]
        armed = arm_over_http(self.client, self.wait_for({"ready", *ENDS}))
        assert armed.status_code == 202, armed.text

    def command(self, verb: str, job: dict[str, Any], query: str = "") -> None:
        version = {"If-Match": f'"{job["version"]}"'}
        answer = self.client.post(f"{self.at}/{verb}{query}", headers=version)
        assert answer.status_code == 202, answer.text

    def wait_for(self, states: set[str]) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while (job := self.client.get(self.at).json())["state"] not in states:
            assert time.monotonic() < end, job
            time.sleep(0.1)
        return job


@contextmanager
def knocked_floor(folder: Path) -> Iterator[Floor]:
    """Run the service over a bench whose tracker is pushed aside once."""
    settings = load_settings(
        data_dir=folder,
        simulated=True,
        simulated_speed=SPEED,
        simulated_faults=(f"tracker:knock@{KNOCKED_S}s*{KNOCK_MM}",),
        port=0,
    )
    told: list[dict[str, Any]] = []
    lock = threading.Lock()

    def hear(event: JobEvent) -> None:
        if event.type == "notice":
            with lock:
                told.append(dict(event.body))

    with (
        open_service(settings) as service,
        TestClient(create_application(service), base_url="http://localhost") as client,
    ):
        service.event_bus.subscribe(hear)
        yield Floor(client, told)


def lines_of(job: dict[str, Any], client: TestClient) -> int:
    return len(client.get(job["links"]["plan"]).json()["position"]) - 1


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.fault_row(11)
def test_a_knock_is_told_kept_and_the_line_before_it_driven_again(tmp_path):
    with knocked_floor(tmp_path / "data") as floor:
        floor.begin(on_notice="check")
        job = floor.wait_for(ENDS)
        assert job["state"] == "succeeded", job["error"]
        notice = job["notices"][0]
        assert (notice["kind"], notice["grade"]) == ("set-up-moved", "certain")
        assert KNOCKED_S < notice["noticed_s"] < KNOCKED_S + 12.0
        assert notice["noticed_row"] - notice["since_row"] <= 2
        assert abs(notice["size_um"] - 1e3 * KNOCK_MM) < 3.0
        assert notice["action"] == "check"
        assert floor.told[0]["number"] == 1
        assert lines_of(job, floor.client) >= ROWS - 1 + 4
        result = floor.client.get(f"{floor.at}/result").json()
    assert result["notices"] == job["notices"]


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_machine_that_is_held_goes_on_as_it_is_told(tmp_path):
    with knocked_floor(tmp_path / "data") as floor:
        floor.begin(on_notice="pause")
        held = floor.wait_for({"paused", *ENDS})
        assert held["state"] == "paused"
        assert held["notices"]
        floor.command("resume", held, "?then=replan")
        job = floor.wait_for(ENDS)
        assert job["state"] == "succeeded", job["error"]
        assert job["notices"][0]["action"] == "replan"
        assert lines_of(job, floor.client) > ROWS - 1
