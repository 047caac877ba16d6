"""What the page shows and how: age of data, units, languages, light and dark, touch."""

import io
import re
import time
from typing import Literal

import pytest
from PIL import Image, ImageStat
from playwright.sync_api import Page, expect

from page_steps import NO_EVENTS, PHONE, choose, go, prepare, small_targets
from scripted_data import EXAMPLES, made_plan
from truepath.machines.conditions import ConditionType

CONDITIONS = EXAMPLES["list_conditions"]["items"]
SIZES = [(390, 844), (800, 1280), (1280, 800), (1920, 1080)]  # the narrowest first
TOUCH_PX = 56
JOBS = re.compile(r"/api/v1/jobs[/?]")
STICKING_OUT = """() => [...document.querySelectorAll(".card, .choice, button")]
    .filter((e) => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1)
    .map((e) => e.outerHTML.slice(0, 120))"""
HEIGHTS = "all => all.map((e) => e.offsetHeight)"
# How many rows the parts of each stepper that is seen take.
TOPS = """all => all.filter((e) => e.checkVisibility()).map((e) => new Set(
    [...e.querySelectorAll("button, input")].map((part) => part.offsetTop)).size)"""
# Of a number in the page: one that is drawn anew at this moment has no look.
LOOK = """() => {
  const look = getComputedStyle(document.querySelector(".readout output"));
  return look.color && [look.color, look.opacity];
}"""


# How far the last of the view is under the button that leads on, px.
TOO_LOW = """() => Math.max(...[...document.querySelectorAll("main > *")]
    .map((e) => e.getBoundingClientRect().bottom))
    - document.querySelector(".next-bar").getBoundingClientRect().top"""
SINCE = "2026-03-14T08:00:00.000Z"


@pytest.mark.parametrize("language", ["en", "de"])
def test_plan_and_check_fit_a_screen_at_a_line_per_condition(panel, service, language):
    service.connected = True
    service.planned = made_plan()
    service.plan["tracker_mm"] = [700, -900, 50]
    well = {"level": "true", "reason": "", "message": "", "since": SINCE}
    well |= {"is_required": True, "temperatures": []}
    (warm,) = [one for one in CONDITIONS if one["type"] == "temperature-steady"]
    types = [str(one) for one in ConditionType]
    service.conditions = [
        warm if one == warm["type"] else {"type": one, **well} for one in types
    ]
    page = panel.open("#/plan", language=language, unfolded=False)
    page.locator(".curve-space[data-drawn=plan-1]").wait_for()
    expect(page.locator(".conditions li")).to_have_count(1)
    assert page.evaluate(TOO_LOW) <= 0
    go(page, f"#/check/{service.ready()}")
    page.locator(".path-view[data-drawn]").wait_for()
    expect(page.locator(".conditions li")).to_have_count(len(types))
    expect(page.locator(".is-check [role=status] .pairs")).to_be_visible()
    assert page.evaluate(TOO_LOW) <= 0
    row = page.locator(".conditions [data-level=told]")
    expect(row.locator("p").first).to_be_hidden()
    row.locator("summary").click()
    expect(row.locator("p").first).to_be_visible()


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_word_of_the_field_opens_the_glossary_at_its_entry(panel, service, language):
    service.connected = True
    page = panel.open("#/plan", language=language)
    page.locator("[data-term=grade]").click()
    entries = page.locator("#detail .glossary > div")
    expect(entries.locator("dd:empty")).to_have_count(0)
    here = page.locator("#detail [aria-current]")
    expect(here).to_contain_text("0.25" if language == "en" else "0,25")
    page.keyboard.press("Escape")
    expect(here).to_be_hidden()
    go(page, f"#/result/{service.measured()}")
    for name, words in (
        ("error_motion", "ISO 230-1"),
        ("k", "95 %"),
        ("squareness", "90°"),
    ):
        page.locator(f"[data-term={name}]").click()
        expect(here).to_contain_text(words)
        expect(entries).to_have_count(11)
        page.keyboard.press("Escape")


def test_data_older_than_2_5_s_are_stale_until_some_come_again(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    service.measuring()
    page = panel.open()
    expect(page.locator("#stamp")).to_have_text("Live data")
    expect(page.locator(".readout output").first).to_be_visible()
    fresh = {theme: look_in(page, theme) for theme in ("dark", "light")}
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    begun = time.monotonic()
    expect(page.locator("#stamp")).to_contain_text(re.compile(r"DATA STALE since \d"))
    # The last tick was up to 0.25 s ago.
    assert time.monotonic() - begun > 2.5 - 0.6
    expect(page.locator("#reason")).to_contain_text("No data from the service")
    stale = page.locator(".is-stale-data", has=page.locator(".readout"))
    for theme in ("light", "dark"):
        assert look_in(page, theme) == fresh[theme]
        expect(stale).to_have_attribute("data-age", re.compile(r"^\d+ s old$"))
        assert "gradient" in stale.evaluate("e => getComputedStyle(e).backgroundImage")
    page.evaluate("location.hash = '#/run/job-2'")
    expect(page.locator("#problems")).to_contain_text("The service does not answer")
    page.unroute(JOBS)
    page.evaluate("location.hash = '#/run/job-1'")
    service.silent = False
    expect(page.locator("#stamp")).to_have_text("Live data")
    expect(page.locator(".is-stale-data")).to_have_count(0)
    expect(page.locator("#problems")).to_be_empty()


def look_in(page: Page, theme: Literal["dark", "light"]) -> list[str]:
    page.emulate_media(color_scheme=theme)
    expect(page.locator("html")).to_have_attribute("data-theme", theme)
    return page.wait_for_function(LOOK).json_value()


def test_stale_conditions_bear_their_age(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    service.connected = True
    service.conditions = EXAMPLES["list_conditions"]["items"][:1]
    page = panel.open("#/connect")
    shown = page.locator(".conditions [data-level=true]")
    expect(shown).to_be_visible()
    page.route("**/conditions", lambda route: None)  # answers too late
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    stale = page.locator(".is-stale-data", has=shown)
    expect(stale).to_have_attribute("data-age", re.compile(r"^[3-9] s old$"))


def test_german_words_fit_at_every_size(panel, service):
    job = service.measured()
    page = panel.open("#/plan", language="de")
    for view, shown in {
        "connect": "h1",
        "plan": "#feed",
        f"run/{job}": "h1",
        f"result/{job}": "h1",
        "records": "h1",
        f"export/{job}": "[data-format]",
        f"verify/{job}": "#verify-tolerance",
        f"certificate/{job}": "#state-operator",
        "machine": "[data-card=who]",
    }.items():
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        go(page, f"#/{view}")
        expect(page.locator(shown).first).to_be_visible()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            expect_nothing_too_wide(page)
            assert page.evaluate(STICKING_OUT) == [], (view, width)
            heights = page.locator(".stepper").evaluate_all(HEIGHTS)
            assert all(height < 2 * 64 for height in heights), view
            tops = page.locator(".stepper").evaluate_all(TOPS)
            assert all(number == 1 for number in tops), view
            if view == "plan":
                assert small_targets(page, f"{width} px wide", TOUCH_PX) == []


def test_the_state_stays_clear_of_what_is_beside_it_on_a_german_phone(panel, service):
    job = service.new_job("measure-otf", state="interrupted")["id"]
    page = panel.open(f"#/run/{job}", size=PHONE, language="de")
    state = page.locator("#state")
    expect(state).to_have_text("Unterbrochen")
    own, tools = state.bounding_box(), page.locator(".bar-tools").bounding_box()
    assert own is not None
    assert tools is not None
    assert own["x"] + own["width"] <= tools["x"]
    assert state.evaluate("e => e.scrollWidth <= e.clientWidth")
    widths = page.locator(".tool").evaluate_all("all => all.map((e) => e.offsetWidth)")
    assert min(widths) >= 48


@pytest.mark.fault_row(32)
def test_where_no_events_come_the_page_asks_and_follows(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    job = service.measuring()
    page = panel.open("#/connect", before=NO_EVENTS, hears=False)
    expect(page.locator("#stamp")).to_contain_text("Asked each second")
    go(page, f"#/run/{job}")
    service.advance(job, 11)
    samples = page.locator(".stream .tile", has=page.locator("dt:text-is('Samples')"))
    expect(samples).to_contain_text("30,800")
    service.change(job, state="paused", desired_state="paused")
    expect(page.locator("#state")).to_have_text("Paused")
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")
    page.locator("#abort-close").click()
    expect(page.locator("#state")).to_have_text("Aborted")


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


def test_inch_changes_what_is_shown_and_nothing_else(panel, service):
    job = service.measured()
    page = panel.open(f"#/result/{job}", language="de")
    expect(page.locator("td.right").first).to_have_text("23,4 µrad")
    choose(page, "English")
    residual = page.locator(".tile", has_text="Residual")
    expect(residual).to_contain_text("4.3µm")
    choose(page, "inch")
    expect(residual).to_contain_text("169µin")
    expect(page.locator("[data-symbol=EXX] h3 .unit")).to_have_text("µin")
    expect(page.locator("[data-symbol=EAX] h3 .unit")).to_have_text("µrad")
    go(page, "#/plan")
    units = ["in", "in", "in", "min", "in/min", "µin"]
    expect(page.locator(".suffix")).to_have_text(units)
    prepare(page)
    (order,) = service.orders()
    assert "feed_mm_min" not in order  # left to the planner, as in millimetres


def test_dark_is_dark_and_the_operator_overrules_the_system(panel, service):
    page = panel.open("#/plan")
    assert brightness(page) > 200
    page.emulate_media(color_scheme="dark")
    assert brightness(page) < 60
    choose(page, "Light")
    assert brightness(page) > 200
    choose(page, "Dark")
    page.emulate_media(color_scheme="light")
    page.reload()
    assert brightness(page) < 60
    assert page.locator("html").get_attribute("data-theme") == "dark"
    go(page, f"#/result/{service.measured()}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    assert brightness(page) < 60


def brightness(page: Page) -> float:
    expect(page.locator("main h1")).to_be_visible()
    picture = Image.open(io.BytesIO(page.screenshot())).convert("L")
    return ImageStat.Stat(picture).mean[0]


def expect_nothing_too_wide(page: Page) -> None:
    """No element's words stick out of it, once pictures have the size of the page."""
    page.wait_for_function(
        """(selector) => [...document.querySelectorAll(selector)]
            .filter((e) => e.checkVisibility() && !e.matches(".unseen"))
            .filter((e) => getComputedStyle(e).display !== "inline")
            .every((e) => e.scrollWidth <= e.clientWidth + 1)""",
        arg="body, button, .button, h1, h2, h3, th, dd, .tag, .state",
    )
