"""A knock of the tracker during a Run, on simulated devices over their real links."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest

from real_services import drive, service_of, write_machine
from service_process import follow
from truepath.catalogue.job import JobEvent
from truepath.settings import load_settings
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

SPEED = 6.0
ROWS, KNOCKED_S, KNOCK_MM = 34, 82.0, 0.03  # since the stream began


@contextmanager
def knocked_floor(folder: Path) -> Iterator[tuple[httpx2.Client, list[JobEvent]]]:
    """Run the service over a bench whose tracker is pushed aside once.

    Yield a client of it, and the events that it tells.
    """
    settings = load_settings(
        data_dir=folder,
        simulated=True,
        machine_file=write_machine(folder.with_name("machine.json"), 500),
        simulated_speed=SPEED,
        simulated_faults=(f"tracker:knock@{KNOCKED_S}s*{KNOCK_MM}",),
        port=0,
    )
    told: list[JobEvent] = []
    with service_of(settings) as (service, client):
        service.event_bus.subscribe(told.append)
        yield client, told


def measure(client: httpx2.Client, end: str, on_notice: str) -> dict[str, Any]:
    program = paths.chord_path(parse_machine(load_machine("demo")), 3, ROWS, 8000.0)
    path = [
        {"x_mm": x, "y_mm": y, "z_mm": z, "dwell_s": dwell}
        for (x, y, z), dwell in zip(
            program.position.tolist(), program.dwell_s.tolist(), strict=True
        )
    ]
    return drive(client, end, path=path, feed_mm_min=8000, on_notice=on_notice)


def count_lines(client: httpx2.Client, job: dict[str, Any]) -> int:
    return len(client.get(job["links"]["plan"]).json()["position"]) - 1


@pytest.mark.fault_row(11)
def test_a_knock_is_told_kept_and_the_line_before_it_driven_again(tmp_path):
    with knocked_floor(tmp_path / "data") as (client, told):
        job = measure(client, "succeeded", "check")
        notice = job["notices"][0]
        assert (notice["kind"], notice["grade"]) == ("set-up-moved", "certain")
        assert KNOCKED_S < notice["noticed_s"] < KNOCKED_S + 12.0
        assert notice["noticed_row"] - notice["since_row"] <= 2
        assert abs(notice["size_um"] - 1e3 * KNOCK_MM) < 3.0
        assert notice["action"] == "check"
        first = next(event for event in told if event.type == "notice")
        assert first.body["number"] == 1
        assert count_lines(client, job) >= ROWS - 1 + 4
        result = client.get(job["result"]["result"]).json()
    assert result["notices"] == job["notices"]


def test_a_machine_that_is_held_goes_on_as_it_is_told(tmp_path):
    with knocked_floor(tmp_path / "data") as (client, _):
        held = measure(client, "paused", "pause")
        assert held["notices"]
        version = {"If-Match": f'"{held["version"]}"'}
        resume = f"/api/v1/jobs/{held['id']}/resume?then=replan"
        assert client.post(resume, headers=version).status_code == 202
        job = follow(client, held["id"], "succeeded", patience_s=150.0)
        assert job["notices"][0]["action"] == "replan"
        assert count_lines(client, job) > ROWS - 1
