"""The task from Connect to Result, as an operator does it."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.sync_api import expect

from page_steps import DESK, NEXT, PHONE, choose, expect_texts, follow, go, held
from scripted_data import EXAMPLES

SHORT_PX = 420
NO_ANSWER = ("net::ERR_FAILED",)
JOBS = re.compile(r"/api/v1/jobs[/?]")
DROP = """(where) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File(["PK"], "recorded.zip", { type: "application/zip" }));
  for (const kind of ["dragover", "drop"])
    if (document.querySelector(where).dispatchEvent(
      new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true })))
      throw new Error(`the browser opens the file at ${kind}`);
}"""
# As in a busy browser: states are drawn between a new address and its view.
TURNS_SLOWLY = """
window.visited = [];
addEventListener("hashchange", (event) => {
  if (!event.isTrusted) return;
  event.stopImmediatePropagation();
  window.visited.push(location.hash);
  setTimeout(() => dispatchEvent(new HashChangeEvent("hashchange")), 400);
});
"""


def test_who_comes_soon_after_the_run_finds_its_result(panel, service):
    job = service.measured()
    service.change(job, ended="2026-01-01T00:00:00.000Z")
    page = panel.open()
    page.wait_for_url("**/#/connect")
    service.change(job, ended=datetime.now(UTC).isoformat())
    page.goto(panel.address)
    page.wait_for_url(f"**/#/result/{job}")


def test_live_data_start_motion_and_only_a_held_button_resumes(panel, service, witness):
    witness.expect(*NO_ANSWER)
    job = service.ready()
    page = panel.open()
    button = page.locator(NEXT, has_text="Hold to start motion")
    expect(button).to_be_enabled()
    page.route(JOBS, lambda route: route.abort())
    service.silent = True
    expect(button).to_be_disabled()
    expect(page.locator("#reason")).to_contain_text("No live data")
    page.unroute(JOBS)
    service.silent = False
    expect(button).to_be_enabled()
    button.click()
    assert service.jobs[job]["state"] == "ready"
    with held(page, button):
        page.wait_for_url(f"**/#/run/{job}")
    assert ("POST", f"/jobs/{job}/arm", '"1"') in service.requests
    expect(page.locator("#resume")).to_be_disabled()
    page.locator("#pause").click()
    expect(page.locator("#state")).to_have_text("Paused")
    expect(page.locator("#pause")).to_be_disabled()
    version = service.jobs[job]["version"]
    page.locator("#resume").click()
    assert service.jobs[job]["state"] == "paused"
    with held(page, page.locator("#resume")):
        expect(page.locator("#state")).to_have_text("Running")
    assert ("POST", f"/jobs/{job}/resume", f'"{version}"') in service.requests


def test_a_job_begun_elsewhere_comes_onto_the_page(panel, service):
    page = panel.open()
    expect(page.locator("#stamp")).to_have_text("Live data")
    job = service.measuring()
    page.wait_for_url(f"**/#/run/{job}")
    expect(page.locator("output")).to_have_count(3)
    service.advance(job, 3.0)
    expected = [f"{v:.3f}".replace("-", "−") for v in service.plan["position"][3]]
    expect(page.locator("output")).to_have_text(expected)
    service.tell("estimate", {"job_id": job, "volumetric_uncertainty_um": 2.15})
    expect(page.locator("#uncertainty")).to_have_text("U = 4.3 µm (k = 2)")
    service.advance(job, 4.5)
    page.reload()
    expect(page.locator("#state")).to_have_text("Running")
    assert page.url.endswith(f"#/run/{job}")
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    expect(page.locator(".big-progress strong")).to_have_text("18%")


def test_a_refused_connect_says_what_to_do_and_stays(panel, service, witness):
    witness.expect("the server responded with a status of")
    page = panel.open()
    problem = page.locator("#problems")
    connect = "**/machines/current:connect"
    cut_short = '{"connected": tr'
    page.route(connect, lambda route: route.fulfill(status=200, body=cut_short))
    follow(page, "Connect devices")
    expect(problem).to_contain_text("The service has not answered")
    page.unroute(connect)
    service.refuse_connect = True
    follow(page, "Connect devices")
    expect(problem).to_contain_text("Another device answers")
    expect(problem).to_contain_text("Check the cable, then connect again.")
    problem.get_by_role("button").click()
    expect(problem).to_be_empty()
    expect(page.locator(NEXT)).to_be_enabled()
    card = page.locator("[data-card='last-error']")
    expect(card).to_contain_text("Check the cable, then connect again.")
    service.refuse_connect = False
    follow(page, "Connect devices")
    expect(page.locator("main h1")).not_to_have_text("Connect")
    go(page, "#/connect")
    expect(page.locator(".device").first).to_contain_text("Connected")
    expect(card).to_be_hidden()


def test_a_pause_nobody_answers_is_not_said_to_be_asked_again(panel, service, witness):
    witness.expect(*NO_ANSWER)
    service.measuring()
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    page.route(JOBS, lambda route: route.abort())
    page.locator("#pause").click()
    problem = page.locator("#problems")
    expect(problem).to_contain_text("The service has not answered")
    expect(problem).to_contain_text("The page does not repeat it.")
    page.unroute(JOBS)
    expect(page.locator("#pause")).to_be_enabled()
    expect(problem).to_contain_text("The service has not answered")


def test_a_fault_says_why_and_stays_until_it_is_taken_away(panel, service):
    job = service.measuring()
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    error = {"title": "Beam lost", "detail": "Line 7", "action": "Clear the sight."}
    service.change(job, state="faulted", error=error)
    expect(page.locator("#state")).to_have_text("Fault")
    expect(page.locator("main .notice")).to_contain_text("Clear the sight.")
    expect(page.locator(NEXT)).to_have_text("Plan a new run")
    go(page, "#/connect")
    card = page.locator("[data-card='last-error']")
    expect(card).to_contain_text("Clear the sight.")
    card.get_by_role("button").click()
    expect(card).to_be_hidden()


def test_the_page_asks_for_the_tracker_and_motion_goes_on_once_armed(panel, service):
    rows = {key: service.plan[key] for key in ("position", "feed_mm_min", "dwell_s")}
    places = ([1200, 300, -80], [-650, 200, 40])
    service.plan["stations"] = [{"position_mm": p, **rows} for p in places]
    station = {"number": 1, "total": 2, "position_mm": places[0], "checks": []}
    job = service.measuring(station=station)
    page = panel.open()
    page.wait_for_url(f"**/#/run/{job}")
    text = "the tracker has not been moved"
    check = {"station": 2, "problem": "not-moved", "text": text}
    station = {"number": 2, "total": 2, "position_mm": places[1], "checks": [check]}
    service.change(job, state="awaiting-move", stage="waiting", station=station)
    page.wait_for_url(f"**/#/check/{job}")
    asked = page.locator(".notice", has_text="Station 2 of 2: set up the tracker")
    expect(asked).to_contain_text("X −650 mm, Y 200 mm")
    expect(page.locator(".notice", has_text=text)).to_be_visible()
    with held(page, page.locator(NEXT, has_text="Hold to start motion")):
        page.wait_for_url(f"**/#/run/{job}")


def test_stations_that_are_left_can_still_be_measured(panel, service):
    service.connected = True
    station = {"number": 2, "total": 2, "position_mm": [1, 2, 3], "checks": []}
    kind = {"kind": "measure-otf", "station": station}
    job = service.new_job(**kind, state="interrupted", ended="2026-03-14T08:30:00Z")
    page = panel.open(f"#/run/{job['id']}")
    page.locator("#back button", has_text="Measure the stations that are left").click()
    page.wait_for_url("**/#/check/job-2")
    assert service.orders() == [{"kind": "measure-otf", "continues": job["id"]}]


@pytest.mark.parametrize("late", ["telling_late", "answering_late"])
def test_events_round_an_answer_lead_no_discarded_check_elsewhere(panel, service, late):
    job = service.ready()
    page = panel.open(before=TURNS_SLOWLY)
    shown = {"telling_late": "Aborting", "answering_late": "Aborted"}[late]
    with getattr(service, late)():
        page.locator("#back button", has_text="Discard").click()
        expect(page.locator("#state")).to_have_text(shown)
        if late == "telling_late":
            expect(page.locator("h1")).to_have_text("Plan")
    expect(page.locator("#state")).to_have_text("Aborted")
    expect(page.locator(NEXT, has_text="Prepare the run")).to_be_enabled()
    assert service.jobs[job]["state"] == "aborted"
    assert page.evaluate("window.visited") == [f"#/check/{job}", "#/plan"]


def test_the_check_says_what_will_move_and_how_well(panel, service, tmp_path: Path):
    service.ready()
    page = panel.open()
    card = page.locator("[data-fold=grade]")
    expect_texts(
        card, "1.47: poor", "22.6 µm", "add a line along Y at the high end of X", "0.84"
    )
    with page.expect_download() as download:
        page.get_by_role("link", name="Heidenhain TNC").click()
    assert download.value.suggested_filename == "heidenhain.h"
    download.value.save_as(tmp_path / "path.h")
    assert (tmp_path / "path.h").read_text().startswith("0 BEGIN PGM")
    choose(page, "Deutsch")
    moves = page.locator(".card", has_text="Was sich bewegen wird")
    expect_texts(moves, "10,0 bis 490,0 mm", "6.000 mm/min", "2:11 min")


def test_a_bundle_that_is_dropped_or_chosen_is_analysed(panel, service, tmp_path: Path):
    bundle = tmp_path / "recorded.zip"
    bundle.write_bytes(b"PK")
    page = panel.open()
    page.evaluate(DROP, "body")  # one that misses its zone changes nothing
    zone = page.locator(".drop")
    expect(zone).to_be_visible()
    for number, send in enumerate(
        (
            lambda: page.evaluate(DROP, ".drop"),
            lambda: page.locator("#bundle").set_input_files(bundle),
        ),
        start=1,
    ):
        send()
        page.wait_for_url(f"**/#/run/job-{number}")
        expect(page.locator("h1")).to_have_text("Analysis")
        assert service.requests[-2] == ("POST", "/runs", "recorded.zip")
        assert service.jobs[f"job-{number}"]["run_id"] == "run-uploaded"
        service.finish(f"job-{number}")
        expect(page.locator(".chart canvas")).to_have_count(17)
        go(page, "#/connect")
        expect(zone).to_be_visible()


def test_records_lead_to_results_and_bundles(panel, service, tmp_path: Path):
    job = service.measured()
    page = panel.open("#/records")
    bundle = page.get_by_role("link", name="Bundle")
    expect(bundle).to_have_attribute("href", re.compile(r"/api/v1/runs/run-1/bundle$"))
    page.get_by_role("button", name="Result").click()
    page.wait_for_url(f"**/#/result/{job}")
    drawn = page.locator(".chart canvas")
    expect(drawn).to_have_count(17)
    with page.expect_download() as download:
        page.get_by_role("link", name="JSON").click()
    download.value.save_as(tmp_path / "result.json")
    content = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert content["schema"] == "result/1"
    report = page.get_by_role("link", name="Report")
    address = re.compile(f"/api/v1/jobs/{job}/result/report.html$")
    expect(report).to_have_attribute("href", address)
    # A machine without backlash has one line a table; all of them have one scale.
    expect(page.locator(".key .is-up")).to_have_count(0)
    picture = "document.querySelector('[data-symbol=EYX] canvas').toDataURL()"
    before = page.evaluate(picture)
    page.get_by_role("button", name="Own scale").click()
    expect(drawn).to_have_count(17)
    assert page.evaluate(picture) != before
    page.locator("[data-symbol=EXX]").get_by_role("button").click()
    sheet = page.locator("#detail")
    expect(sheet.locator("canvas")).to_be_visible()
    expect(sheet.locator("tbody tr")).to_have_count(21)
    expect(sheet.locator("th", has_text="U (k = 2), µm")).to_be_visible()
    page.keyboard.press("Escape")
    expect(sheet).to_be_hidden()


def test_known_lengths_are_sent_after_a_run_and_its_row_tells(panel, service, witness):
    witness.expect("422")
    service.measured()
    page = panel.open("#/records")
    row = page.get_by_role("row").filter(has=page.get_by_role("link", name="Bundle"))

    def send(content):
        file = {"name": "bar.csv", "mimeType": "text/csv", "buffer": content}
        row.locator("input[type=file]").set_input_files(file)

    send(b"nonsense\n")
    expect(page.get_by_text("row 2, column u_mm")).to_be_visible()
    send(b"x1_mm,y1_mm\n1,2\n3,4\n")
    expect(row.get_by_role("button", name="Known lengths: 2")).to_be_visible()
    assert service.requests[-1] == ("PUT", "/runs/run-1/known-lengths", "bar.csv")


def test_trials_are_asked_for_on_the_result_and_told_with_it(panel, service):
    job = service.measured()
    page = panel.open(f"#/result/{job}")
    page.get_by_role("button", name="Run trials").click()
    page.wait_for_url("**/#/run/*")
    expect(page.locator(".stages li")).to_have_text(
        ["Aligning", "Estimating", "Trials", "Reporting"]
    )
    trying = next(j for j in service.jobs if j != job)
    order = {"kind": "analyse", "run_id": "run-1", "monte_carlo": {}}
    assert service.orders()[-1] == order
    told = {"trials": 470_000, "settled": True, "agrees": False}
    service.result["monte_carlo"] = {**told, "agreeing": 323, "numbers": 334}
    service.finish(trying)
    page.wait_for_url(f"**/#/result/{trying}")
    card = page.locator(".card", has_text="Check of the uncertainty")
    expect_texts(card, "470,000 trials validate", "323 of 334")
    report = card.get_by_role("link", name="Report")
    expect(report).to_have_attribute(
        "href", re.compile(f"/api/v1/jobs/{trying}/result/report.html$")
    )


def test_the_hold_waits_until_the_safety_text_was_in_sight(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    for language, hold, first in (
        ("English", "Hold to start", "Before you start"),
        ("Deutsch", "Zum Starten", "Vor dem Start"),
    ):
        choose(page, language)
        for width, height in (DESK, PHONE, (390, SHORT_PX)):
            page.set_viewport_size({"width": width, "height": height})
            job = service.ready()
            go(page, f"#/check/{job}")
            button = page.locator(NEXT, has_text=hold)
            if height == SHORT_PX:
                expect(button).to_be_disabled()
                expect(page.locator("#reason")).to_contain_text(first)
                for text in page.locator(".before li").all():
                    text.evaluate("item => item.scrollIntoView({ block: 'center' })")
                    page.wait_for_timeout(100)
            expect(button).to_be_enabled()
            service.change(job, state="aborted")
            page.wait_for_url(f"**/#/run/{job}")


SHUT = EXAMPLES["list_machine_conditions"]["items"][-1]
WORDS = {"reason": "door", "message": "a door is open; close it"}
DOOR = SHUT | WORDS | {"level": "false"}


OFF = SHUT | {"type": "compensation-as-asked", "reason": "compensation-off"}


def test_motion_waits_for_wrong_conditions_and_an_event_shows_a_change(panel, service):
    service.conditions = [DOOR]
    job = service.ready()
    page = panel.open(f"#/check/{job}")
    row = page.locator('[data-type="controller-able"]')
    expect(row).to_have_attribute("data-level", "false")
    expect(page.locator(NEXT)).to_be_disabled()
    for language, words in (("English", "A door is"), ("Deutsch", "Eine Tür ist")):
        choose(page, language)
        expect(row).to_contain_text(words)
        expect(page.locator("#reason")).to_contain_text(words)
    choose(page, "English")
    service.conditions = [SHUT, OFF]
    expect(page.locator(NEXT)).to_be_enabled()
    expect(row).to_have_attribute("data-level", "true")
    expect(page.locator('[data-type="compensation-as-asked"]')).to_contain_text(
        "It is off."
    )
    # What is asked for still says the door is shut: only the event tells.
    page.evaluate(
        """() => {
          const row = document.querySelector('[data-type="controller-able"]');
          window.levels = [row.dataset.level];
          new MutationObserver(() => {
            const now = document.querySelector('[data-type="controller-able"]');
            if (now) window.levels.push(now.dataset.level);
          }).observe(document.body, { childList: true, subtree: true });
        }"""
    )
    service.tell("condition", {"machine": "another", **DOOR})
    service.tell("condition", {"machine": "default", **OFF, "reason": "other"})
    service.tell("condition", {"machine": "default", **DOOR})
    page.wait_for_function("() => window.levels.includes('false')")


def test_devices_that_another_panel_connects_are_shown_without_a_reload(panel, service):
    page = panel.open("#/connect")
    expect(page.locator(NEXT, has_text="Connect devices")).to_be_enabled()
    service.connected = True
    told = SHUT | {"type": "devices-connected", "machine": "default"}
    service.tell("condition", told)
    expect(page.locator(NEXT, has_text="Plan the run")).to_be_enabled()
    expect(page.locator(".device[data-connected]").first).to_be_visible()


@pytest.mark.fault_row(43)
def test_the_ways_to_read_a_sensor_are_shown_with_the_likely_one(panel, service):
    ways = [
        {"how": 'address = 12, word_order = "big"', "value": 0.06, "is_set": True},
        {"how": 'address = 12, word_order = "little"', "value": 20.53},
        {"how": 'address = 11, word_order = "big"', "value": None},
    ]
    sensors = [
        {"channel": "X_degC", "is_set": False, "is_likely": way["value"] == 20.53} | way
        for way in ways
    ]
    refused = "X_degC: its words are in the other order"
    told = {"sensors": sensors, "sensors_refused": refused}
    service.machine = service.machine | told
    service.connected = True
    page = panel.open("#/connect")
    card = page.locator("[data-card=sensors]")
    told = (refused, "word order little", "0.06 · as set · unlikely")
    expect_texts(card, *told, "20.53 · likely")
