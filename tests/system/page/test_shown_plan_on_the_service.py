"""What the page shows of a plan is what the controller gets, row by row."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect
from tests.system.page.test_calibration_on_the_service import Operator, Panels

from page_steps import DESK
from service_process import follow, wait_for
from service_with_devices import running_devices, service_of
from truepath.files.bundle.commanded_file import decode_commanded_json
from truepath.motion.configurations import select_rows
from truepath_drivers.cnc.modbus.path_words import path_crc, path_words
from truepath_drivers.transport.modbus_link import ModbusLink, TcpAddress
from truepath_simulators.bench.rig import Rig

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


def read_path(rig: Rig) -> tuple[int, int]:
    """Return the number of rows of the controller's path, and their CRC."""
    options = rig.motion_options
    link = ModbusLink(TcpAddress(options["host"], options["port"]), options["unit"])
    link.open()
    (rows,), crc = link.read(104, 1), link.read(108, 2)
    link.close()
    return rows, crc[0] << 16 | crc[1]


@pytest.fixture
def rig():
    with running_devices(speed=3.0) as started:
        yield started


@pytest.fixture
def client(rig, tmp_path):
    with service_of(rig, tmp_path) as client:
        yield client


def test_the_rows_in_the_controller_are_those_that_the_curve_shows(
    browser, witness, rig, client
):
    address = str(client.base_url).rstrip("/")
    panels = Panels(browser, address, witness)
    page = panels.open("", language="en-GB", size=DESK)
    operator = Operator(page)
    page.evaluate("location.hash = '#/connect'")
    operator.tap("Connect devices")
    card = page.locator("[data-card=curve]")
    card.get_by_role("button", name="3 min", exact=True).click()
    card.get_by_role("button", name="Compute the curve").click()
    handle = card.locator(".handle")
    expect(handle).to_be_visible(timeout=120_000.0)
    plan_id = client.get("/api/v1/jobs?kind=plan").json()["items"][0]["id"]
    plan = client.get(f"/api/v1/plans/{plan_id}").json()["commanded"]
    planned = decode_commanded_json(plan)
    for presses in (0, 4):  # untouched, then moved
        for _ in range(presses):
            handle.press("ArrowLeft")
        tile = card.locator(".tile", has_text="Lines or points").locator("dd")
        rows = int(tile.inner_text()) + 1
        operator.tap("Prepare the run")
        operator.hold("Hold to start motion", "**/#/run/*")
        wait_for(lambda: read_path(rig)[0], "a path in the controller")
        shown = path_words(select_rows(planned, slice(rows)))
        assert read_path(rig) == (rows, path_crc(shown))
        assert client.post("/api/v1/stop").status_code < 300
        follow(client, operator.job, "aborted")
        page.evaluate("location.hash = '#/plan'")
    assert len(client.get("/api/v1/jobs?kind=plan").json()["items"]) == 1
    assert rows < len(planned)
    panels.close()
