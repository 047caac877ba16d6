"""A machine that changes between two calibrations raises an alarm.

It is added while the service runs; its simulated truth is changed between both.
"""

import json

import pytest
from playwright.sync_api import expect

from service_process import ROWS, arm, create, follow, process, wait_for
from service_with_devices import running_devices, write_machine
from truepath.client import Client

pytestmark = [pytest.mark.long, pytest.mark.timeout(400)]

SPEED = 8.0
STRAIGHT = "0 0 0\n500 500 500\n"
BUMP = "0 0 0\n250 250.06 250.06\n500 500 500\n"  # 60 µm too far in the middle of X


@pytest.fixture
def rig():
    with running_devices(speed=SPEED) as started:
        yield started


@pytest.fixture
def client(rig, tmp_path):
    """A client of a service without a machine in its settings; one is added."""
    with process(tmp_path, TRUEPATH_SIMULATED="0") as (_, asking):
        with Client(str(asking.base_url)) as service:
            machine = json.loads(write_machine(tmp_path).read_text())
            service.add_machine("mill", machine_file=machine)
            chosen = {
                "tracker_options": rig.tracker_options,
                "motion_options": rig.motion_options,
            }
            service.set_machine_devices("mill", **chosen)
            (one,) = service.list_machines()
            assert (one["id"], one["version"]) == ("mill", 2)
        yield asking


def calibrate(client):
    place = "/api/v1/machines/mill:connect"
    wait_for(lambda: client.post(place).status_code == 200, "the devices")
    job = create(client, path=ROWS)
    arm(client, job)
    ended = follow(client, job["id"], "succeeded")
    assert ended["machine"] == "mill"
    return ended["id"]


def read_standing(client):
    return client.get("/api/v1/machines/mill/standing").json()


def test_a_machine_that_has_changed_raises_an_alarm_on_every_way(
    client, rig, browser, tmp_path
):
    table = tmp_path / "bump-X.tbl"  # it corrects from the start: that is no change
    table.write_text(STRAIGHT)
    rig.load_compensation([table])
    first = calibrate(client)
    wait_for(lambda: read_standing(client)["calibration"] == first, "the first")
    before = read_standing(client)
    assert (before["is_alarm"], before["has_changed"]) == (False, None)
    table.write_text(BUMP)
    rig.load_compensation([table])
    second = calibrate(client)
    wait_for(lambda: read_standing(client)["calibration"] == second, "the second")
    standing = read_standing(client)
    assert standing["is_alarm"], standing
    assert (standing["has_changed"], standing["reference_job"]) == (True, first)
    assert "EXX" in standing["change_text"]
    conditions = client.get("/api/v1/machines/mill/conditions").json()["items"]
    (unchanged,) = [one for one in conditions if one["type"] == "unchanged"]
    assert unchanged["level"] == "false"
    page = browser.new_context(locale="en").new_page()
    page.goto(f"{client.base_url}#/machine")
    card = page.locator("[data-machine=mill]")
    expect(card.locator("[data-standing=alarm]")).to_contain_text("changed")
    page.context.close()
