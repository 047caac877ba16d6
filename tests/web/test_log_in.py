"""The page where somebody has to log in; the name of a user is its role here."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest
from playwright.sync_api import Error, expect

pytestmark = pytest.mark.ui


@pytest.fixture
def closed(service, witness):
    """A service that asks for a log-in."""
    service.log_in_required = True
    witness.expect("401")
    return service


def log_in(page, name, password="right"):
    page.locator("#user-name").fill(name)
    page.locator("#user-password").fill(password)
    page.locator(".log-in button").click()


def shoot(page, name):
    """Keep a picture where PICTURES names a folder."""
    if folder := os.environ.get("PICTURES"):
        page.screenshot(path=Path(folder) / f"{name}.png")


@pytest.mark.parametrize(
    ("language", "title", "wrong"),
    [
        ("en", "Log in", "do not belong together"),
        ("de", "Anmelden", "gehören nicht zusammen"),
    ],
)
def test_who_logs_in_is_named_in_the_bar(panel, closed, language, title, wrong):
    page = panel.open(language=language, hears=False)
    expect(page.locator(".log-in h1")).to_have_text(title)
    expect(page.locator("#abort")).to_be_visible()
    shoot(page, f"log-in-{language}")
    log_in(page, "operator", "wrong")
    expect(page.locator(".log-in .field-error")).to_contain_text(wrong)
    log_in(page, "operator")
    expect(page.locator("#user")).to_contain_text("operator ·")
    expect(page.locator("#next button")).to_be_visible()
    shoot(page, f"operator-{language}")


def test_a_viewer_is_not_offered_what_moves_the_machine(panel, closed):
    closed.user = "viewer", "viewer"
    page = panel.open()
    expect(page.locator("#reason")).to_contain_text("A viewer only looks on")
    expect(page.locator("#next button")).to_have_count(0)
    expect(page.locator("#abort")).to_be_visible()
    shoot(page, "viewer")


def test_the_end_of_a_session_asks_again_and_abort_still_stops(panel, closed):
    closed.user = "operator", "operator"
    page = panel.open()
    expect(page.locator("#user")).to_be_visible()
    closed.user = None
    # The page may have asked for something by itself already, and left the step.
    with suppress(Error):  # it turns to the log-in at that very moment
        page.evaluate("document.querySelector('#next button')?.click()")
    expect(page.locator(".log-in h1")).to_be_visible()
    with page.expect_response("**/api/v1/stop") as stopped:
        page.locator("#abort").click()
    assert stopped.value.status == 202
    shoot(page, "abort-logged-out")


def test_after_the_end_of_a_session_only_the_controllers_word_confirms_a_stop(
    panel, closed
):
    closed.user = "operator", "operator"
    closed.new_job("measure-otf", state="running", stage="measuring")
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    closed.user = None
    page.locator("#abort").click()
    title = page.locator("#abort-title")
    expect(title).to_contain_text("NOT CONFIRMED")
    closed.stopped = "true"
    expect(title).to_have_text("Motion stopped")


def test_where_nobody_logs_in_nobody_is_asked(panel, service):
    page = panel.open()
    expect(page.locator(".log-in")).to_have_count(0)
    expect(page.locator("#user")).to_be_hidden()


def test_logging_out_asks_again(panel, closed):
    closed.user = "operator", "operator"
    page = panel.open()
    page.locator("#open-settings").click()
    page.get_by_role("button", name="Log out").click()
    expect(page.locator(".log-in h1")).to_be_visible()
    assert closed.user is None
