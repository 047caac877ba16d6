"""What the page shows and how: age of data, units, languages, light and dark, touch."""

from __future__ import annotations

import io
import re
import time

import pytest
from PIL import Image, ImageStat
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

SIZES = [(1280, 800), (1920, 1080), (390, 844), (800, 1280)]
STALE_S = 2.5
TOUCH_PX = 56
JOBS = re.compile(r"/api/v1/jobs[/?]")
STICKING_OUT = """() => [...document.querySelectorAll(".card, .choice, button")]
    .filter((e) => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1)
    .map((e) => e.outerHTML.slice(0, 120))"""
HEIGHTS = "all => all.map((e) => e.offsetHeight)"
CLOSED = {
    "type": "machine-ready",
    "level": "true",
    "is_required": True,
    "reason": "",
    "message": "",
    "since": "2026-03-14T08:00:00Z",
}
LOOK = "e => [getComputedStyle(e).color, getComputedStyle(e).opacity]"


def test_data_older_than_2_5_s_are_stamped_stale(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    measuring(service)
    page = panel.open()
    expect(page.locator("#stamp")).to_have_text("Live data")
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    begun = time.monotonic()
    expect(page.locator("#stamp")).to_contain_text(re.compile(r"DATA STALE since \d"))
    assert (
        time.monotonic() - begun > STALE_S - 0.6
    )  # the last tick was up to 0.25 s ago
    expect(page.locator(".is-stale-data .readout")).to_be_visible()
    expect(page.locator("#reason")).to_contain_text("No data from the service")
    service.silent = False
    expect(page.locator("#stamp")).to_have_text("Live data")
    expect(page.locator(".is-stale-data")).to_have_count(0)


@pytest.mark.parametrize("dark", [False, True])
def test_stale_numbers_keep_their_contrast_and_bear_their_age(
    panel, service, witness, dark
):
    witness.expect("net::ERR_FAILED")
    measuring(service)
    page = panel.open(dark=dark)
    number = page.locator(".readout output").first
    expect(number).to_be_visible()
    fresh = number.evaluate(LOOK)
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    stale = page.locator(".is-stale-data", has=page.locator(".readout"))
    expect(stale).to_have_attribute("data-age", re.compile(r"^[3-9] s old$"))
    assert number.evaluate(LOOK) == fresh
    assert "gradient" in stale.evaluate("e => getComputedStyle(e).backgroundImage")


def test_stale_conditions_bear_their_age(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    service.connected = True
    service.conditions = [CLOSED]
    page = panel.open("#/connect")
    shown = page.locator(".conditions [data-level=true]")
    expect(shown).to_be_visible()
    page.route("**/conditions", lambda route: None)  # answers too late
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    stale = page.locator(".is-stale-data", has=shown)
    expect(stale).to_have_attribute("data-age", re.compile(r"^[3-9] s old$"))


def test_nothing_sticks_out_of_its_frame_on_a_german_phone(panel, service):
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")["id"]
    service.finish(job)
    page = panel.open("#/plan", size=(390, 844), language="de")
    for view, shown in {
        "plan": "#feed",
        f"export/{job}": "[data-format]",
        f"verify/{job}": "#verify-tolerance",
        f"certificate/{job}": "#state-operator",
        "machine": "[data-card=who]",
    }.items():
        page.goto(f"{panel.address}/#/{view}")
        expect(page.locator(shown).first).to_be_visible()
        assert page.evaluate(STICKING_OUT) == [], view
        heights = page.locator(".stepper").evaluate_all(HEIGHTS)
        assert all(height < 2 * 64 for height in heights), view


def test_the_state_stays_clear_of_what_is_beside_it_on_a_german_phone(panel, service):
    job = service.new_job("measure-otf", state="interrupted")["id"]
    page = panel.open(f"#/run/{job}", size=(390, 844), language="de")
    state = page.locator("#state")
    expect(state).to_have_text("Unterbrochen")
    own, tools = state.bounding_box(), page.locator(".bar-tools").bounding_box()
    assert own is not None
    assert tools is not None
    assert own["x"] + own["width"] <= tools["x"]
    assert state.evaluate("e => e.scrollWidth <= e.clientWidth")
    widths = page.locator(".tool").evaluate_all("all => all.map((e) => e.offsetWidth)")
    assert min(widths) >= 48


def test_where_no_events_come_the_page_asks_and_follows(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    job = measuring(service)
    page = panel.open("#/connect", hears=True)
    page.route_web_socket("**/api/v1/events*", lambda socket: socket.close())
    page.reload()
    expect(page.locator("#stamp")).to_contain_text("Asked each second")
    page.goto(page.url.split("#")[0] + f"#/run/{job}")
    service.advance(job, 11)
    samples = page.locator(".stream .tile", has=page.locator("dt:text-is('Samples')"))
    expect(samples).to_contain_text("30,800")
    service.change(job, state="paused", desired_state="paused")
    expect(page.locator("#state")).to_have_text("Paused")
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")
    page.locator("#abort-close").click()
    expect(page.locator("#state")).to_have_text("Aborted")


def test_a_file_that_misses_its_zone_never_leaves_the_page(panel):
    page = panel.open("#/connect")
    for kind in ("dragover", "drop"):
        opens = page.evaluate(
            "kind => document.body.dispatchEvent("
            "new DragEvent(kind, { bubbles: true, cancelable: true }))",
            kind,
        )
        assert not opens, kind


def test_the_language_changes_in_place_and_stays(panel, service):
    service.stopped = "true"
    page = panel.open()
    expect(page.locator("h1")).to_have_text("Connect")
    page.locator("#open-settings").click()
    page.get_by_role("button", name="Deutsch").click()
    expect(page.locator("h1")).to_have_text("Verbinden")
    expect(page.locator("#abort")).to_contain_text("ABBRUCH")
    assert page.locator("html").get_attribute("lang") == "de"
    page.reload()
    expect(page.locator("h1")).to_have_text("Verbinden")
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("Es war nichts in Bewegung")


def test_german_numbers_have_a_decimal_comma(panel, service):
    job = done(service)
    page = panel.open(f"#/result/{job}", language="de-DE")
    expect(page.locator("td.right").first).to_have_text("23,4 µrad")


def test_inch_changes_what_is_shown_and_nothing_else(panel, service):
    job = done(service)
    page = panel.open(f"#/result/{job}")
    residual = page.locator(".tile", has_text="Residual")
    expect(residual).to_contain_text("4.3µm")
    choose(page, "inch")
    expect(residual).to_contain_text("169µin")
    expect(page.locator("[data-symbol=EXX] h3 .unit")).to_have_text("µin")
    expect(page.locator("[data-symbol=EAX] h3 .unit")).to_have_text("µrad")
    page.goto(page.url.split("#")[0] + "#/plan")
    units = ["in", "in", "in", "min", "in/min", "µin"]
    expect(page.locator(".suffix")).to_have_text(units)
    page.locator("#next button").click()
    page.wait_for_url("**/#/check/*")
    ((_, _, order),) = service.requests
    assert "feed_mm_min" not in order  # left to the planner, as in millimetres


def test_a_feed_typed_in_inches_is_sent_in_millimetres(panel, service):
    service.connected = True
    page = panel.open("#/plan", language="de")
    choose(page, "Zoll")
    page.locator("#feed").fill("100,5")
    page.locator("#next button").click()
    page.wait_for_url("**/#/check/*")
    ((_, _, order),) = service.requests
    assert order["feed_mm_min"] == pytest.approx(2552.7)


def test_dark_is_dark_and_light_is_light(panel, service):
    job = done(service)
    grey = {}
    for dark in (False, True):
        page = panel.open(f"#/result/{job}", dark=dark)
        expect(page.locator(".chart canvas")).to_have_count(17)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("L")
        grey[dark] = ImageStat.Stat(picture).mean[0]
    assert grey[True] < 60
    assert grey[False] > 200


def test_the_operator_can_overrule_the_systems_appearance(panel):
    page = panel.open()
    choose(page, "Dark")
    assert page.locator("html").get_attribute("data-theme") == "dark"
    page.reload()
    assert page.locator("html").get_attribute("data-theme") == "dark"


def test_one_scale_for_all_tables_or_one_each(panel, service):
    job = done(service)
    page = panel.open(f"#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    drawn = "document.querySelector('[data-symbol=EYX] canvas').toDataURL()"
    before = page.evaluate(drawn)
    page.get_by_role("button", name="Own scale").click()
    expect(page.locator(".chart canvas")).to_have_count(17)
    assert page.evaluate(drawn) != before


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_german_words_fit_at_every_size(panel, service, size):
    service.connected = True
    job = done(service)
    page = panel.open(size=size, language="de")
    for view in ("connect", "plan", f"run/{job}", f"result/{job}", "records"):
        page.goto(f"{page.url.split('#')[0]}#/{view}")
        expect(page.locator("h1")).to_be_attached()
        assert too_wide(page) == [], view


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}x{s[1]}")
def test_what_can_be_touched_is_large_enough(panel, service, size):
    service.connected = True
    page = panel.open("#/plan", size=size, touch=True)
    expect(page.locator("#feed")).to_be_visible()
    small = page.evaluate(
        """(least) => [...document.querySelectorAll("button, main a, input")]
            .filter((e) => e.checkVisibility())
            .filter((e) => e.getBoundingClientRect().height < least)
            .map((e) => e.outerHTML)""",
        TOUCH_PX,
    )
    assert small == []


def test_the_keyboard_reaches_everything_and_the_focus_shows(panel, service):
    service.connected = True
    page = panel.open()
    expect(page.locator("#next button")).to_be_visible()
    reached = set()
    for _ in range(14):
        page.keyboard.press("Tab")
        focused = page.evaluate(
            """() => {
              const style = getComputedStyle(document.activeElement);
              const { id, className } = document.activeElement;
              return [id || className, style.outlineStyle];
            }"""
        )
        if focused[0]:
            assert focused[1] == "solid", focused[0]
        reached.add(focused[0])
    assert {"skip", "abort", "open-settings", "to-records", "next"} <= reached


def test_state_is_announced_politely_and_problems_at_once(panel):
    page = panel.open()
    expect(page.locator("#state")).to_have_attribute("aria-live", "polite")
    expect(page.locator("#problems")).to_have_attribute("aria-live", "assertive")


def measuring(service) -> str:
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")
    service.advance(job["id"], 2.0)
    return job["id"]


def done(service) -> str:
    job = measuring(service)
    service.finish(job)
    return job


def choose(page: Page, name: str) -> None:
    page.locator("#open-settings").click()
    page.locator("#settings").get_by_role("button", name=name).click()
    page.keyboard.press("Escape")


def too_wide(page: Page) -> list[str]:
    """Elements whose words stick out of them, or out of the page."""
    return page.evaluate(
        """(selector) => [...document.querySelectorAll(selector)]
            .filter((e) => e.checkVisibility() && !e.matches(".unseen"))
            .filter((e) => getComputedStyle(e).display !== "inline")
            .filter((e) => e.scrollWidth > e.clientWidth + 1)
            .map((e) => `${e.tagName} ${e.textContent.trim().slice(0, 40)}`)""",
        "body, button, .button, h1, h2, h3, th, dd, .tag, .state",
    )
