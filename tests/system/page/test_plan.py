"""What is chosen on Plan is what is ordered; what cannot be is not."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from page_steps import NEXT, choose, follow, go, prepare
from scripted_data import made_plan, plan_curve
from scripted_service import ScriptedService

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


@contextmanager
def ordered(page: Page, service: ScriptedService) -> Iterator[tuple[str, Any]]:
    """Order what is chosen: a job and its order; call it off and come back."""
    job = prepare(page)
    yield job, service.orders()[-1]
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text(re.compile("Aborted|Abgebrochen"))
    go(page, "#/plan")
    again = re.compile("Prepare the run|Lauf vorbereiten")
    expect(page.locator(NEXT)).to_have_text(again)


@pytest.fixture
def page(panel, service) -> Page:
    service.connected = True
    return panel.open("#/plan")


def test_the_order_carries_what_was_chosen(page, service):
    page.get_by_role("radio", name="At standstill").click()
    expect(page.locator("#feed")).to_be_hidden()
    page.get_by_role("checkbox").click()
    with ordered(page, service) as (_, order):
        assert order == {"kind": "measure-standstill", "perpendicular_only": True}
    page.locator("[data-kind=measure-otf]").click()
    page.locator("#on-notice [data-value=pause]").click()
    with ordered(page, service) as (_, order):
        assert order["on_notice"] == "pause"
    page.locator("[data-kind=measure-adaptive]").click()
    expect(page.locator("[data-card=curve]")).to_be_hidden()
    page.get_by_label("Plan lines or points for at most").fill("8")
    with ordered(page, service) as (_, order):
        assert order["kind"] == "measure-adaptive"
        assert order["planning"]["minutes"] == 8


def test_the_order_says_what_is_wanted_and_nothing_without_a_wish(page, service):
    wanted = []
    for name in (None, "Off", "On", "No wish"):
        if name:
            field = page.locator("#control-compensation")
            field.get_by_role("button", name=name, exact=True).click()
        with ordered(page, service) as (_, order):
            wanted.append(order.get("control_compensation"))
    assert wanted == [None, "off", "on", None]


def test_the_feed_goes_up_and_down_in_steps_within_limits(page, service):
    feed = page.locator("#feed")
    expect(feed).to_have_value("")
    page.get_by_label("Slower").click(click_count=2)
    with ordered(page, service) as (_, order):
        assert order["feed_mm_min"] == 5500
    feed.fill("5")
    expect(page.locator("#feed-error")).to_contain_text("From 100 to 20,000 mm/min")
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_have_text("The feed is out of limits.")
    choose(page, "Deutsch")
    choose(page, "Zoll")
    feed.fill("100,5")
    with ordered(page, service) as (_, order):
        assert order["feed_mm_min"] == pytest.approx(2552.7)


def test_a_target_is_sent_as_a_standard_uncertainty(page, service):
    target = page.locator("#target")
    expect(target).to_have_value("")
    for step, values in (
        ("Finer target", ("5", "2")),
        ("Coarser target", ("5", "10", "20", "50", "100", "")),
    ):
        for value in values:
            page.get_by_label(step).click()
            expect(target).to_have_value(value)
    with ordered(page, service) as (_, order):
        assert "target_um" not in order
    for typed in ("0", "0.05", "2000", "much"):
        target.fill(typed)
        expect(page.locator("#target-error")).to_have_text("From 0.1 to 1,000 µm.")
        expect(page.locator(NEXT)).to_be_disabled()
        expect(page.locator("#reason")).to_contain_text("target uncertainty")
        target.fill("")
        expect(page.locator(NEXT)).to_be_enabled()
    page.get_by_label("End early at uncertainty U (k = 2)").fill("3")
    with ordered(page, service) as (job, order):
        assert order["target_um"] == 1.5
        service.change(job, state="ready")
        # Not any list: the grade of the set-up comes as one beside it.
        name = page.get_by_role("heading", name="This run")
        said = page.locator(".card", has=name).locator(".pairs")
        expect(said).to_contain_text("at U = 3.0 µm (k = 2)")


def test_planned_lines_are_driven_and_what_they_will_leave_is_foretold(page, service):
    error = {"title": "No", "detail": "the travel is too short", "action": "Slower."}
    expect(page.locator("[data-card=curve]")).to_contain_text("Planning")
    service.planned |= {"state": "failed", "error": error}
    refused = page.locator(".notice", has_text="the travel is too short")
    expect(refused).to_be_visible()  # of the curve
    page.get_by_role("button", name="Understood").click()
    expect(refused).to_have_count(0)
    page.locator("#minutes").fill("1")
    follow(page, "Prepare the run")
    expect(refused).to_be_visible()
    assert not service.jobs
    service.planned = {"id": "plan-1", "state": "succeeded"}
    service.plan["predicted_um"] = 1.15
    page.locator("#minutes").fill("2.5")
    job = prepare(page)
    wish = {"perpendicular_only": False}
    asked = [(place, order) for _, place, order in service.requests]
    assert asked.pop(0)[1]["minutes"] == 3  # the curve, as the page opens
    assert asked == [
        ("/plans", {"mode": "otf", "minutes": 1, **wish}),
        ("/plans", {"mode": "otf", "minutes": 2.5, **wish}),
        ("/jobs", {"kind": "measure-otf", "plan_id": "plan-1", **wish}),
    ]
    service.change(job, state="ready")
    run = page.locator(".card", has_text="This run")
    expect(run).to_contain_text("U = 2.3 µm (k = 2)")


def test_temperatures_are_not_called_steady_before_they_are(page, service):
    row = page.locator('[data-type="temperature-steady"]')
    for level, shown, name in (
        ("false", "told", "Advised: Temperatures steady"),
        ("unknown", "unknown", "Pending: Temperatures steady"),
        ("true", "true", "Temperatures steady"),
    ):
        service.conditions = [WARM | {"level": level}]
        expect(row.locator("b")).to_have_text(name)
        expect(row).to_have_attribute("data-level", shown)
        expect(row).to_contain_text("X 22.4 °C, changed by 1.4 °C in 10 min")
    title = page.get_by_text("Temperatures before the measurement")
    expect(title).to_be_visible()
    service.conditions = [WARM | {"level": "unknown", "temperatures": []}]
    expect(title).to_be_hidden()
    service.conditions = [WARM]
    go(page, "#/connect")
    expect(row).to_contain_text("X 22.4 °C, changed by 1.4 °C in 10 min")


def test_stations_are_asked_for_in_areas_beside_the_travel(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("[data-place=chosen]").click()
    expect(page.locator("#minutes")).to_have_value("3")
    page.locator(".segments [data-value='2']").click()
    expect(page.locator("#target")).to_be_hidden()
    for side in ("left", "right", "front", "back"):
        page.locator(f"[data-side={side}]").click()
    expect(page.locator("#reason")).to_have_text("Choose at least one free side.")
    page.locator("[data-side=front]").click()
    page.locator("[data-side=right]").click()
    page.locator("#feed").fill("4000")
    page.locator("#height").fill("-100")
    service.planned = made_plan()
    expect(page.locator(".curve-tiles")).to_be_visible()
    prepare(page)
    right = {"min_mm": [1000, 0, -100], "max_mm": [3000, 400, -100]}
    front = {"min_mm": [-2500, -2500, -100], "max_mm": [3000, -500, -100]}
    areas = [{"name": "Right (+X)", **right}, {"name": "Front (−Y)", **front}]
    wish = {"perpendicular_only": False}
    assert service.orders("/plans")[-1] == {
        "mode": "otf",
        "minutes": 3,
        **wish,
        "max_feed_mm_min": 4000,
        "workspace": {"tracker": {"areas": areas}},
        "stations": 2,
    }
    rows = plan_curve()["points"][-1]["row"]
    drive = {"kind": "measure-otf", "plan_id": "plan-1", "plan_rows": rows, **wish}
    assert service.orders() == [drive]


def test_the_check_says_places_what_each_brings_and_what_is_advised(panel, service):
    service.plan["place"] = PLACE
    job = service.ready()
    page = panel.open(f"#/check/{job}")
    card = page.locator(".card", has=page.locator(".advised"))
    for text in (
        "Station 2",
        "X −650 mm, Y 200 mm, Z 40 mm",
        "1:30 min; U = 2.40 µm after it",
        "2 stations are advised.",
        "Moving pays: one station leaves EBZ (Tilt of Z about Y) uncertain.",
    ):
        expect(card).to_contain_text(text)
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text("Aborted")
    # One chosen place is said before motion.
    service.plan["place"] = PLACE | {
        "at_stations": None,
        "stations": PLACE["stations"] | {"recommended": 1},
    }
    go(page, f"#/check/{service.ready()}")
    card = page.locator(".card", has_text="Set it up at")
    expect(card).to_contain_text("X 1,200 mm, Y 300 mm, Z −80 mm")
    expect(card).to_contain_text("One station is enough.")


def _option(count: int, um: float, pays: bool, because: str | None) -> dict:
    return {
        "count": count,
        "minutes": 3.0,
        "volumetric_uncertainty_um": um,
        "one_place_as_long": {"volumetric_uncertainty_um": 2.0},
        "pays": pays,
        "because": because,
    }


PLACE = {
    "tracker": {"position_mm": [1200.0, 300.0, -80.0], "chosen": True},
    "at_stations": [
        {
            "position_mm": place,
            "rows": 20,
            "duration_s": 90.0,
            "volumetric_uncertainty_um": um,
        }
        for place, um in (([1200.0, 300.0, -80.0], 1.8), ([-650.0, 200.0, 40.0], 1.2))
    ],
    "stations": {
        "recommended": 2,
        "move_minutes": 10.0,
        "options": [_option(1, 2.1, False, None), _option(2, 1.3, True, "EBZ")],
    },
}
