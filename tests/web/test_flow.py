"""The task from Connect to Result, as an operator does it."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

NEXT = "#next button"
HOLD_S = 1.4
REFUSED = ("the server responded with a status of",)
NO_ANSWER = ("net::ERR_FAILED",)
JOBS = re.compile(r"/api/v1/jobs[/?]")
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


def test_the_task_runs_from_connect_to_result(panel, service):
    page = panel.open()
    follow(page, "Connect devices")
    page.wait_for_url("**/#/plan")
    expect(page.locator("#answered")).to_contain_text("Simulated tracker T-0001")
    page.locator(".step", has_text="Connect").click()
    expect(page.locator("[data-connected]")).to_have_count(2)
    rate = page.locator(".pairs > *", has_text="500 Hz")
    expect(rate).to_be_visible()
    follow(page, "Plan the run")
    follow(page, "Prepare the run")
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_contain_text("preparing the path")
    (job,) = service.jobs
    service.change(job, state="ready")
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    with held(page, page.locator(NEXT, has_text="Hold to start motion")):
        page.wait_for_url(f"**/#/run/{job}")
    expect(page.locator(".big-progress")).to_be_visible()
    service.advance(job, 11.0)
    expect(page.locator(".big-progress strong")).to_have_text("50%")
    expect(page.locator(".stages [aria-current]")).to_have_text("Measuring")
    expect(page.locator(".tile", has_text="Lost samples")).to_contain_text("0")
    expect(page.locator(NEXT)).to_be_disabled()
    service.change(job, stage="estimating")
    expect(page.locator("#state")).to_have_text("Analysing")
    service.finish(job)
    page.wait_for_url(f"**/#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator(".chart-missing")).to_have_count(1)
    expect(page.locator("td.symbol")).to_have_text(["C0Y", "B0Z", "A0Z"])
    expect(page.locator(".key", has_text="k = 2")).to_be_visible()


def test_the_uncertainty_is_told_while_the_machine_moves(panel, service):
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")["id"]
    page = panel.open()
    page.wait_for_url(f"**/#/run/{job}")
    service.advance(job, 11.0)
    service.tell("estimate", {"job_id": job, "volumetric_uncertainty_um": 2.15})
    expect(page.locator("#uncertainty")).to_have_text("U = 4.3 µm (k = 2)")


def test_who_comes_after_the_run_finds_its_result(panel, service):
    job = service.new_job("measure-otf")["id"]
    service.finish(job)
    service.change(job, ended=datetime.now(UTC).isoformat())
    page = panel.open()
    page.wait_for_url(f"**/#/result/{job}")


def test_an_old_result_does_not_stand_in_the_way_of_a_new_run(panel, service):
    job = service.new_job("measure-otf")["id"]
    service.finish(job)
    service.change(job, ended="2026-01-01T00:00:00.000Z")
    page = panel.open()
    page.wait_for_url("**/#/connect")


def test_the_order_carries_what_was_chosen(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.get_by_role("radio", name="At standstill").click()
    expect(page.locator("#feed")).to_be_hidden()
    page.get_by_role("checkbox").click()
    follow(page, "Prepare the run")
    page.wait_for_url("**/#/check/*")
    assert service.requests == [
        (
            "POST",
            "/jobs",
            {"kind": "measure-standstill", "perpendicular_only": True},
        )
    ]


def test_planned_lines_are_driven_and_what_they_will_leave_is_foretold(panel, service):
    service.connected = True
    service.plan["predicted_um"] = 1.15
    page = panel.open("#/plan")
    page.locator("#minutes").fill("2.5")
    follow(page, "Prepare the run")
    page.wait_for_url("**/#/check/*")
    assert service.requests == [
        (
            "POST",
            "/plans",
            {
                "mode": "otf",
                "minutes": 2.5,
                "perpendicular_only": False,
            },
        ),
        (
            "POST",
            "/jobs",
            {"kind": "measure-otf", "perpendicular_only": False, "plan_id": "plan-1"},
        ),
    ]
    service.change(next(iter(service.jobs)), state="ready")
    run = page.locator(".card", has_text="This run")
    expect(run).to_contain_text("U = 2.3 µm (k = 2)")


def test_a_plan_that_cannot_be_says_why_and_makes_no_job(panel, service):
    service.connected = True
    error = {"title": "No", "detail": "the travel is too short", "action": "Slower."}
    service.planned |= {"state": "failed", "error": error}
    page = panel.open("#/plan")
    page.locator("#minutes").fill("1")
    follow(page, "Prepare the run")
    expect(page.locator(".notice", has_text="the travel is too short")).to_be_visible()
    assert not service.jobs


def test_the_feed_goes_up_and_down_in_steps(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    expect(page.locator("#feed")).to_have_value("")
    page.get_by_label("Slower").click(click_count=2)
    follow(page, "Prepare the run")
    page.wait_for_url("**/#/check/*")
    ((_, _, order),) = service.requests
    assert order["feed_mm_min"] == 5500


def test_a_hold_at_the_machine_says_who_has_to_act(panel, service):
    job = measuring(service)
    page = panel.open()
    error = {"title": "Feed held", "detail": "At the panel", "action": "Cycle start."}
    service.change(job, state="paused", error=error)
    expect(page.locator("main .notice.is-held")).to_contain_text("Cycle start.")
    service.change(job, state="running", error=None)
    expect(page.locator("main .notice")).to_have_count(0)


def test_a_feed_out_of_limits_cannot_be_planned(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("#feed").fill("5")
    expect(page.locator("#feed-error")).to_contain_text("From 100 to 20,000 mm/min")
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_have_text("The feed is out of limits.")


def test_motion_starts_only_after_the_button_was_held(panel, service):
    job = ready(service)
    page = panel.open()
    button = page.locator(NEXT, has_text="Hold to start motion")
    expect(button).to_be_enabled()
    button.click()
    assert service.jobs[job]["state"] == "ready"
    with held(page, button):
        page.wait_for_url(f"**/#/run/{job}")
    assert ("POST", f"/jobs/{job}/arm", '"1"') in service.requests


def test_the_hold_works_from_the_keyboard(panel, service):
    job = ready(service)
    page = panel.open()
    button = page.locator(NEXT, has_text="Hold to start motion")
    expect(button).to_be_enabled()
    button.focus()
    page.keyboard.down("Enter")
    page.wait_for_url(f"**/#/run/{job}")
    page.keyboard.up("Enter")


def test_motion_does_not_start_on_stale_data(panel, service, witness):
    witness.expect("net::ERR_FAILED")
    ready(service)
    page = panel.open()
    expect(page.locator(NEXT)).to_be_enabled()
    page.route(re.compile(r"/api/v1/jobs[/?]"), lambda route: route.abort())
    service.silent = True
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_contain_text("No live data")


def test_pause_is_a_touch_and_resume_is_held(panel, service):
    job = measuring(service)
    page = panel.open()
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


def test_a_page_opened_in_mid_run_shows_the_run(panel, service):
    job = measuring(service)
    service.advance(job, 4.5)
    page = panel.open()
    page.wait_for_url(f"**/#/run/{job}")
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    expect(page.locator(".big-progress strong")).to_have_text("18%")
    page.reload()
    expect(page.locator("#state")).to_have_text("Running")
    assert page.url.endswith(f"#/run/{job}")


def test_a_job_begun_elsewhere_comes_onto_the_page(panel, service):
    page = panel.open()
    expect(page.locator("#stamp")).to_have_text("Live data")
    job = measuring(service)
    page.wait_for_url(f"**/#/run/{job}")


def test_the_position_follows_the_machine(panel, service):
    job = measuring(service)
    page = panel.open()
    expect(page.locator("output")).to_have_count(3)
    service.advance(job, 3.0)
    expected = [f"{v:.3f}".replace("-", "−") for v in service.plan["position"][3]]
    expect(page.locator("output")).to_have_text(expected)


def test_an_answer_cut_short_is_not_taken_for_one(panel, service):
    page = panel.open()
    page.route(
        "**/machines/current:connect",
        lambda route: route.fulfill(status=200, body='{"connected": tr'),
    )
    follow(page, "Connect devices")
    expect(page.locator("#problems")).to_contain_text("The service has not answered")


def test_a_pause_that_nobody_answers_is_not_said_to_be_asked_again(
    panel, service, witness
):
    witness.expect(*NO_ANSWER)
    measuring(service)
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    page.route(JOBS, lambda route: route.abort())
    page.locator("#pause").click()
    problem = page.locator("#problems")
    expect(problem).to_contain_text("The service has not answered")
    expect(problem).to_contain_text("The page does not ask a second time.")
    page.unroute(JOBS)
    expect(page.locator("#pause")).to_be_enabled()
    expect(problem).to_contain_text("The service has not answered")


def test_a_service_that_answers_again_is_not_said_to_be_silent(panel, service, witness):
    witness.expect(*NO_ANSWER)
    page = panel.open("#/records")
    expect(page.locator("#stamp")).to_have_text("Live data")
    service.silent = True
    page.route(JOBS, lambda route: route.abort())
    expect(page.locator("#stamp")).to_contain_text("STALE")
    page.evaluate("location.hash = '#/run/job-1'")
    problem = page.locator("#problems")
    expect(problem).to_contain_text("The service does not answer")
    page.unroute(JOBS)
    service.silent = False
    expect(page.locator("#stamp")).to_have_text("Live data")
    expect(problem).to_be_empty()


def test_a_refused_connect_says_what_to_do(panel, service, witness):
    witness.expect(*REFUSED)
    service.refuse_connect = True
    page = panel.open()
    follow(page, "Connect devices")
    problem = page.locator("#problems")
    expect(problem).to_contain_text("Another device answers")
    expect(problem).to_contain_text("Check the cable, then connect again.")
    problem.get_by_role("button").click()
    expect(problem).to_be_empty()
    expect(page.locator(NEXT)).to_be_enabled()


def test_the_last_error_stays_with_the_devices_until_they_answer(
    panel, service, witness
):
    witness.expect(*REFUSED)
    service.refuse_connect = True
    page = panel.open()
    follow(page, "Connect devices")
    card = page.locator("[data-card='last-error']")
    page.locator("#problems").get_by_role("button").click()
    expect(card).to_contain_text("Check the cable, then connect again.")
    service.refuse_connect = False
    follow(page, "Connect devices")
    expect(page.locator("main h1")).not_to_have_text("Connect")
    page.goto(page.url.split("#")[0] + "#/connect")
    expect(page.locator(".device").first).to_contain_text("Connected")
    expect(card).to_be_hidden()


def test_a_fault_of_a_measurement_stays_with_the_devices_until_it_is_taken_away(
    panel, service
):
    page = show_fault(panel, service)
    page.goto(page.url.split("#")[0] + "#/connect")
    card = page.locator("[data-card='last-error']")
    expect(card).to_contain_text("Clear the sight.")
    card.get_by_role("button").click()
    expect(card).to_be_hidden()


def test_a_failed_job_says_why_and_leads_back_to_the_plan(panel, service):
    page = show_fault(panel, service)
    expect(page.locator("main .notice")).to_contain_text("Clear the sight.")
    expect(page.locator(NEXT)).to_have_text("Plan a new run")


@pytest.mark.parametrize(
    ("language", "title", "button"),
    [
        ("en", "Station 2 of 2: set up the tracker", "Hold to start motion"),
        ("de", "Standort 2 von 2: Tracker aufstellen", "Zum Starten halten"),
    ],
)
def test_the_page_asks_for_the_tracker_and_motion_goes_on_once_armed(
    panel, service, language, title, button
):
    service.connected = True
    rows = {key: service.plan[key] for key in ("position", "feed_mm_min", "dwell_s")}
    places = ([1200, 300, -80], [-650, 200, 40])
    service.plan["stations"] = [{"position_mm": p, **rows} for p in places]
    station = {"number": 1, "total": 2, "position_mm": places[0], "checks": []}
    kind = {"kind": "measure-otf", "stage": "measuring", "station": station}
    job = service.new_job(**kind, state="running")["id"]
    page = panel.open(language=language)
    page.wait_for_url(f"**/#/run/{job}")
    text = "the tracker has not been moved"
    check = {"station": 2, "problem": "not-moved", "text": text}
    station = {"number": 2, "total": 2, "position_mm": places[1], "checks": [check]}
    service.change(job, state="awaiting-move", stage="waiting", station=station)
    page.wait_for_url(f"**/#/check/{job}")
    notices = page.locator(".notice")
    expect(notices.filter(has_text=title)).to_contain_text("X −650 mm, Y 200 mm")
    expect(notices.filter(has_text=text)).to_be_visible()
    with held(page, page.locator(NEXT, has_text=button)):
        page.wait_for_url(f"**/#/run/{job}")


def test_stations_that_are_left_can_still_be_measured(panel, service):
    service.connected = True
    station = {"number": 2, "total": 2, "position_mm": [1, 2, 3], "checks": []}
    kind = {"kind": "measure-otf", "station": station}
    job = service.new_job(**kind, state="interrupted", ended="2026-03-14T08:30:00Z")
    page = panel.open(f"#/run/{job['id']}")
    page.locator("#back button", has_text="Measure the stations that are left").click()
    page.wait_for_url("**/#/check/job-2")
    sent = [body for _, path, body in service.requests if path.endswith("/jobs")]
    assert sent[-1] == {"kind": "measure-otf", "continues": job["id"]}


def test_a_discarded_check_leads_back_to_the_plan(panel, service):
    service.connected = True
    job = ready(service)
    page = panel.open()
    page.locator("#back button", has_text="Discard").click()
    page.wait_for_url("**/#/plan")
    expect(page.locator(NEXT, has_text="Prepare the run")).to_be_enabled()
    assert service.jobs[job]["state"] == "aborted"


def test_events_after_the_answer_do_not_lead_a_discarded_check_elsewhere(
    panel, service
):
    service.connected = True
    job = ready(service)
    page = panel.open(before=TURNS_SLOWLY)
    discard = page.locator("#back button", has_text="Discard")
    with service.telling_late():
        discard.click()
        expect(page.locator("#state")).to_have_text("Aborting")
        expect(page.locator("h1")).to_have_text("Plan")
    expect(page.locator("#state")).to_have_text("Aborted")
    expect(page.locator(NEXT, has_text="Prepare the run")).to_be_enabled()
    assert service.jobs[job]["state"] == "aborted"
    assert visited(page) == [f"#/check/{job}", "#/plan"]


def test_events_before_the_answer_do_not_lead_a_discarded_check_elsewhere(
    panel, service
):
    service.connected = True
    job = ready(service)
    page = panel.open(before=TURNS_SLOWLY)
    discard = page.locator("#back button", has_text="Discard")
    with service.answering_late():
        discard.click()
        expect(page.locator("#state")).to_have_text("Aborted")
    expect(page.locator(NEXT, has_text="Prepare the run")).to_be_enabled()
    assert visited(page) == [f"#/check/{job}", "#/plan"]


def test_the_set_up_is_graded_before_anything_moves(panel, service):
    service.connected = True
    ready(service)
    page = panel.open()
    card = page.locator(".card", has_text="Grade of the set-up")
    expect(card).to_contain_text("0.86: usable")
    expect(card).to_contain_text("13.0 µm")
    expect(card).to_contain_text("add a line along Y at the low end of X")
    expect(card).to_contain_text("0.34")


def test_the_path_can_be_taken_away_as_a_program(panel, service, tmp_path: Path):
    service.connected = True
    ready(service)
    page = panel.open()
    with page.expect_download() as download:
        page.get_by_role("link", name="Heidenhain TNC").click()
    assert download.value.suggested_filename == "heidenhain.h"
    download.value.save_as(tmp_path / "path.h")
    assert (tmp_path / "path.h").read_text().startswith("0 BEGIN PGM")


def test_an_uploaded_bundle_is_analysed(panel, service, tmp_path: Path):
    bundle = tmp_path / "recorded.zip"
    bundle.write_bytes(b"PK")
    page = panel.open()
    page.locator("#bundle").set_input_files(bundle)
    page.wait_for_url("**/#/run/*")
    expect(page.locator("h1")).to_have_text("Analysis")
    (job,) = service.jobs
    assert ("POST", "/runs", "recorded.zip") in service.requests
    assert service.jobs[job]["run_id"] == "run-uploaded"
    service.finish(job)
    expect(page.locator(".chart canvas")).to_have_count(17)


def test_records_lead_to_results_and_bundles(panel, service):
    job = measuring(service)
    service.finish(job)
    page = panel.open("#/records")
    bundle = page.get_by_role("link", name="Bundle")
    expect(bundle).to_have_attribute("href", re.compile(r"/api/v1/runs/run-1/bundle$"))
    page.get_by_role("button", name="Result").click()
    page.wait_for_url(f"**/#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)


def test_the_result_can_be_taken_away(panel, service, tmp_path: Path):
    job = measuring(service)
    service.finish(job)
    page = panel.open(f"#/result/{job}")
    with page.expect_download() as download:
        page.get_by_role("link", name="JSON").click()
    download.value.save_as(tmp_path / "result.json")
    content = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert content["schema"] == "result/1"
    report = page.get_by_role("link", name="Report")
    address = re.compile(f"/api/v1/jobs/{job}/result/report.html$")
    expect(report).to_have_attribute("href", address)


def test_trials_are_asked_for_on_the_result_and_told_with_it(panel, service):
    job = measuring(service)
    service.finish(job)
    page = panel.open(f"#/result/{job}")
    page.get_by_role("button", name="Run trials").click()
    page.wait_for_url("**/#/run/*")
    expect(page.locator(".stages li")).to_have_text(
        ["Aligning", "Estimating", "Trials", "Reporting"]
    )
    trying = next(j for j in service.jobs if j != job)
    order = next(body for _, path, body in service.requests[::-1] if path == "/jobs")
    assert order == {"kind": "analyse", "run_id": "run-1", "monte_carlo": {}}
    told = {"trials": 470_000, "settled": True, "agrees": False}
    service.result["monte_carlo"] = {**told, "agreeing": 323, "numbers": 334}
    service.finish(trying)
    page.wait_for_url(f"**/#/result/{trying}")
    card = page.locator(".card", has_text="Uncertainty held against trials")
    expect(card).to_contain_text("470,000 trials validate")
    expect(card).to_contain_text("323 of 334")
    report = card.get_by_role("link", name="Report")
    expect(report).to_have_attribute(
        "href", re.compile(f"/api/v1/jobs/{trying}/result/report.html$")
    )


def test_an_error_table_opens_large_with_its_numbers(panel, service):
    job = measuring(service)
    service.finish(job)
    page = panel.open(f"#/result/{job}")
    page.locator("[data-symbol=EXX]").get_by_role("button").click()
    sheet = page.locator("#detail")
    expect(sheet.locator("canvas")).to_be_visible()
    expect(sheet.locator("tbody tr")).to_have_count(21)
    expect(sheet.locator("th", has_text="U (k = 2), µm")).to_be_visible()
    page.keyboard.press("Escape")
    expect(sheet).to_be_hidden()


def ready(service) -> str:
    return service.new_job("measure-otf", state="ready")["id"]


def measuring(service) -> str:
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")
    return job["id"]


def visited(page: Page) -> list[str]:
    return page.evaluate("window.visited")


def show_fault(panel, service) -> Page:
    """Open the page on a measurement, which then ends with a fault."""
    job = measuring(service)
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    error = {"title": "Beam lost", "detail": "Line 7", "action": "Clear the sight."}
    service.change(job, state="faulted", error=error)
    expect(page.locator("#state")).to_have_text("Fault")
    return page


def follow(page: Page, label: str) -> None:
    """Press the one button that leads on, by its name."""
    page.locator(NEXT, has_text=label).click()


@contextmanager
def held(page: Page, button: Locator) -> Iterator[None]:
    """Keep the button pressed meanwhile; it takes no effect before 1.5 s are over."""
    expect(button).to_be_enabled()
    box = button.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 40, box["y"] + box["height"] / 2)
    page.mouse.down()
    begun = time.monotonic()
    yield
    assert time.monotonic() - begun > HOLD_S
    page.mouse.up()


def test_the_hold_waits_until_the_safety_text_was_in_sight(panel, service):
    service.connected = True
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}", size=(390, 420))
    expect(page.locator("#reason")).to_contain_text("Before you start")
    expect(page.locator(NEXT)).to_be_disabled()
    for text in page.locator(".before li").all():
        text.evaluate("item => item.scrollIntoView({ block: 'center' })")
        page.wait_for_timeout(100)
    expect(page.locator(NEXT)).to_be_enabled()


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
@pytest.mark.parametrize("language", ["en", "de"])
def test_the_safety_text_is_in_sight_at_once_on_a_panel(panel, service, size, language):
    service.connected = True
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}", size=size, language=language)
    expect(page.locator(NEXT)).to_be_enabled()


def test_what_will_move_is_shown_before_the_hold(panel, service):
    service.connected = True
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}", language="de")
    moves = page.locator(".card", has_text="Was sich bewegen wird")
    expect(moves).to_contain_text("12,5 bis 487,5 mm")
    expect(moves).to_contain_text("6.000 mm/min")
    expect(moves).to_contain_text("2:05 min")


def test_who_has_no_control_takes_it_before_the_hold(panel, service, witness):
    witness.expect("409")
    service.controller, service.connected = "berta", True
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}")
    moves = page.locator(".card", has_text="What will move")
    expect(moves).to_contain_text("berta")
    moves.get_by_role("button", name="Take control").click()
    expect(moves).to_contain_text("12.5 to 487.5 mm")


DOOR = {
    "type": "controller-able",
    "level": "false",
    "reason": "door",
    "message": "a door is open; close it",
    "is_required": True,
    "since": "2026-01-01T10:00:00.000Z",
}
SHUT = DOOR | {"level": "true", "reason": "", "message": ""}


@pytest.mark.parametrize(
    ("language", "words"), [("en", "A door is open"), ("de", "Eine Tür ist offen")]
)
def test_motion_cannot_be_started_while_a_condition_is_known_to_be_wrong(
    panel, service, language, words
):
    service.connected, service.conditions = True, [DOOR]
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}", language=language)
    row = page.locator('[data-type="controller-able"]')
    expect(row).to_have_attribute("data-level", "false")
    expect(row).to_contain_text(words)
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_contain_text(words)
    service.conditions = [SHUT]
    expect(page.locator(NEXT)).to_be_enabled()
    expect(row).to_have_attribute("data-level", "true")


@pytest.mark.fault_row(43)
@pytest.mark.parametrize("language", ["en", "de"])
def test_the_ways_to_read_a_sensor_are_shown_with_the_likely_one(
    panel, service, language
):
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
    page = panel.open("#/connect", language=language)
    card = page.locator("[data-card=sensors]")
    set_, likely = {
        "en": ("0.06 · as set · unlikely", "20.53 · likely"),
        "de": ("0,06 · wie eingestellt · unwahrscheinlich", "20,53 · wahrscheinlich"),
    }[language]
    for words in (refused, 'word_order = "little"', set_, likely):
        expect(card).to_contain_text(words)


WARM = {
    "type": "temperature-steady",
    "level": "false",
    "reason": "temperature-drifts",
    "message": "X has changed by 1.4 °C in 10 min; let it warm up",
    "is_required": False,
    "since": "2026-01-01T10:00:00.000Z",
    "temperatures": [
        {"channel": "X_degC", "value_degC": 22.4, "change_degC": 1.4, "over_s": 600.0}
    ],
}
OFF = SHUT | {"type": "compensation-as-asked", "reason": "compensation-off"}


def test_a_change_of_a_condition_is_shown_by_its_event(panel, service):
    """What is asked for still says the door is open: only the event tells."""
    service.connected, service.conditions = True, [SHUT, OFF]
    job = service.new_job("measure-otf")["id"]
    service.change(job, state="ready")
    page = panel.open(f"#/check/{job}")
    row = page.locator('[data-type="controller-able"]')
    expect(row).to_have_attribute("data-level", "true")
    expect(page.locator('[data-type="compensation-as-asked"]')).to_contain_text(
        "It is off."
    )
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
    page.wait_for_function("window.levels.includes('false')")


@pytest.mark.parametrize(
    ("language", "step", "words"),
    [
        ("en", "plan", "X 22.4 °C, changed by 1.4 °C in 10 min"),
        ("de", "connect", "X 22,4 °C, geändert um 1,4 °C in 10 min"),
    ],
)
def test_temperatures_and_warm_up_are_shown_before_a_run(
    panel, service, language, step, words
):
    service.connected, service.conditions = True, [WARM]
    page = panel.open(f"#/{step}", language=language)
    row = page.locator('[data-type="temperature-steady"]')
    expect(row).to_have_attribute("data-level", "told")
    expect(row).to_contain_text(words)


@pytest.mark.parametrize(
    ("level", "name"),
    [
        ("true", "Temperatures are steady"),
        ("false", "Temperatures are steady: not met"),
        ("unknown", "Temperatures are steady: not known"),
    ],
)
def test_a_condition_is_not_named_as_met_before_it_is(panel, service, level, name):
    service.connected, service.conditions = True, [WARM | {"level": level}]
    page = panel.open("#/plan")
    row = page.locator('[data-type="temperature-steady"] b')
    expect(row).to_have_text(name)


def test_plan_says_nothing_of_temperatures_where_no_thermometer_does(panel, service):
    service.connected = True
    service.conditions = [WARM | {"level": "unknown", "temperatures": []}]
    page = panel.open("#/plan")
    expect(page.locator("h1")).to_be_visible()
    expect(page.get_by_text("Temperatures before the measurement")).to_be_hidden()
