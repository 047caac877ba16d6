"""ABORT on the page of the real service: the machine's own word counts.

The devices run beside the service: the test looks where the machine truly is.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

sys.path.append(str(Path(__file__).parents[1] / "jobs"))
from service_process import arm, create, process, wait_for

from truepath_simulators.bench.rig import Rig, running_rig
from truepath_simulators.scenario import load_machine

pytestmark = [
    pytest.mark.long,
    pytest.mark.ui,
    pytest.mark.timeout(180),
    pytest.mark.xdist_group("browser"),
]

NEWER_JOBS = 25
WATCHED_S = 9.0
REST_S = 0.2
LONG_PATH = [
    {"x_mm": 20 + 450 * (n % 2), "y_mm": 20 + 5 * n, "z_mm": 150, "feed_mm_min": 900}
    for n in range(20)
]
NOTE_STAGES = """
  const note = () => {
    const sheet = document.getElementById("abort-sheet");
    (window.stages ??= []).push(sheet.hidden ? "" : sheet.dataset.stage);
  };
  document.addEventListener("DOMContentLoaded", () =>
    new MutationObserver(note).observe(document.getElementById("abort-sheet"),
      { attributes: true }));
"""


@pytest.fixture
def rig():
    with running_rig({"tracker": "tcp", "seed": 3}) as started:
        yield started


@pytest.fixture
def client(rig, tmp_path):
    """A client of the service that has these devices."""
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    environment = {
        "TRUEPATH_SIMULATED": "0",
        "TRUEPATH_MACHINE_FILE": str(file),
        "TRUEPATH_TRACKER_OPTIONS": json.dumps(rig.tracker_options),
        "TRUEPATH_MOTION_OPTIONS": json.dumps(rig.motion_options),
    }
    with process(tmp_path, **environment) as (_, asking):
        answer = asking.post("/api/v1/machines/current:connect")
        assert answer.status_code == 200, answer.text
        yield asking


@pytest.fixture
def page(browser, client):
    context = browser.new_context(viewport={"width": 1280, "height": 800}, locale="en")
    opened = context.new_page()
    opened.add_init_script(NOTE_STAGES)
    opened.goto(str(client.base_url))
    yield opened
    context.close()


def begin_to_move(client, rig) -> str:
    """A long slow path is driven; newer jobs fill the first page of the list."""
    job = create(client, path=LONG_PATH)
    for _ in range(NEWER_JOBS):
        answer = client.post("/api/v1/plans", json={"minutes": 5})
        assert answer.status_code == 202, answer.text
    arm(client, job)
    on_path = {"line": 1}.items()
    wait_for(lambda: on_path <= rig.read_state()["cnc"].items(), "motion on the path")
    return job["id"]


def moves(rig: Rig) -> bool:
    before = rig.read_position()["position"][0]
    time.sleep(REST_S)
    return rig.read_position()["position"][0] != before


def stages(page: Page) -> set[str]:
    return set(page.evaluate("window.stages ?? []"))


@pytest.mark.fault_row(32)
def test_a_stop_is_confirmed_once_the_machine_stands(rig, client, page, measured):
    job = begin_to_move(client, rig)
    assert moves(rig)
    begun_s = time.monotonic()
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("Motion stopped", timeout=10_000)
    measured(f"confirmed {time.monotonic() - begun_s:.2f} s after the click")
    assert not moves(rig)
    assert client.get(f"/api/v1/jobs/{job}").json()["state"] == "aborted"


@pytest.mark.fault_row(17)
@pytest.mark.fault_row(32)
def test_a_stop_that_the_controller_ignores_is_never_confirmed(rig, client, page):
    begin_to_move(client, rig)
    rig.inject("cnc:ignore-commands@0s+600s")
    page.locator("#abort").click()
    expect(page.locator("#abort-sheet")).to_have_attribute(
        "data-stage", "unconfirmed", timeout=10_000
    )
    assert "emergency stop" in page.locator("#abort-text").inner_text().lower()
    wait_for(lambda: not moves(rig), "the machine's own watchdog", WATCHED_S)
    assert client.get("/api/v1/system").json()["current_job"] is None
    for _ in range(3):
        with page.expect_response(lambda answer: "/api/v1/jobs" in answer.url):
            pass
    assert "unconfirmed" in stages(page)
    assert not stages(page) & {"confirmed", "idle"}
