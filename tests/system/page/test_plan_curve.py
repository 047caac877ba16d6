"""What time buys: one curve with a handle, and everything that follows it."""

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from page_steps import SLOW_MS, go, prepare
from scripted_data import made_plan, plan_curve, planned_path
from scripted_service import ScriptedService

POINTS = plan_curve()["points"]


def show(
    panel, service: ScriptedService, predicted=None, **more
) -> tuple[Page, Locator]:
    service.connected = True
    service.planned = made_plan(predicted)
    page = panel.open("#/plan", **more)
    card = page.locator("[data-card=curve]")
    expect(card.locator(".handle")).to_be_visible()
    return page, card


def plans(service: ScriptedService) -> list:
    return [order["minutes"] for order in service.orders("/plans")]


def driven(service: ScriptedService) -> dict:
    """Return what the newest job says of a plan."""
    job = service.orders()[-1]
    return {name: job[name] for name in ("plan_id", "plan_rows") if name in job}


def test_everything_follows_the_handle_by_keys_without_another_plan(panel, service):
    _, card = show(panel, service)
    handle = card.get_by_role("slider", name="Time and uncertainty")
    expect(handle).to_have_attribute("aria-valuetext", "1:55 min, U 1.04 µm")
    expect(card).to_contain_text("0.07: good")
    expect(card).to_contain_text("EXX (Positioning of X), U 1.00 µm")
    handle.press("Home")
    expect(handle).to_have_attribute("aria-valuetext", "0:15 min, U 8.00 µm")
    expect(card).to_contain_text("0.50: usable")
    expect(card).to_contain_text("ECX (Tilt of X about Z), U 1.00 µm")
    handle.press("ArrowRight")
    expect(handle).to_have_attribute("aria-valuenow", "2")
    assert plans(service) == [3]


def test_what_of_it_is_the_trackers_and_what_takes_that_away_is_said(panel, service):
    remedies = [
        {
            "change": change,
            "turn_deg": turn_deg,
            "expanded_volumetric_uncertainty_um": u_um,
            "position_mm": [700, -900, 50],
            "minutes": 12,
        }
        for change, turn_deg, u_um in (
            ("second-place", 0, 1.5),
            ("turned-base", 90, 1.7),
        )
    ]
    errors = {"random_um": 0.6, "remedies": remedies}
    predicted = {"expanded_volumetric_uncertainty_um": 2.4, "tracker_errors": errors}
    page, _ = show(panel, service, predicted)
    card = page.locator(".card", has_text="Errors of the tracker itself").last
    for text in (
        "with a perfect tracker it would be 1.20 µm",
        "The same again from X 700",
        "U = 1.50 µm, 12 min more",
        "base turned by 90°",
        "U = 1.70 µm, 12 min more",
    ):
        expect(card).to_contain_text(text)


def test_the_handle_is_dragged_and_the_plan_up_to_it_is_what_is_driven(panel, service):
    page, card = show(panel, service)
    card.locator(".plan-curve").evaluate("e => e.scrollIntoView({block: 'center'})")
    grip = card.locator(".handle circle").last.bounding_box()
    box = card.locator(".plan-curve").bounding_box()
    page.mouse.move(grip["x"] + 5, grip["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.55 * box["width"], box["y"] + 60, steps=4)
    page.mouse.up()
    expect(card.locator(".handle")).to_have_attribute("aria-valuenow", "3")
    minutes = page.get_by_label("Plan lines or points for at most")
    expect(minutes).to_have_value("1")
    prepare(page)
    assert plans(service) == [3]
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[2]["row"]}


def test_an_uncertainty_is_planned_for_instead_of_a_time(panel, service):
    page, card = show(panel, service)
    card.get_by_role("button", name="an uncertainty").click()
    card.locator(".handle").press("PageDown")
    expect(card.locator("[data-level]")).to_have_attribute("d", re.compile("^M"))
    expect(page.locator("#minutes")).to_be_hidden()
    level = card.locator(".handle").get_attribute("aria-valuenow")
    prepare(page)
    assert len(plans(service)) == 1
    row = POINTS[int(level) - 1]["row"]
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": row}


def test_where_nothing_is_touched_the_shown_plan_is_driven(panel, service):
    page, card = show(panel, service)
    expect(card).to_contain_text("1:55 min")
    expect(page.locator("#minutes")).to_have_value("2")
    job = prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[-1]["row"]}
    service.change(job, state="aborted")
    go(page, "#/plan")
    page.locator("#minutes").fill("1")  # the handle follows a time that is typed
    expect(card.locator(".handle")).to_have_attribute("aria-valuenow", "3")
    expect(card.locator(".notice")).to_be_hidden()
    job = prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[2]["row"]}
    service.change(job, state="aborted")
    go(page, "#/plan")
    page.reload()
    expect(page.locator("#minutes")).to_have_value("2")  # computed as the page opens
    prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[-1]["row"]}


def test_a_curve_that_is_not_driven_says_so(panel, service):
    page, card = show(panel, service)
    notice = card.locator(".notice")
    expect(notice).to_be_hidden()
    plan = plans(service)
    for minutes, more in (("", []), ("12", [12])):
        page.locator("#minutes").fill(minutes)
        expect(notice).to_contain_text("a plan for other choices")
        job = prepare(page)
        plan += more
        assert plans(service) == plan
        assert "plan_rows" not in driven(service)
        service.change(job, state="aborted")
        expect(page.locator("#state")).to_have_text("Aborted")
        go(page, "#/plan")


def test_each_choice_has_its_curve_without_a_tap(panel, service):
    page, card = show(panel, service)
    for choice, wanted in (
        (page.get_by_role("checkbox"), {"perpendicular_only": True}),
        (page.locator("[data-kind=measure-standstill]"), {"mode": "standstill"}),
        (card.get_by_role("button", name="6 min"), {"minutes": 6}),
    ):
        with page.expect_response("**/curve"):
            choice.click()
        assert wanted.items() <= service.orders("/plans")[-1].items()
        expect(card.locator(".notice")).to_be_hidden()
    assert len(plans(service)) == 4


VERTICES = {
    True: "document.querySelector('.curve-space').data[2].x.length",
    False: "document.querySelector('.curve-space [data-trace=\"2\"] path')"
    ".attributes.d.value.split('L').length",
}


@pytest.mark.parametrize(
    "has_card", [pytest.param(True, marks=pytest.mark.long), False]
)
def test_the_chosen_part_stands_in_space_with_tracker_and_beams(
    panel, service, has_card
):
    page, card = show(panel, service, card=has_card)
    expect(card.locator(".curve-space")).to_have_attribute(
        "data-drawn", "", timeout=SLOW_MS
    )
    chosen = VERTICES[has_card]
    page.wait_for_function(f"() => {chosen} === {POINTS[-1]['row']}")
    card.locator(".handle").press("Home")
    page.wait_for_function(f"() => {chosen} === {POINTS[0]['row']}")


def test_the_check_shows_tracker_and_beams_of_the_plan(panel, service):
    page, _ = show(panel, service)
    service.change(prepare(page), state="ready")
    picture = page.locator(".path-view[role=img]")
    expect(picture).to_have_attribute("data-drawn", "", timeout=SLOW_MS)
    expect(page.locator(".path-legend")).to_contain_text("Tracker and beams")
    expect(picture.locator("[data-trace='6'] polygon")).to_have_count(1)
    beams = picture.locator("[data-trace='5'] path").get_attribute("d")
    assert beams.count("M") == len(planned_path()["position"])
