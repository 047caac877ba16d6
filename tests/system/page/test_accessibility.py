"""Every view by axe-core and by Tab alone; no motion for who has asked for none."""

import contextlib
import re
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, TimeoutError, expect
from tests.system.page.test_history import trend_of

import scripted_data
from page_steps import DESK, NEXT, PHONE, choose, go, small_targets

pytestmark = pytest.mark.timeout(180)

LEAST_TOUCH_PX = {DESK: 56, PHONE: 48}
LONG_DESK = [pytest.param(DESK, marks=pytest.mark.long), PHONE]
JOBS = re.compile(r"/api/v1/jobs[/?]")
STATED_BOX = """() => localStorage.setItem("truepath.keep_out", JSON.stringify(
    {default: [{name: "vice", min_mm: [1, 1, 1], max_mm: [9, 9, null]}]}))"""

FOUND = "(options) => axe.run(document, options).then((all) => all.violations)"
ENDED_TRANSITIONS = """() => Promise.allSettled(document.getAnimations()
    .filter((one) => one instanceof CSSTransition).map((one) => one.finished))"""
ALL = {"resultTypes": ["violations"]}
# Light or dark only changes colours: the other rules read the same document again.
CONTRAST = {**ALL, "runOnly": ["color-contrast"]}
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


@pytest.mark.parametrize("size", LONG_DESK)
def test_views_hinder_nobody_and_tab_reaches_all_actions(panel, service, witness, size):
    witness.expect("status of 404")  # nothing stands of the machine before
    page = panel.open("#/records", size=size, before=WATCH)
    bad = hindrances(page, "records", "main h1")
    views = views_of_a_calibration(service)
    page.evaluate(STATED_BOX)
    page.reload()
    for view, shown in views.items():
        go(page, f"#/{view}")
        bad += hindrances(page, view, shown)
        bad += small_targets(page, view, LEAST_TOUCH_PX[size])
        if size == DESK:
            bad += [f"{view}: {missed}" for missed in walk(page)]
    assert bad == []


@pytest.mark.parametrize("size", LONG_DESK)
def test_no_state_of_a_run_hinders_anybody(panel, service, witness, size):
    witness.expect("net::ERR_FAILED")
    job = service.ready()
    page = panel.open(f"#/check/{job}", size=size)
    bad = hindrances(page, "ready", ".path-view[data-drawn]")
    service.change(job, state="running", stage="measuring")
    page.wait_for_url(f"**/#/run/{job}")
    service.advance(job, 11.0)
    service.estimate(job, 11)
    expect(page.locator(".big-progress strong")).to_have_text("50%")
    bad += hindrances(page, "running", ".big-progress strong")
    error = {"title": "Feed held", "detail": "At the panel", "action": "Cycle start."}
    service.change(job, state="paused", error=error)
    bad += hindrances(page, "held", "main .notice.is-held")
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    bad += hindrances(page, "stale", "#stamp:has-text('STALE')")
    service.silent = False
    page.unroute(JOBS)
    expect(page.locator("#stamp")).to_have_text("Live data")
    error = {"title": "Beam lost", "detail": "Line 7", "action": "Clear the sight."}
    service.change(job, state="faulted", error=error)
    bad += hindrances(page, "fault", "main .notice:has-text('Clear the sight.')")
    page.locator("#open-settings").click()
    bad += hindrances(page, "settings", "#settings")
    page.keyboard.press("Escape")
    page.locator("#abort").click()
    bad += hindrances(page, "abort", "#abort-close")
    assert bad == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("size", "dark"), [(DESK, False), (PHONE, False), (PHONE, True)]
)
def test_nothing_that_is_opened_hinders_anybody(panel, service, witness, size, dark):
    witness.expect("status of 404", "status of 409")
    views = list(views_of_a_calibration(service))
    page = panel.open("#/plan", size=size, dark=dark)
    bad = []
    for view, touched in (
        ("result/", "[data-symbol=EXX] button"),
        ("result/", ".map-table summary"),
        ("discover/", "details.graded summary"),
        ("discover/", ".strips-table summary"),
        ("export/", "[data-format]"),
        ("plan", "[data-place]:last-child"),
        ("machine", "details summary"),
    ):
        (address,) = [one for one in views if one.startswith(view)]
        go(page, f"#/{address}")
        page.locator(touched).first.click()
        bad += violations(page, f"{address}, {touched}", CONTRAST if dark else ALL)
        bad += small_targets(page, address, LEAST_TOUCH_PX[size])
        page.keyboard.press("Escape")
    assert bad == []


def views_of_a_calibration(service) -> dict[str, str]:
    """Fill the service with one of everything; each view and what it shows then."""
    service.result["volumetric_error"] = scripted_data.volumetric_error()
    job = service.measured()
    proof = service.verified(
        scripted_data.verification(job) | scripted_data.circles_in_motion()
    )
    found = service.done("discover", run_id="run-1")
    service.trend = trend_of("due", expected_h=8.25, exceeded=0.9, grade="likely")
    trend = service.done("trend", run_id="run-1")
    dates = "2026-03-13T08:00:00Z", "2026-03-14T08:00:00Z"
    service.histories["default"] = scripted_data.machine_history("default", *dates)
    service.compensations[job] = [scripted_data.compensation(job, "linuxcnc", "hold")]
    service.certificates[job] = [scripted_data.certificate(job, 1, "en")]
    return {
        "machine": "[data-machine]",
        "connect": "[data-connected]",
        "plan": "#feed",
        f"run/{job}": "main .card",
        f"result/{job}": ".chart canvas",
        f"discover/{found}": "[data-effect]",
        f"export/{job}": "[data-card=export]",
        f"verify/{job}": "#verify-tolerance",
        f"verify/{proof}": ".circle-plot",
        f"certificate/{job}": "iframe.preview",
        "records": "tbody tr",
        f"trend/{trend}": "main .card",
    }


def hindrances(page: Page, where: str, shown: str) -> list[str]:
    """What hinders somebody in a view once something is shown, light and dark."""
    found = []
    for theme, options in (("dark", CONTRAST), ("light", ALL)):
        page.emulate_media(color_scheme=theme)
        expect(page.locator(shown).first).to_be_visible()
        found += violations(page, f"{where}, {theme}", options)
    return found


def violations(page: Page, where: str, options: dict[str, Any]) -> list[str]:
    """What axe-core calls moderate or worse, with the elements it means.

    Colours are judged where they end: on their way they are neither of both.
    """
    page.evaluate(ENDED_TRANSITIONS)
    if not page.evaluate("'axe' in window"):
        page.evaluate(Axe().axe_script)
    found = page.evaluate(FOUND, options)
    return [
        f"{where}: {rule['id']} ({rule['impact']}) {node['target']} {node['html']}"
        for rule in found
        if rule["impact"] in ("moderate", "serious", "critical")
        for node in rule["nodes"]
    ]


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
        for _ in range(8):
            page.keyboard.press("Tab")
    assert page.evaluate("window.unmarked") == []
    return page.evaluate(MISSED, FOCUSABLE) + page.evaluate(FOR_A_POINTER, FOCUSABLE)


UUID = r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"
VALUES = r"(?<![\w.])(?:true|false|null|undefined|NaN|None)(?![\w.])|\[object "
KEYS = r"\b[a-z]+(?:_[a-z0-9]+)+\b"
LITERAL = re.compile("|".join((r"\d{4}-\d\d-\d\dT\d\d:\d\d", UUID, VALUES, KEYS)))
# Files and columns that an operator is asked for bear the names that they have.
FILES = re.compile(r"\b[\w-]+\.(?:csv|json|zip)\b|\bposition_mm\b")
SENSOR = {
    "channel": "air_degC",
    "how": 'address = 12, word_order = "big"',
    "value": 20.5,
}
# What is asked for after the view is there.
LATER = {
    "run": ".path-view[data-drawn]",
    "result": ".map-picture[data-drawn]",
    "discover": "[data-versions] .versions b",
    "export": "[data-format]",
    "records": "td.number:has-text('±')",
    "verify": ".circle-plot",
}
# A view goes on filling in after its first part is there.
SAYS_ALL = """(found) => {
    const said = document.querySelector("main").innerText.split("\\n");
    return found.every((line) => said.includes(line));
}"""


def said(page: Page, view: str, shown: str) -> list[str]:
    go(page, f"#/{view}")
    return lines(page, view, shown)


def lines(page: Page, view: str, shown: str) -> list[str]:
    for selector in (shown, LATER.get(view.split("/")[0], shown)):
        expect(page.locator(selector).first).to_be_visible()
    return page.locator("main").inner_text().splitlines()


def test_a_language_changed_in_place_is_that_of_all_words(panel, service, witness):
    witness.expect("status of 404")  # nothing stands of the machine before
    views = views_of_a_calibration(service)
    opened = panel.open("#/records", language="de")
    changed = panel.open("#/records")
    differing = []
    for view, shown in views.items():
        said(opened, view, shown)
        said(changed, view, shown)
        choose(changed, "Deutsch")
        expect(changed.locator("html")).to_have_attribute("lang", "de")
        found = lines(changed, view, shown)
        with contextlib.suppress(TimeoutError):  # what is missing is named below
            opened.wait_for_function(SAYS_ALL, arg=found)
        wanted = lines(opened, view, shown)
        differing += [(view, line) for line in found if line not in wanted]
        choose(changed, "English")
        expect(changed.locator("html")).to_have_attribute("lang", "en")
    assert differing == []


@pytest.mark.parametrize(("language", "size"), [("en", DESK), ("de", PHONE)])
def test_no_view_has_raw_values_keys_or_times(panel, service, witness, language, size):
    witness.expect("status of 404")  # nothing stands of the machine before
    views = views_of_a_calibration(service)
    for run in service.runs:
        run["name"] = "VMC 500 2026-03-14T08:00:00.129Z"  # as the service names them
    service.machine = service.machine | {"sensors": [SENSOR]}
    page = panel.open("#/records", language=language, size=size)
    found = []
    for view, shown in views.items():
        said(page, view, shown)
        page.locator("main details").evaluate_all(
            "all => all.forEach((one) => { one.open = true; })"
        )
        found += [
            (view, line)
            for line in lines(page, view, shown)
            if LITERAL.search(FILES.sub("", line))
        ]
    assert found == []
