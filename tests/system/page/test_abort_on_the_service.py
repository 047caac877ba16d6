"""ABORT on the page of the real service: the machine's own word counts.

The devices run beside the service: the test looks where the machine truly is.
"""

from __future__ import annotations

import time

import pytest
from playwright.sync_api import Page, expect

from page_steps import DESK
from service_process import wait_for
from service_with_devices import (
    connect,
    moves,
    running_devices,
    service_of,
    set_in_motion,
)

pytestmark = [pytest.mark.long, pytest.mark.timeout(180)]

NEWER_JOBS = 25
WATCHED_S = 9.0
NOTE_STAGES = """
  const note = () => {
    const sheet = document.getElementById("abort-sheet");
    (window.stages ??= []).push(sheet.hidden ? "" : sheet.dataset.stage);
  };
  document.addEventListener("DOMContentLoaded", () =>
    new MutationObserver(note).observe(document.getElementById("abort-sheet"),
      { attributes: true }));
"""


@pytest.fixture(scope="module")
def rig():
    with running_devices() as started:
        yield started


@pytest.fixture(scope="module")
def client(rig, tmp_path_factory):
    with service_of(rig, tmp_path_factory.mktemp("service")) as asking:
        connect(asking)
        yield asking


@pytest.fixture
def page(browser, client):
    viewport = {"width": DESK[0], "height": DESK[1]}
    context = browser.new_context(viewport=viewport, locale="en")
    opened = context.new_page()
    opened.add_init_script(NOTE_STAGES)
    opened.goto(str(client.base_url))
    yield opened
    context.close()


def stages(page: Page) -> set[str]:
    return set(page.evaluate("window.stages ?? []"))


@pytest.mark.fault_row(32)
def test_a_stop_is_confirmed_once_the_machine_stands(rig, client, page, measured):
    job = set_in_motion(client, rig, NEWER_JOBS)
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
    set_in_motion(client, rig, NEWER_JOBS)
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
