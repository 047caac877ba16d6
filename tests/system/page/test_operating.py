"""What may be asked of a measurement under way and by whom, and what is said of it."""

import re
from contextlib import suppress

import numpy as np
import pytest
from playwright.sync_api import Error, Locator, expect

from page_steps import NEXT, choose, expect_texts, follow, held
from scripted_data import estimate


def failure(code: str, detail: str = "it is so", action: str = "look") -> dict:
    title = "Machine, tracker or link failed"
    return {"code": code, "title": title, "detail": detail, "action": action}


def test_a_held_button_ends_the_measurement_after_its_line(panel, service):
    job = service.measuring()
    page = panel.open()
    cancel = page.locator("#cancel", has_text="Hold to end after this line")
    with held(page, cancel):
        expect(page.locator("#state")).to_have_text("Cancelling")
    assert ("POST", f"/jobs/{job}/cancel", None) in service.requests
    expect(page.locator(".notice.is-held")).to_contain_text("finishes the current line")
    service.change(job, state="cancelled", run_id="run-1")
    said = page.locator(".notice", has_text="ended in order")
    expect(said).to_contain_text("kept under Records")
    expect(page.locator(".notice.is-fault")).to_have_count(0)


def test_an_acknowledged_measurement_leads_back_to_check(panel, service):
    ways = {"verbs": {"acknowledge": "/api/v1/jobs/job-1/acknowledge"}}
    job = service.measuring()
    page = panel.open(language="de")
    expect(page.locator("#state")).to_have_text("Läuft")
    service.change(job, state="faulted", error=failure("cell-died"), links=ways)
    said = page.locator(".notice.is-held")
    expect_texts(said, "Diese Messung kann fortgesetzt werden", "Schlussprüfung")
    follow(page, "Quittieren")
    page.wait_for_url(f"**/#/check/{job}")
    assert ("POST", f"/jobs/{job}/acknowledge", None) in service.requests


def test_control_is_seen_and_taken_before_and_amid_the_motion(panel, service, witness):
    witness.expect("409")
    service.controller = "berta"
    job = service.ready()
    page = panel.open(f"#/check/{job}")
    moves = page.locator(".card", has_text="What will move")
    expect(moves).to_contain_text("berta")
    moves.get_by_role("button", name="Take control").click()
    expect(moves).to_contain_text("10.0 to 490.0 mm")
    service.controller = "berta"
    service.change(job, state="paused", stage="measuring")
    page.wait_for_url(f"**/#/run/{job}")
    with held(page, page.locator("#resume")):
        expect(page.locator("#problems")).to_contain_text("berta has this job")
    page.get_by_role("button", name="Take control").click()
    expect(page.locator("#problems")).to_contain_text("You have control")
    assert ("POST", f"/jobs/{job}/take-control", None) in service.requests
    with held(page, page.locator("#resume")):
        expect(page.locator("#state")).to_have_text("Running")


def test_a_feed_hold_is_no_failure_and_says_who_has_to_act(panel, service):
    fault = failure("held-at-machine", "the feed is held at the machine", "look why")
    job = service.measuring(error=fault)
    service.change(job, state="paused")
    page = panel.open()
    said = page.locator("main .notice.is-held")
    for language, title, way_out in (
        ("English", "Feed hold at the machine", "look why"),
        ("Deutsch", "Vorschub an der Maschine angehalten", "dort freigeben"),
    ):
        choose(page, language)
        expect(said.locator("strong")).to_have_text(title)
        expect(said).to_contain_text(way_out)
        expect(said).not_to_contain_text("failed")
    # Numbers stay beside the translation.
    fault = failure("feed-override", "the feed override is 70 %: feeds are not", "turn")
    service.change(job, error=fault)
    expect(said.locator("strong")).to_contain_text("Vorschub-Override")
    expect(said.locator("[lang=en]")).to_contain_text("70 %")
    # Words of another version stand as they are; once all is well, nothing does.
    error = {"title": "Feed held", "detail": "At the panel", "action": "Cycle start."}
    service.change(job, error=error)
    expect(said).to_contain_text("Cycle start.")
    service.change(job, state="running", error=None)
    expect(page.locator("main .notice")).to_have_count(0)


def test_the_scope_shows_how_far_points_lie_beside_their_line(panel, service):
    job = service.measuring()
    page = panel.open()
    along = np.linspace(0.0, 300.0, 13)[:, None]
    line = np.array([1000.0, 200.0, 50.0]) + along * np.array([0.8, 0.6, 0.0])
    line[6] += [0.0, 0.0, 0.024]  # each other one is drawn aside by some of it
    tiles = page.locator(".stream .tiles.is-now")
    distance = f"{np.linalg.norm(line[6]) / 1e3:.3f} m"
    seen = f"locked.*{distance}.*line"
    air = {"X_degC": 21.5}
    stream_until(
        tiles, rf"{seen}{distance_um(line[:7])} µm", service, job, line[:7], air
    )
    expect(page.locator(".air")).to_have_text("X21.50 °C")
    stream_until(tiles, rf"{seen}–", service, job, line[6:][[0] * 7])


def test_with_a_placed_machine_the_scope_tells_from_the_commanded_line(panel, service):
    job = service.measuring()
    page = panel.open(language="de")
    means = page.locator(".scope-means")
    expect(means).to_contain_text("durch die Punkte dieser Fahrt")
    rows = np.array([[1e3, 2e2, 50.0], [1300.0, 200.0, 50.0], [1300.0, 500.0, 50.0]])
    points = rows[1] + np.linspace(0.1, 0.9, 7)[:, None] * (rows[2] - rows[1])
    points += [0.0, 0.0, 0.0173]  # all of them: no fitted line would tell
    service.advance(job, 5)
    commanded = {"first_row": 4, "tracker_mm": rows.tolist()}
    service.estimate(job, {**estimate(5), "commanded": commanded})
    tiles = page.locator(".stream .tiles.is-now")
    stream_until(tiles, r"17,3 µm", service, job, points)
    expect(means).to_contain_text("von der Sollgeraden")
    elsewhere = points + np.array([40.0, 0.0, 0.0])  # the tracker is set up anew
    stream_until(tiles, r"0,0 µm", service, job, elsewhere)
    expect(means).to_contain_text("durch die Punkte dieser Fahrt")


def stream_until(
    tiles: Locator, shown: str, service, job: str, points, environment=None
) -> None:
    """Tell points again and again: the page forgets them 1.5 s after the last."""
    for beat in range(50):
        service.show_points(job, 5.0 + 2.0 * beat, points, environment=environment)
        try:
            expect(tiles).to_contain_text(re.compile(shown), timeout=400)
        except AssertionError:
            continue
        return
    raise AssertionError(f"never shown: {shown}; last: {tiles.inner_text()}")


def distance_um(points: np.ndarray) -> str:
    centred = points - points.mean(axis=0)
    direction = np.linalg.svd(centred)[2][0]
    across = centred[-1] - (centred[-1] @ direction) * direction
    return f"{1e3 * np.linalg.norm(across):.1f}"


def test_what_the_tracker_has_lost_is_said_and_lines_are_planned_anew(panel, service):
    job = service.measuring()
    page = panel.open(language="de")
    lost = {"samples": 900, "lost_samples": 17, "crc_errors": 3, "gaps": 2}
    service.change(job, health={**lost, "repeats": 1})
    counts = page.locator(".stream .is-counts")
    expect(counts.locator("dd")).to_have_text(["900", "17", "2", "3"])
    expect(counts.locator("[data-tone=fault]")).to_have_count(3)
    expect_texts(page.locator(".notice"), "Verlorene Geraden sind neu", "bis jetzt 1")
    # So is a lost beam, and that it is back.
    service.advance(job, 2.5)
    service.change(job, state="paused", error=failure("beam-lost"))
    beam = page.locator(".stream .tile", has_text="Strahl")
    expect(beam).to_contain_text("verloren")
    expect(beam).to_have_attribute("data-tone", "fault")
    stream_until(beam, "erfasst", service, job, [[1000.0, 200.0, 50.0]])
    expect(page.locator("#state")).to_have_text("Angehalten")


def test_an_old_result_is_looked_at_while_the_machine_moves(panel, service):
    old = service.measured()
    job = service.measuring()
    page = panel.open(f"#/result/{old}")
    expect(page.locator("#state")).to_have_text("Running")
    assert page.locator("body").get_attribute("data-measuring") == job
    expect(page.locator("[data-symbol=EXX] canvas")).to_be_visible()
    service.change(job, state="paused")
    expect(page.locator("#state")).to_have_text("Paused")
    expect(page.locator("[data-symbol=EXX] canvas")).to_be_visible()
    assert page.url.endswith(f"#/result/{old}")


def notice(**more) -> dict:
    usual = {"number": 1, "kind": "something-changed", "grade": "possible", "axis": ""}
    usual |= {"since_row": 14, "noticed_row": 14, "noticed_s": 83.5, "size_um": 10.2}
    usual |= {"uncertainty_um": 0.6, "is_over": False, "action": "note"}
    return {**usual, **more}


def test_a_notice_is_told_gets_a_name_stays_once_it_is_over_and_may_ask(panel, service):
    job = service.measuring()
    page = panel.open()
    said = page.locator(".notice")
    for more, words in (
        ({}, ("Something changed", "14", "10.2")),
        ({"kind": "set-up-moved", "grade": "certain"}, ("has shifted", "certain")),
        ({"kind": "line-off", "is_over": True}, ("nothing of it any more",)),
    ):
        service.change(job, notices=[notice(**more)])
        for text in words:
            expect(said).to_contain_text(text)
        expect(page.locator("#then-check")).to_have_count(0)
    # Who is asked holds a button, and lines are measured again.
    asked = notice(kind="lost-motion-changed", axis="Y", grade="likely", action="pause")
    service.change(job, state="paused", notices=[asked])
    expect(said).to_contain_text("lost motion of Y has changed")
    version = service.jobs[job]["version"]
    with held(page, page.locator("#then-check")):
        expect(page.locator("#state")).to_have_text("Running")
    sent = ("POST", f"/jobs/{job}/resume?then=check", f'"{version}"')
    assert sent in service.requests
    expect(page.locator("#then-check")).to_have_count(0)


@pytest.fixture
def closed(service, witness):
    service.log_in_required = True
    witness.expect("401")
    return service


def log_in(page, name, password="right"):
    page.locator("#user-name").fill(name)
    page.locator("#user-password").fill(password)
    page.locator(".log-in button").click()


def test_who_logs_in_is_named_in_the_bar(panel, closed):
    page = panel.open(language="de", hears=False)
    title = page.locator(".log-in h1")
    expect(title).to_have_text("Anmelden")
    expect(page.locator("#abort")).to_be_visible()
    log_in(page, "operator", "wrong")
    wrong = page.locator(".log-in .field-error")
    expect(wrong).to_contain_text("gehören nicht zusammen")
    log_in(page, "operator")
    expect(page.locator("#user")).to_contain_text("operator ·")
    expect(page.locator(NEXT)).to_be_visible()
    choose(page, "English")
    page.locator("#open-settings").click()
    page.get_by_role("button", name="Log out").click()
    expect(title).to_have_text("Log in")
    assert closed.user is None
    log_in(page, "operator", "wrong")
    expect(wrong).to_contain_text("do not belong together")


def test_a_viewer_is_not_offered_motion_and_nobody_asked_in_vain(panel, closed):
    closed.user = "viewer", "viewer"
    page = panel.open()
    expect(page.locator("#reason")).to_contain_text("A viewer only looks on")
    expect(page.locator("#next button")).to_have_count(0)
    expect(page.locator("#abort")).to_be_visible()
    closed.log_in_required, closed.user = False, None
    page.reload()
    expect(page.locator(NEXT)).to_be_visible()
    expect(page.locator(".log-in")).to_have_count(0)
    expect(page.locator("#user")).to_be_hidden()


def test_after_a_session_only_the_controllers_word_confirms_a_stop(panel, closed):
    closed.user = "operator", "operator"
    closed.new_job("measure-otf", state="running", stage="measuring")
    page = panel.open()
    expect(page.locator("#state")).to_have_text("Running")
    closed.user = None
    page.locator("#abort").click()
    title = page.locator("#abort-title")
    expect(title).to_contain_text("NOT CONFIRMED")
    closed.stopped = "true"
    expect(title).to_have_text("Motion stopped")
    page.locator("#abort-close").click()
    with suppress(Error):  # it turns to the log-in at that very moment
        page.evaluate("document.querySelector('#next button')?.click()")
    expect(page.locator(".log-in h1")).to_be_visible()
    with page.expect_response("**/api/v1/stop") as stopped:
        page.locator("#abort").click()
    assert stopped.value.status == 202
