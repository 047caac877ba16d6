"""Every action of every view by Tab alone; no motion for who has asked for none."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect
from tests.system.page.test_accessibility import views_of_a_calibration

from page_steps import NEXT, go

pytestmark = pytest.mark.timeout(180)

STOPS_AT_ONCE = 8
FOCUSABLE = "a[href], button, input, select, textarea, summary, iframe, [tabindex]"
WATCH = """
window.reached = new Set();
window.unmarked = [];
document.addEventListener("focusin", ({ target }) => window.reached.add(target));
document.addEventListener("keyup", () => {
  const focused = document.activeElement;
  const { outlineStyle } = getComputedStyle(focused);
  if (focused.matches("button, a") && outlineStyle !== "solid")
    window.unmarked.push(focused.outerHTML);
});
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


@pytest.mark.long
def test_tab_reaches_every_action_of_every_view(panel, service, witness):
    witness.expect("status of 404")  # nothing stands of the machine
    page = panel.open("#/records", before=WATCH)
    expect(page.locator("main h1")).to_be_visible()
    views = views_of_a_calibration(service)
    page.reload()
    missed = {}
    for view, shown in views.items():
        go(page, f"#/{view}")
        expect(page.locator(shown).first).to_be_visible()
        if found := walk(page):
            missed[view] = found
    assert missed == {}


def test_tab_reaches_what_starts_holds_and_ends_the_motion(panel, service):
    job = service.ready()
    page = panel.open(f"#/check/{job}", before=WATCH)
    expect(page.locator("#next button")).to_be_enabled()
    missed = {"check": walk(page)}
    service.change(job, state="running", stage="measuring")
    page.wait_for_url(f"**/#/run/{job}")
    service.estimate(job, 4)
    for name in ("Error tables", "Axis Y"):
        button = page.get_by_role("button", name=name)
        button.focus()
        page.keyboard.press("Enter")
        expect(button).to_have_attribute("aria-pressed", "true")
    expect(page.locator("[data-symbol=EYY] canvas")).to_be_visible()
    missed["run"] = walk(page)
    service.change(job, state="paused")
    expect(page.locator("#resume")).to_be_enabled()
    missed["paused"] = walk(page)
    assert missed == {"check": [], "run": [], "paused": []}


def test_the_bar_is_reached_first_and_changes_are_announced(panel, service):
    service.connected = True
    page = panel.open()
    expect(page.locator(NEXT)).to_be_visible()
    # State is announced politely and problems at once.
    expect(page.locator("#state")).to_have_attribute("aria-live", "polite")
    expect(page.locator("#problems")).to_have_attribute("aria-live", "assertive")
    reached = set()
    for _ in range(14):
        page.keyboard.press("Tab")
        focused = "document.activeElement.id || document.activeElement.className"
        reached.add(page.evaluate(focused))
    assert {"skip", "abort", "open-settings", "to-records", "next"} <= reached


def test_nothing_moves_for_who_has_asked_for_less_motion(panel, service):
    service.measuring()
    page = panel.open(motion=True)
    expect(page.locator("#cancel")).to_be_visible()
    assert page.evaluate(MOVING) > 0
    page.emulate_media(reduced_motion="reduce")
    assert page.evaluate(MOVING) == 0


def walk(page: Page) -> list[str]:
    """Press Tab until it goes round; return what was not reached or is unmarked."""
    page.evaluate("window.reached.clear(), document.activeElement.blur()")
    reached = -1
    while reached < (reached := page.evaluate("window.reached.size")):
        for _ in range(STOPS_AT_ONCE):
            page.keyboard.press("Tab")
    assert page.evaluate("window.unmarked") == []
    return page.evaluate(MISSED, FOCUSABLE) + page.evaluate(FOR_A_POINTER, FOCUSABLE)
