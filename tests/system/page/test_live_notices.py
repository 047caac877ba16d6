"""What is noticed while the machine moves is told, and answered, on the page."""

from typing import Any

from playwright.sync_api import expect

from page_steps import choose, held


def notice(**more: Any) -> dict[str, Any]:
    usual = {
        "number": 1,
        "kind": "something-changed",
        "grade": "possible",
        "axis": "",
        "since_row": 14,
        "noticed_row": 14,
        "noticed_s": 83.5,
        "size_um": 10.2,
        "uncertainty_um": 0.6,
        "is_over": False,
        "action": "note",
    }
    return {**usual, **more}


def test_a_notice_is_told_gets_its_name_and_stays_once_it_is_over(panel, service):
    job = service.measuring()
    page = panel.open()
    said = page.locator(".notice")
    for language, first, number, later, grade in (
        ("English", "Something changed", "10.2", "was knocked", "certain"),
        ("Deutsch", "Etwas hat sich geändert", "10,2", "wurde angestoßen", "sicher"),
    ):
        choose(page, language)
        service.change(job, notices=[notice()])
        expect(said).to_contain_text(first)
        expect(said).to_contain_text("14")
        expect(said).to_contain_text(number)
        service.change(job, notices=[notice(kind="set-up-moved", grade="certain")])
        expect(said).to_contain_text(later)
        expect(said).to_contain_text(grade)
        expect(page.locator("#then-check")).to_have_count(0)
    choose(page, "English")
    service.change(job, notices=[notice(kind="line-off", is_over=True)])
    expect(said).to_contain_text("nothing of it any more")


def test_who_is_asked_holds_a_button_and_lines_are_measured_again(panel, service):
    job = service.measuring()
    page = panel.open()
    asked = notice(kind="lost-motion-changed", axis="Y", grade="likely", action="pause")
    service.change(job, state="paused", notices=[asked])
    expect(page.locator(".notice")).to_contain_text("lost motion of Y has changed")
    version = service.jobs[job]["version"]
    with held(page, page.locator("#then-check")):
        expect(page.locator("#state")).to_have_text("Running")
    sent = ("POST", f"/jobs/{job}/resume?then=check", f'"{version}"')
    assert sent in service.requests
    expect(page.locator("#then-check")).to_have_count(0)
