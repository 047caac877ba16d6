"""Every view by axe-core: each size, light and dark, in the states that matter."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect
from scripted_data import (
    certificate,
    circles_in_motion,
    compensation,
    machine_history,
    verification,
    volumetric_error,
)
from test_trend import trend_of

pytestmark = [
    pytest.mark.ui,
    pytest.mark.timeout(120),
    pytest.mark.xdist_group("browser"),
]

DESK, PHONE = (1280, 800), (390, 844)
LEAST_TOUCH_PX = {DESK: 56, PHONE: 48}
LOOKS = list(product((DESK, PHONE), (False, True)))
JOBS = re.compile(r"/api/v1/jobs[/?]")
STATED_BOX = """() => localStorage.setItem("truepath.keep_out", JSON.stringify(
    {default: [{name: "vice", min_mm: [1, 1, 1], max_mm: [9, 9, null]}]}))"""

HINDRANCES = ("moderate", "serious", "critical")
AXE = Axe()
ENDED_TRANSITIONS = """() => Promise.allSettled(document.getAnimations()
    .filter((one) => one instanceof CSSTransition).map((one) => one.finished))"""
ALL = {"resultTypes": ["violations"]}
# Light or dark only changes colours: the other rules read the same document again.
CONTRAST = {**ALL, "runOnly": ["color-contrast"]}


def list_looks(often: list[tuple[tuple[int, int], bool]]) -> list[Any]:
    """Return all sizes and themes; the long tests have those that repeat most of it."""
    return [
        look if look in often else pytest.param(*look, marks=pytest.mark.long)
        for look in LOOKS
    ]


@pytest.mark.parametrize(("size", "dark"), LOOKS)
def test_no_view_hinders_anybody_before_and_after_a_calibration(
    panel, service, witness, size, dark
):
    witness.expect("status of 404")  # nothing stands of the machine before
    page = panel.open("#/records", size=size, dark=dark)
    expect(page.locator("main h1")).to_be_visible()
    options = CONTRAST if dark else ALL
    bad = hindrances(page, "records, empty", options)
    views = views_of_a_calibration(service)
    page.evaluate(STATED_BOX)
    page.reload()
    for view, shown in views.items():
        page.goto(f"{panel.address}/#/{view}")
        expect(page.locator(shown).first).to_be_visible()
        bad += hindrances(page, view, options)
        bad += small_targets(page, view, LEAST_TOUCH_PX[size])
    assert bad == []


@pytest.mark.parametrize(("size", "dark"), list_looks([(DESK, True), (PHONE, False)]))
def test_no_state_of_a_run_hinders_anybody(panel, service, witness, size, dark):
    witness.expect("net::ERR_FAILED")
    options = CONTRAST if dark else ALL
    service.connected = True
    job = service.new_job("measure-otf", state="ready")["id"]
    page = panel.open(f"#/check/{job}", size=size, dark=dark)
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    bad = hindrances(page, "ready", options)
    service.change(job, state="running", stage="measuring")
    page.wait_for_url(f"**/#/run/{job}")
    service.advance(job, 11.0)
    service.estimate(job, 11)
    expect(page.locator(".big-progress strong")).to_have_text("50%")
    bad += hindrances(page, "running", options)
    error = {"title": "Feed held", "detail": "At the panel", "action": "Cycle start."}
    service.change(job, state="paused", error=error)
    expect(page.locator("main .notice.is-held")).to_be_visible()
    bad += hindrances(page, "held", options)
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    expect(page.locator("#stamp")).to_contain_text("STALE")
    bad += hindrances(page, "stale", options)
    service.silent = False
    page.unroute(JOBS)
    expect(page.locator("#stamp")).to_have_text("Live data")
    error = {"title": "Beam lost", "detail": "Line 7", "action": "Clear the sight."}
    service.change(job, state="faulted", error=error)
    expect(page.locator("main .notice")).to_contain_text("Clear the sight.")
    bad += hindrances(page, "fault", options)
    page.locator("#open-settings").click()
    bad += hindrances(page, "settings", options)
    page.keyboard.press("Escape")
    page.locator("#abort").click()
    expect(page.locator("#abort-close")).to_be_visible()
    bad += hindrances(page, "abort", options)
    assert bad == []


@pytest.mark.parametrize(("size", "dark"), list_looks([]))
def test_nothing_that_is_opened_hinders_anybody(panel, service, witness, size, dark):
    witness.expect("status of 404", "status of 409")
    views = list(views_of_a_calibration(service))
    page = panel.open("#/plan", size=size, dark=dark)
    options = CONTRAST if dark else ALL
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
        page.goto(f"{panel.address}/#/{address}")
        page.locator(touched).first.click()
        bad += hindrances(page, f"{address}, {touched}", options)
        bad += small_targets(page, address, LEAST_TOUCH_PX[size])
        page.keyboard.press("Escape")
    assert bad == []


def views_of_a_calibration(service) -> dict[str, str]:
    """Fill the service with one of everything; each view and what it shows then."""
    service.connected = True
    service.result["volumetric_error"] = volumetric_error()
    job = service.new_job("measure-otf", state="running", stage="measuring")["id"]
    service.finish(job)
    proof = service.new_job("verify", state="running", stage="measuring")["id"]
    service.verifications[proof] = verification(job) | circles_in_motion()
    service.finish(proof)
    found = service.new_job("discover", run_id="run-1")["id"]
    service.finish(found)
    trend = service.new_job("trend", run_id="run-1")["id"]
    service.trend = trend_of("due", expected_h=8.25, exceeded=0.9, grade="likely")
    service.finish(trend)
    dates = "2026-03-13T08:00:00Z", "2026-03-14T08:00:00Z"
    service.histories["default"] = machine_history("default", *dates)
    service.compensations[job] = [compensation(job, "linuxcnc", "hold")]
    service.certificates[job] = [certificate(job, 1, "en")]
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


def hindrances(page: Page, where: str, options: dict[str, Any]) -> list[str]:
    """What axe-core calls moderate or worse, with the elements it means.

    Colours are judged where they end: on their way they are neither of both.
    """
    page.evaluate(ENDED_TRANSITIONS)
    found = AXE.run(page, options=options).response["violations"]
    return [
        f"{where}: {rule['id']} ({rule['impact']}) {node['target']} {node['html']}"
        for rule in found
        if rule["impact"] in HINDRANCES
        for node in rule["nodes"]
    ]


def small_targets(page: Page, where: str, least_px: int) -> list[str]:
    """Controls that are lower than a gloved finger needs."""
    found = page.evaluate(
        """([selector, least]) => [...document.querySelectorAll(selector)]
            .map((e) => [e.getBoundingClientRect().height, e])
            .filter(([height, e]) => e.checkVisibility() && height < least - 0.5)
            .map(([height, e]) => `${height} px ${e.outerHTML.slice(0, 120)}`)""",
        ["button, main a, select, summary, input:not([type=file])", least_px],
    )
    return [f"{where}: {one}" for one in found]
