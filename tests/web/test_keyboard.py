"""Every action of every view by Tab alone; no motion for who has asked for none."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect
from test_accessibility import views_of_a_calibration

pytestmark = [
    pytest.mark.ui,
    pytest.mark.timeout(180),
    pytest.mark.xdist_group("browser"),
]

MOST_STOPS = 600
FOCUSABLE = "a[href], button, input, select, textarea, summary, iframe, [tabindex]"
WATCH = """
window.reached = new Set();
document.addEventListener("focusin", ({ target }) => window.reached.add(target));
"""
# What is in sight, may be used and was not reached.
MISSED = """(focusable) => [...document.querySelectorAll(focusable)]
    .filter((e) => e.checkVisibility({ visibilityProperty: true }) && !e.disabled)
    .filter((e) => e.tabIndex >= 0 || e.matches("a, button, select, summary"))
    .filter((e) => e.tagName !== "IFRAME" && !window.reached.has(e))
    .map((e) => e.outerHTML.slice(0, 160))"""
# What looks as if it could be pressed, and is for a pointer alone.
FOR_A_POINTER = """(focusable) => [...document.querySelectorAll("body *")]
    .filter((e) => getComputedStyle(e).cursor === "pointer" && e.checkVisibility())
    .filter((e) => !e.closest(`${focusable}, label`))
    .map((e) => e.outerHTML.slice(0, 160))"""
MOVING = """() => [...document.querySelectorAll("*")].flatMap((e) =>
    [null, "::before", "::after"].map((part) => getComputedStyle(e, part)))
    .filter(({ transitionDuration, animationName }) =>
      transitionDuration.split(", ").some((one) => parseFloat(one) > 0)
      || animationName !== "none").length"""


def test_tab_reaches_every_action_of_every_view(panel, service, witness):
    witness.expect("status of 404")  # nothing stands of the machine
    page = panel.open("#/records", before=WATCH)
    expect(page.locator("main h1")).to_be_visible()
    views = views_of_a_calibration(service)
    page.reload()
    missed = {}
    for view, shown in views.items():
        page.goto(f"{panel.address}/#/{view}")
        expect(page.locator(shown).first).to_be_visible()
        if found := walk(page):
            missed[view] = found
    assert missed == {}


def test_tab_reaches_what_starts_holds_and_ends_the_motion(panel, service):
    service.connected = True
    job = service.new_job("measure-otf", state="ready")["id"]
    page = panel.open(f"#/check/{job}", before=WATCH)
    expect(page.locator("#next button")).to_be_enabled()
    missed = {"check": walk(page)}
    service.change(job, state="running", stage="measuring")
    page.wait_for_url(f"**/#/run/{job}")
    expect(page.locator("#cancel")).to_be_visible()
    missed["run"] = walk(page)
    service.change(job, state="paused")
    expect(page.locator("#resume")).to_be_enabled()
    missed["paused"] = walk(page)
    assert missed == {"check": [], "run": [], "paused": []}


def test_nothing_moves_for_who_has_asked_for_less_motion(panel, service):
    service.connected = True
    service.new_job("measure-otf", state="running", stage="measuring")
    page = panel.open()
    expect(page.locator("#cancel")).to_be_visible()
    assert page.evaluate(MOVING) > 0
    page.emulate_media(reduced_motion="reduce")
    assert page.evaluate(MOVING) == 0


def walk(page: Page) -> list[str]:
    """Press Tab until it goes round; return what was not reached."""
    page.evaluate("window.reached.clear(), document.activeElement.blur()")
    for _ in range(MOST_STOPS):
        before = page.evaluate("window.reached.size")
        page.keyboard.press("Tab")
        if page.evaluate("window.reached.size") > before:
            continue
        if not page.evaluate(MISSED, FOCUSABLE):
            break
        if page.evaluate("document.activeElement.id") == "skip":
            break
    return page.evaluate(MISSED, FOCUSABLE) + page.evaluate(FOR_A_POINTER, FOCUSABLE)
