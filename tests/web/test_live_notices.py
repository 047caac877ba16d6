"""What is noticed while the machine moves is told, and answered, on the page."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import expect
from test_flow import held
from test_live_estimate import measuring

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]


def notice(**more: Any) -> dict[str, Any]:
    usual = {
        "number": 1,
        "kind": "something-changed",
        "grade": "possible",
        "axis": "",
        "since_row": 14,
        "noticed_row": 14,
        "noticed_s": 83.5,
        "size_um": 10.2,
        "uncertainty_um": 0.6,
        "is_over": False,
        "action": "note",
    }
    return {**usual, **more}


@pytest.mark.parametrize(
    ("language", "first", "later", "grade"),
    [
        ("en", "Something changed", "was knocked", "certain"),
        ("de", "Etwas hat sich geändert", "wurde angestoßen", "sicher"),
    ],
)
def test_a_notice_is_told_and_gets_its_name(
    panel, service, language, first, later, grade
):
    job = measuring(service)
    page = panel.open(language=language)
    service.change(job, notices=[notice()])
    said = page.locator(".notice")
    expect(said).to_contain_text(first)
    expect(said).to_contain_text("14")
    expect(said).to_contain_text("10.2" if language == "en" else "10,2")
    service.change(job, notices=[notice(kind="set-up-moved", grade="certain")])
    expect(said).to_contain_text(later)
    expect(said).to_contain_text(grade)
    expect(page.locator("#then-check")).to_have_count(0)


def test_what_is_over_says_so_and_stays(panel, service):
    job = measuring(service, notices=[notice(kind="line-off", is_over=True)])
    page = panel.open()
    expect(page.locator(".notice")).to_contain_text("nothing of it any more")
    assert service.jobs[job]["notices"]


def test_who_is_asked_holds_a_button_and_lines_are_measured_again(panel, service):
    job = measuring(service)
    page = panel.open()
    asked = notice(kind="lost-motion-changed", axis="Y", grade="likely", action="pause")
    service.change(job, state="paused", notices=[asked])
    expect(page.locator(".notice")).to_contain_text("lost motion of Y has changed")
    version = service.jobs[job]["version"]
    with held(page, page.locator("#then-check")):
        expect(page.locator("#state")).to_have_text("Running")
    sent = ("POST", f"/jobs/{job}/resume?then=check", f'"{version}"')
    assert sent in service.requests
    expect(page.locator("#then-check")).to_have_count(0)


def test_the_order_says_what_is_done_about_a_notice(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("#on-notice [data-value=pause]").click()
    page.locator("#next button").click()
    page.wait_for_url("**/#/check/*")
    (order,) = [body for _, path, body in service.requests if path == "/jobs"]
    assert order["on_notice"] == "pause"
