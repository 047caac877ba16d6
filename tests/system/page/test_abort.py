"""ABORT: always there, one touch, whatever else of the page has failed."""

import itertools

import pytest
from playwright.sync_api import Page, expect

from page_steps import choose
from scripted_service import ScriptedService

NO_STREAM = ("net::ERR_FAILED", "Failed to load resource")


def test_abort_is_72_px_and_in_sight(panel):
    page = panel.open()
    expect(page.locator("h1")).to_be_visible()
    for language in ("English", "Deutsch"):
        choose(page, language)
        for width, height in [(1280, 800), (1920, 1080), (390, 844), (800, 1280)]:
            page.set_viewport_size({"width": width, "height": height})
            page.mouse.wheel(0, 5000)
            box = page.locator("#abort").bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) >= 72
            assert box["x"] >= 0
            assert box["y"] >= 0
            assert box["x"] + box["width"] <= width
            assert box["x"] + box["width"] >= width - 16
            assert box["y"] <= 16


def touch(page: Page) -> None:
    page.locator("#abort").click()


def touch_without_modules(page: Page) -> None:
    page.route("**/js/main.js", lambda route: route.abort())
    page.reload()
    touch(page)


def touch_over_a_sheet(page: Page) -> None:
    page.locator("#open-settings").click()
    expect(page.locator("#settings")).to_be_visible()
    touch(page)


def press_a_key(page: Page) -> None:
    page.locator("#abort").press("Enter")


@pytest.mark.parametrize(
    "order", [touch, touch_without_modules, touch_over_a_sheet, press_a_key]
)
def test_abort_stops_a_running_job(panel, service, witness, order):
    witness.expect(*NO_STREAM)
    job = service.measuring()
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    order(page)
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")
    assert service.jobs[job]["state"] == "aborted"
    if order is touch:
        page.locator("#abort-close").click()
        expect(page.locator("#abort-sheet")).to_be_hidden()
        expect(page.locator("#state")).to_have_text("Aborted")


def test_the_release_of_a_long_press_is_no_second_order(panel, service):
    service.measuring()
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    page.locator("#abort").hover()
    page.mouse.down()
    title = page.locator("#abort-title")
    expect(title).to_have_text("Motion stopped")
    page.mouse.up()
    page.locator("#abort-close").focus()  # the release has been taken by now
    expect(title).to_have_text("Motion stopped")
    assert service.stops == 1
    page.locator("#abort-close").click()
    # A key is an order even while a button of the mouse is down.
    page.locator("#abort").hover()
    with page.expect_response("**/api/v1/stop"):
        page.mouse.down()
    expect(title).to_have_text("No job was running")
    page.locator("#abort").focus()
    with page.expect_response("**/api/v1/stop"):
        page.keyboard.press("Enter")
    page.mouse.up()
    assert service.stops == 3


def test_a_tap_is_one_stop_though_its_click_comes_after_confirmation(panel, service):
    page = panel.open(touch=True)
    page.evaluate(
        """() => { window.clicked = new Promise((done) => {
          const button = document.querySelector("#abort");
          button.addEventListener("click", () => setTimeout(done));
        }); }"""
    )
    box = page.locator("#abort").bounding_box()
    at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    finger = page.context.new_cdp_session(page)
    finger.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [at]})
    title = page.locator("#abort-title")
    expect(title).to_have_text("No job was running")
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.evaluate("window.clicked")
    expect(title).to_have_text("No job was running")
    assert service.stops == 1


def test_abort_without_a_job_does_not_say_an_unheard_machine_stands(panel, service):
    service.new_job("measure-otf", state="interrupted")
    page = panel.open()
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("No job was running")
    expect(page.locator("#abort-text")).to_contain_text("Look at the machine")
    service.stopped = "true"
    page.locator("#abort-close").click()
    page.locator("#abort").click()
    expect(page.locator("#abort-title")).to_have_text("Nothing was moving")
    assert service.stops == 2


def test_a_service_that_ended_during_an_abort_has_confirmed_no_stop(panel, service):
    service.deaf_to_stop = True
    job = service.measuring()
    page = panel.open(clock=True)
    expect(page.locator("#state")).to_have_text("Running")

    def interrupt(route):
        service.change(job, state="interrupted")
        route.continue_()

    page.route("**/api/v1/stop", interrupt)
    wait_unconfirmed(page, service)
    service.stopped = "true"
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")


@pytest.mark.parametrize(("kind", "newer"), [("measure-otf", 0), ("verify", 55)])
def test_an_unconfirmed_stop_sends_operators_to_hardware(panel, service, kind, newer):
    service.deaf_to_stop = True
    service.measuring(kind=kind)
    for _ in range(newer):
        service.finish(service.new_job("analyse")["id"])
    page = panel.open("#/connect", clock=True)
    wait_unconfirmed(page, service)
    box = page.locator("#abort-sheet").bounding_box()
    assert box == {"x": 0, "y": 0, "width": 1280, "height": 800}
    service.deaf_to_stop = False
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")


def test_an_answer_that_lists_no_jobs_does_not_look_like_a_stop(panel, service):
    service.measuring()
    page = panel.open(clock=True)
    bodies = itertools.cycle(['{"items": [', "<html>", "{}", "null"])
    page.route(
        "**/api/v1/jobs?*state=*", lambda route: route.fulfill(body=next(bodies))
    )
    wait_unconfirmed(page, service)
    page.unroute("**/api/v1/jobs?*state=*")
    expect(page.locator("#abort-title")).to_have_text("Motion stopped")


def test_a_dead_service_does_not_look_like_a_stop(panel, service, witness):
    witness.expect(*NO_STREAM)
    service.measuring()
    page = panel.open(clock=True)
    expect(page.locator("#state")).to_have_text("Running")
    page.route("**/api/v1/**", lambda route: route.abort())
    page.clock.install()
    page.locator("#abort").click()
    page.clock.run_for(6000)
    expect(page.locator("#abort-title")).to_contain_text("HARDWARE E-STOP")
    page.locator("#abort-close", has_text="The machine is at rest").click()
    expect(page.locator("#abort-sheet")).to_be_hidden()


def wait_unconfirmed(page: Page, service: ScriptedService) -> None:
    """Abort; in 6 s of the page's clock the stop is sent three times, in vain.

    The clock stands while browser and service work, however long that takes.
    """
    page.clock.install(time=0)
    page.clock.pause_at(1000)
    with page.expect_response("**/api/v1/stop"):
        page.locator("#abort").click()
    while page.locator("#abort-sheet").get_attribute("data-stage") == "sending":
        page.clock.run_for(50)
    expect(page.locator("#abort-title")).to_have_text("Stopping …")
    for sent in (1, 2, 3):
        while service.stops < sent:
            page.wait_for_timeout(10)
        page.clock.run_for(2000)
    page.clock.resume()
    expect(page.locator("#abort-title")).to_have_text(
        "NOT CONFIRMED – USE THE HARDWARE E-STOP"
    )
