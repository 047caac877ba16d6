"""The page where somebody has to log in; the name of a user is its role here."""

from contextlib import suppress

import pytest
from playwright.sync_api import Error, expect

from page_steps import NEXT, choose


@pytest.fixture
def closed(service, witness):
    service.log_in_required = True
    witness.expect("401")
    return service


def log_in(page, name, password="right"):
    page.locator("#user-name").fill(name)
    page.locator("#user-password").fill(password)
    page.locator(".log-in button").click()


def test_who_logs_in_is_named_in_the_bar(panel, closed):
    page = panel.open(language="de", hears=False)
    title = page.locator(".log-in h1")
    expect(title).to_have_text("Anmelden")
    expect(page.locator("#abort")).to_be_visible()
    log_in(page, "operator", "wrong")
    wrong = page.locator(".log-in .field-error")
    expect(wrong).to_contain_text("gehören nicht zusammen")
    log_in(page, "operator")
    expect(page.locator("#user")).to_contain_text("operator ·")
    expect(page.locator(NEXT)).to_be_visible()
    choose(page, "English")
    page.locator("#open-settings").click()
    page.get_by_role("button", name="Log out").click()
    expect(title).to_have_text("Log in")
    assert closed.user is None
    log_in(page, "operator", "wrong")
    expect(wrong).to_contain_text("do not belong together")


def test_a_viewer_is_not_offered_what_moves_the_machine_and_nobody_asked_in_vain(
    panel, closed
):
    closed.user = "viewer", "viewer"
    page = panel.open()
    expect(page.locator("#reason")).to_contain_text("A viewer only looks on")
    expect(page.locator("#next button")).to_have_count(0)
    expect(page.locator("#abort")).to_be_visible()
    closed.log_in_required, closed.user = False, None
    page.reload()
    expect(page.locator(NEXT)).to_be_visible()
    expect(page.locator(".log-in")).to_have_count(0)
    expect(page.locator("#user")).to_be_hidden()


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
    page.locator("#abort-close").click()
    with suppress(Error):  # it turns to the log-in at that very moment
        page.evaluate("document.querySelector('#next button')?.click()")
    expect(page.locator(".log-in h1")).to_be_visible()
    with page.expect_response("**/api/v1/stop") as stopped:
        page.locator("#abort").click()
    assert stopped.value.status == 202
