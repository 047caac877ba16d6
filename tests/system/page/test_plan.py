"""What is chosen on Plan is what is ordered; boxes are kept clear; what time buys."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from page_steps import NEXT, SLOW_MS, choose, expect_texts, follow, go, prepare
from scripted_data import ASK, DISCOVERY, EXAMPLES, made_plan, plan_curve, planned_path
from scripted_service import ScriptedService

WARM = EXAMPLES["list_conditions"]["items"][-1]


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


def test_the_order_carries_what_was_chosen_and_nothing_without_a_wish(page, service):
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
    expect(page.locator(".curve-chart")).to_be_hidden()
    expect(page.locator(".curve-space")).to_be_visible()  # what is kept clear
    page.get_by_label("Plan lines or points for at most").fill("8")
    with ordered(page, service) as (_, order):
        assert order["kind"] == "measure-adaptive"
        assert order["planning"]["minutes"] == 8
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
    expect(page.locator(".handle")).to_be_visible()
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


def leave(um: float, **more: Any) -> dict:
    return {"volumetric_uncertainty_um": um, **more}


STAYED = {"minutes": 3.0, "one_place_as_long": leave(2.0)}
PLACES = [1200.0, 300.0, -80.0], [-650.0, 200.0, 40.0]
OPTIONS = [
    leave(2.1, count=1, pays=False, because=None, **STAYED),
    leave(1.3, count=2, pays=True, because="EBZ", **STAYED),
]
PLACE = {
    "tracker": {"position_mm": PLACES[0], "chosen": True},
    "at_stations": [
        leave(um, position_mm=place, duration_s=90.0)
        for place, um in zip(PLACES, (1.8, 1.2), strict=True)
    ],
    "stations": {"recommended": 2, "move_minutes": 10.0, "options": OPTIONS},
}


VICE = {"name": "vice", "min_mm": [100, 50, -300], "max_mm": [220.5, 180, -200]}
KEPT = f"localStorage.setItem('truepath.keep_out', '{json.dumps({'default': [VICE]})}')"


def fill_box(page: Page, box: dict) -> None:
    card = page.locator("[data-card=keep-out]")
    card.locator("button").last.click()
    card.get_by_label("Name").last.fill(box["name"])
    for axis, low, high in zip("XYZ", box["min_mm"], box["max_mm"], strict=True):
        card.locator(f"[data-end='{axis} min_mm']").last.fill(str(low))
        card.locator(f"[data-end='{axis} max_mm']").last.fill(str(high))


def test_a_box_is_planned_around_and_outlasts_a_reload(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    minutes = page.locator("#minutes")
    expect(minutes).to_have_value("")
    fill_box(page, VICE)
    # The usual path is not planned: it would go through the box.
    expect(minutes).to_have_value("3")
    page.reload()
    expect(page.get_by_label("X, to (mm)")).to_have_value("220.5")
    expect(minutes).to_have_value("3")
    minutes.fill("")
    expect(page.locator("#reason")).to_contain_text("need a time limit")
    expect(page.locator(NEXT)).to_be_disabled()
    minutes.fill("3")
    for end, typed, whole in (("X max_mm", "", "220.5"), ("Y max_mm", "50", "180")):
        page.locator(f"[data-end='{end}']").fill(typed)
        expect(page.locator("#box-0-error")).to_contain_text("Give all six numbers")
        reason = page.locator("#reason")
        expect(reason).to_have_text("A keep-out box is not complete.")
        expect(page.locator(NEXT)).to_be_disabled()
        page.locator(f"[data-end='{end}']").fill(whole)
        expect(page.locator(NEXT)).to_be_enabled()
    page.locator("[data-place=chosen]").click()
    service.planned = made_plan()
    expect(page.locator(".handle")).to_be_visible()
    prepare(page)
    order = service.orders("/plans")[-1]
    assert order["workspace"]["keep_out"] == [VICE]
    assert len(order["workspace"]["tracker"]["areas"]) == 4
    assert order["stations"] == 1
    assert service.orders()[0]["plan_id"] == "plan-1"


def test_what_plans_as_it_goes_and_extra_lines_keep_clear_as_well(panel, service):
    service.connected = True
    service.discovery = DISCOVERY | {"ask": ASK}
    page = panel.open("#/plan", before=KEPT)
    page.locator("[data-kind=measure-adaptive]").click()
    job = prepare(page)
    assert service.orders()[0]["planning"]["workspace"] == {"keep_out": [VICE]}
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text("Aborted")
    go(page, f"#/discover/{service.done('discover')}")
    expect(page.locator("[data-card=keep-out]")).to_contain_text("and these as well")
    prepare(page)
    order = service.orders()[-1]
    assert order["kind"] == "measure-extra"
    assert order["keep_out"] == [VICE]
    assert "keep_out_replaces" not in order


def test_a_box_in_inch_is_sent_in_mm_and_not_once_it_is_removed(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    choose(page, "inch")
    fill_box(page, {"name": "vice", "min_mm": [1, 2, -4], "max_mm": [3, 4, -2]})
    service.planned = made_plan()
    expect(page.locator(".handle")).to_be_visible()
    job = prepare(page)
    (box,) = service.orders("/plans")[-1]["workspace"]["keep_out"]
    assert box["min_mm"] == pytest.approx([25.4, 50.8, -101.6])
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text("Aborted")
    go(page, "#/plan")
    page.locator("#minutes").fill("")
    expect(page.locator(NEXT)).to_be_disabled()
    page.get_by_role("button", name="Remove the box").click()
    expect(page.locator(NEXT)).to_be_enabled()


@pytest.mark.parametrize("stated", [[VICE], []], ids=["a box", "none"])
def test_a_measurements_box_holds_until_someone_says_it_is_gone(panel, service, stated):
    usual, other = "These as well", "As in the measurement"
    if not stated:
        usual, other = other, usual
    ways = {
        None: {"keep_out": stated} if stated else {},
        other: {},
        "Only these": {"keep_out": stated, "keep_out_replaces": True},
    }
    service.connected = True  # read as the page opens
    page = panel.open("#/records", before=KEPT if stated else "")
    card = page.locator("[data-card=keep-out]")
    pressed = card.locator("[aria-pressed=true]")
    for way, sent in ways.items():
        go(page, f"#/verify/{service.measured()}")
        expect(pressed).to_have_text(usual)
        if way:
            card.get_by_role("button", name=way).click()
            expect(pressed).to_have_text(way)
        job = prepare(page)
        order = service.orders()[-1]
        assert {key: order[key] for key in order if "keep_out" in key} == sent
        service.change(job, state="aborted")
        page.wait_for_url(f"**/#/run/{job}")


def test_the_check_says_and_shows_what_is_kept_clear(panel, service):
    page = panel.open("#/records")
    for boxes, said in (
        ([VICE, {**VICE, "name": None}], "vice; Box 2"),
        ([], "Keep-out boxesnone"),
    ):
        service.plan["keep_out"] = boxes
        job = service.ready()
        go(page, f"#/check/{job}")
        expect(page.locator(".card", has_text="This run").last).to_contain_text(said)
        page.locator(".path-view[data-drawn]").wait_for()
        some = 1 if boxes else 0
        expect(page.locator(".path-legend .is-box")).to_have_count(some)
        edges = page.locator('.path-view [data-trace="4"] path')
        expect(edges).to_have_count(some)
        if boxes:
            assert edges.get_attribute("d").count("M") == 12 * len(boxes)
        service.change(job, state="aborted")
        expect(page.locator("#state")).to_have_text("Aborted")


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
    expect_texts(card, "0.07: good", "EXX (Positioning of X), U 1.00 µm")
    handle.press("Home")
    expect(handle).to_have_attribute("aria-valuetext", "0:15 min, U 8.00 µm")
    expect_texts(card, "0.50: usable", "ECX (Tilt of X about Z), U 1.00 µm")
    handle.press("ArrowRight")
    expect(handle).to_have_attribute("aria-valuenow", "2")
    assert plans(service) == [3]


def test_what_of_it_is_the_trackers_and_what_takes_that_away_is_said(panel, service):
    usual = {"position_mm": [700, -900, 50], "minutes": 12}
    names = ("change", "turn_deg", "expanded_volumetric_uncertainty_um")
    remedies = [
        usual | dict(zip(names, values, strict=True))
        for values in (("second-place", 0, 1.5), ("turned-base", 90, 1.7))
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
    expect(page.locator("#minutes")).to_have_value("1")
    expect(card.locator(".handle")).to_have_attribute("aria-valuenow", "3")
    prepare(page)
    assert driven(service) == {"plan_id": "plan-1", "plan_rows": POINTS[2]["row"]}
    assert plans(service) == [3]


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_reload_keeps_choices_and_curve_and_plans_nothing(panel, service, language):
    page, card = show(panel, service, language=language)
    with page.expect_response("**/curve"):
        page.get_by_role("checkbox").click()
    card.locator(".handle").press("Home")
    page.reload()
    expect(card.locator(".handle")).to_have_attribute("aria-valuenow", "1")
    expect(page.get_by_role("checkbox")).to_have_attribute("aria-checked", "true")
    expect(card.locator(".notice")).to_be_hidden()
    space = card.locator(".curve-space")
    expect(space).to_have_attribute("data-drawn", "plan-1")
    assert plans(service) == [3, 3]


def test_a_curve_not_driven_says_so_and_a_longer_time_has_its_own(panel, service):
    page, card = show(panel, service)
    notice = card.locator(".notice")
    expect(notice).to_be_hidden()
    page.locator("#minutes").fill("")
    expect(notice).to_contain_text("a plan for other choices")
    job = prepare(page)
    assert plans(service) == [3]
    assert "plan_rows" not in driven(service)
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text("Aborted")
    go(page, "#/plan")
    with page.expect_response("**/curve"):
        page.locator("#minutes").fill("12")
    expect(notice).to_be_hidden()
    assert plans(service) == [3, 12]


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_box_is_drawn_as_it_is_typed_and_one_plan_follows(panel, service, language):
    page, card = show(panel, service, language=language)
    vice = {**VICE, "max_mm": [220, 180, -200]}
    boxes = card.locator('.curve-space [data-trace="6"]')
    edges = boxes.locator("path")
    expect(edges).to_have_count(0)
    with page.expect_response("**/curve"):
        fill_box(page, vice)
        expect(boxes.locator("text")).to_have_text("vice")
        assert edges.get_attribute("d").count("M") == 12
    assert plans(service) == [3, 3]
    assert service.orders("/plans")[-1]["workspace"] == {"keep_out": [vice]}
    page.locator("#box-0-name").fill("")
    expect(boxes.locator("text")).to_have_text(re.compile("^(Box|Bereich) 1$"))
    page.locator("[data-end='Z max_mm']").fill("")
    expect(edges).to_have_count(0)  # not whole
    with page.expect_response("**/curve"):
        card.locator("[data-box] button").click()
    assert "workspace" not in service.orders("/plans")[-1]


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


# As where the pointer is on the last vertex of a line.
POINT_AT_AN_END = """() => {
  const { glplot } = document.querySelector(".curve-space")._fullLayout.scene._scene;
  const end = { object: {}, dataCoordinate: undefined, dataPosition: [0, 0, 0] };
  Object.assign(glplot.selection, end);
  glplot.redraw();
}"""
VERTICES = {
    True: "document.querySelector('.curve-space').data[2].x.length",
    False: "document.querySelector('.curve-space [data-trace=\"2\"] path')"
    ".attributes.d.value.split('L').length",
}


@pytest.mark.parametrize(
    "has_card", [pytest.param(True, marks=pytest.mark.long), False]
)
def test_a_chosen_part_stands_in_space_with_tracker_and_beams(panel, service, has_card):
    page, card = show(panel, service, card=has_card)
    expect(card.locator(".curve-space")).to_have_attribute(
        "data-drawn", "plan-1", timeout=SLOW_MS
    )
    chosen = VERTICES[has_card]
    page.wait_for_function(f"() => {chosen} === {POINTS[-1]['row']}")
    card.locator(".handle").press("Home")
    page.wait_for_function(f"() => {chosen} === {POINTS[0]['row']}")
    if has_card:
        page.evaluate(POINT_AT_AN_END)


def test_the_check_shows_tracker_and_beams_of_the_plan(panel, service):
    service.plan["tracker_mm"] = [700, -900, 50]
    page, _ = show(panel, service)
    service.change(prepare(page), state="ready")
    for picture in (page.locator(".path-view[role=img]"),) * 2:
        expect(picture).to_have_attribute("data-drawn", "", timeout=SLOW_MS)
        expect(page.locator(".path-legend")).to_contain_text("Tracker and beams")
        expect(picture.locator("[data-trace='6'] polygon")).to_have_count(1)
        beams = picture.locator("[data-trace='5'] path").get_attribute("d")
        assert beams.count("M") == len(planned_path()["position"])
        page.reload()
