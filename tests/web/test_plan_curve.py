"""What time buys: one curve with a handle, and everything that follows it."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Locator, Page, expect
from scripted_data import plan_curve, planned_path
from scripted_service import ScriptedService

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

SLOW_MS = 60_000.0  # without a graphics card

POINTS = plan_curve()["points"]


def show(panel, service: ScriptedService, **more) -> tuple[Page, Locator]:
    """Open Plan with the curve computed."""
    service.connected = True
    service.planned = {
        "id": "plan-1",
        "state": "succeeded",
        "progress": 1.0,
        "commanded": planned_path(),
        "document": {"stations": None},
    }
    page = panel.open("#/plan", **more)
    card = page.locator("[data-card=curve]")
    card.get_by_role("button", name="Compute the curve").click()
    expect(card.locator(".handle")).to_be_visible()
    return page, card


def orders(service: ScriptedService) -> list:
    return [body for _, path, body in service.requests if path == "/plans"]


def driven(service: ScriptedService) -> dict:
    """Return what the newest job says of a plan."""
    job = next(body for _, path, body in service.requests[::-1] if path == "/jobs")
    return {name: job[name] for name in ("plan_id", "plan_rows") if name in job}


def prepare(page: Page) -> None:
    page.locator("#next button").click()
    page.wait_for_url("**/#/check/*")


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
    assert [order["minutes"] for order in orders(service)] == [6]


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
    assert [order["minutes"] for order in orders(service)] == [6]
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[2]["row"]}


def test_an_uncertainty_is_planned_for_instead_of_a_time(panel, service):
    page, card = show(panel, service)
    card.get_by_role("button", name="an uncertainty").click()
    card.locator(".handle").press("PageDown")
    expect(card.locator("[data-level]")).to_have_attribute("d", re.compile("^M"))
    expect(page.locator("#minutes")).to_be_hidden()
    level = card.locator(".handle").get_attribute("aria-valuenow")
    prepare(page)
    assert len(orders(service)) == 1
    row = POINTS[int(level) - 1]["row"]
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": row}


def test_where_nothing_is_touched_the_shown_plan_is_driven(panel, service):
    page, card = show(panel, service)
    expect(card).to_contain_text("1:55 min")
    expect(page.locator("#minutes")).to_have_value("2")
    prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[-1]["row"]}


def test_the_handle_follows_a_time_that_is_typed(panel, service):
    page, card = show(panel, service)
    page.locator("#minutes").fill("1")
    expect(card.locator(".handle")).to_have_attribute("aria-valuenow", "3")
    expect(card.locator(".notice")).to_be_hidden()
    prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[2]["row"]}


@pytest.mark.parametrize(
    ("minutes", "plans"), [("12", [6, 12]), ("", [6])], ids=["longer", "usual-path"]
)
def test_a_curve_that_is_not_driven_says_so(panel, service, minutes, plans):
    page, card = show(panel, service)
    page.locator("#minutes").fill(minutes)
    expect(card.locator(".notice")).to_contain_text("not what will be driven")
    prepare(page)
    assert [order["minutes"] for order in orders(service)] == plans
    assert "plan_rows" not in driven(service)


def test_a_curve_of_other_directions_is_said_to_be_one(panel, service):
    page, card = show(panel, service)
    page.get_by_role("checkbox", name="Only deviations across the path").click()
    expect(card.locator(".notice")).to_contain_text("compute it again")


def test_nothing_of_a_curve_is_left_after_a_reload(panel, service):
    page, _ = show(panel, service)
    page.reload()
    expect(page.locator("#minutes")).to_have_value("")
    prepare(page)
    assert driven(service) == {}


def test_a_curve_of_other_choices_is_said_to_be_one(panel, service):
    page, card = show(panel, service)
    expect(card.locator(".notice")).to_be_hidden()
    page.locator("[data-kind=measure-standstill]").click()
    expect(card.locator(".notice")).to_contain_text("compute it again")


VERTICES = {
    True: "document.querySelector('.curve-space').data[2].x.length",
    False: "document.querySelector('.curve-space [data-trace=\"2\"] path')"
    ".attributes.d.value.split('L').length",
}


@pytest.mark.parametrize("has_card", [True, False])
def test_the_chosen_part_stands_in_space_with_tracker_and_beams(
    panel, service, has_card
):
    page, card = show(panel, service, card=has_card)
    expect(card.locator(".curve-space")).to_have_attribute(
        "data-drawn", "", timeout=SLOW_MS
    )
    chosen = VERTICES[has_card]
    page.wait_for_function(f"{chosen} === {POINTS[-1]['row']}")
    card.locator(".handle").press("Home")
    page.wait_for_function(f"{chosen} === {POINTS[0]['row']}")


def test_a_measurement_that_plans_as_it_goes_is_a_choice(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("[data-kind=measure-adaptive]").click()
    expect(page.locator("[data-card=curve]")).to_be_hidden()
    page.get_by_label("Plan lines or points for at most").fill("8")
    page.locator("#next button").click()
    page.wait_for_url("**/#/check/*")
    ((_, path, order),) = service.requests
    assert path == "/jobs"
    assert order["kind"] == "measure-adaptive"
    assert order["planning"]["minutes"] == 8
