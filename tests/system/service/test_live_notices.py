"""A knock of the tracker during a Run, on simulated devices over their real links."""

import pytest

from real_services import drive, simulated_service
from service_process import follow
from truepath_simulators.machine_file import parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.scenario import load_machine

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

SPEED = 6.0
ROWS, KNOCKED_S, KNOCK_MM = 34, 82.0, 0.03  # since the stream began


@pytest.fixture
def knocked(tmp_path):
    """A service over a bench whose tracker is pushed aside once, and a client of it."""
    fault = f"tracker:knock@{KNOCKED_S}s*{KNOCK_MM}"
    bench = {"simulated_speed": SPEED, "simulated_faults": (fault,)}
    with simulated_service(tmp_path / "data", 500, **bench) as opened:
        yield opened


def measure(client, end, on_notice):
    program = paths.chord_path(parse_machine(load_machine("demo")), 3, ROWS, 8000.0)
    path = [
        {"x_mm": x, "y_mm": y, "z_mm": z, "dwell_s": dwell}
        for (x, y, z), dwell in zip(
            program.position.tolist(), program.dwell_s.tolist(), strict=True
        )
    ]
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
    job = follow(client, held["id"], "succeeded", patience_s=150.0)
    assert job["notices"][0]["action"] == "replan"
    assert count_lines(client, job) > ROWS - 1
