"""Boxes that no motion may touch: stated on the page, sent with each order, shown."""

from __future__ import annotations

import json

import pytest
from playwright.sync_api import Page, expect
from scripted_data import ASK, DISCOVERY

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

NEXT = "#next button"
VICE = {"name": "vice", "min_mm": [100, 50, -300], "max_mm": [220.5, 180, -200]}
KEPT = f"localStorage.setItem('truepath.keep_out', '{json.dumps({'default': [VICE]})}')"


def fill_box(page: Page, box: dict) -> None:
    """Add a box and type it."""
    card = page.locator("[data-card=keep-out]")
    card.get_by_role("button", name="Add a box").click()
    card.get_by_label("Name").last.fill(box["name"])
    for axis, low, high in zip("XYZ", box["min_mm"], box["max_mm"], strict=True):
        card.locator(f"[data-end='{axis} min_mm']").last.fill(str(low))
        card.locator(f"[data-end='{axis} max_mm']").last.fill(str(high))


def plans(service) -> list[dict]:
    return [body for _, path, body in service.requests if path == "/plans"]


def jobs(service) -> list[dict]:
    return [body for _, path, body in service.requests if path == "/jobs"]


def test_a_box_is_planned_around_and_outlasts_a_reload(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    expect(page.locator("#minutes")).to_have_value("")
    fill_box(page, VICE)
    # The usual path is not planned: it would go through the box.
    expect(page.locator("#minutes")).to_have_value("3")
    page.reload()
    expect(page.get_by_label("X, to (mm)")).to_have_value("220.5")
    expect(page.locator("#minutes")).to_have_value("3")
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    (order,) = plans(service)
    assert order["workspace"] == {"keep_out": [VICE]}
    assert jobs(service)[0]["plan_id"] == "plan-1"


def test_no_path_is_driven_that_does_not_know_the_box(panel, service):
    service.connected = True
    page = panel.open("#/plan", before=KEPT)
    page.locator("#minutes").fill("")
    expect(page.locator("#reason")).to_contain_text("need a time to plan for")
    expect(page.locator(NEXT)).to_be_disabled()
    page.get_by_role("button", name="Remove the box").click()
    expect(page.locator(NEXT)).to_be_enabled()


@pytest.mark.parametrize(("end", "typed"), [("X max_mm", ""), ("Y max_mm", "50")])
def test_a_box_without_all_ends_in_order_is_not_sent(panel, service, end, typed):
    service.connected = True
    page = panel.open("#/plan", before=KEPT)
    page.locator(f"[data-end='{end}']").fill(typed)
    expect(page.locator("#box-0-error")).to_contain_text("Give all six numbers")
    expect(page.locator("#reason")).to_have_text("A keep-out box is not complete.")
    expect(page.locator(NEXT)).to_be_disabled()


def test_a_measurement_that_plans_as_it_goes_keeps_clear_as_well(panel, service):
    service.connected = True
    page = panel.open("#/plan", before=KEPT)
    page.locator("[data-kind=measure-adaptive]").click()
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    assert jobs(service)[0]["planning"]["workspace"] == {"keep_out": [VICE]}


def test_box_and_chosen_place_of_the_tracker_are_asked_for_together(panel, service):
    service.connected = True
    page = panel.open("#/plan", before=KEPT)
    page.locator("[data-place=chosen]").click()
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    (order,) = plans(service)
    assert order["workspace"]["keep_out"] == [VICE]
    assert len(order["workspace"]["tracker"]["areas"]) == 4
    assert order["stations"] == 1


def test_a_box_in_inch_is_sent_in_mm(panel, service):
    service.connected = True
    page = panel.open("#/plan", before="localStorage.setItem('truepath.units', 'inch')")
    fill_box(page, {"name": "vice", "min_mm": [1, 2, -4], "max_mm": [3, 4, -2]})
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    (box,) = plans(service)[0]["workspace"]["keep_out"]
    assert box["min_mm"] == pytest.approx([25.4, 50.8, -101.6])


@pytest.mark.parametrize(
    ("stated", "way", "sent"),
    [
        (True, None, {"keep_out": [VICE]}),
        (True, "As in the measurement", {}),
        (True, "Only these", {"keep_out": [VICE], "keep_out_replaces": True}),
        (False, None, {}),
        (False, "These as well", {}),
        (False, "Only these", {"keep_out": [], "keep_out_replaces": True}),
    ],
)
def test_a_box_of_the_measurement_holds_until_somebody_says_that_it_is_gone(
    panel, service, stated, way, sent
):
    service.connected = True
    job = service.new_job("measure-otf", state="succeeded")["id"]
    page = panel.open(f"#/verify/{job}", before=KEPT if stated else "")
    card = page.locator("[data-card=keep-out]")
    usual = "These as well" if stated else "As in the measurement"
    expect(card.locator("[aria-pressed=true]")).to_have_text(usual)
    if way:
        card.get_by_role("button", name=way).click()
        expect(card.locator("[aria-pressed=true]")).to_have_text(way)
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    (order,) = jobs(service)
    assert {key: order[key] for key in order if "keep_out" in key} == sent


def test_extra_lines_keep_clear_of_stated_boxes(panel, service):
    service.connected = True
    service.discovery = DISCOVERY | {"ask": ASK}
    job = service.new_job("discover", state="succeeded")["id"]
    page = panel.open(f"#/discover/{job}", before=KEPT)
    expect(page.locator("[data-card=keep-out]")).to_contain_text("and these as well")
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    (order,) = jobs(service)
    assert order["kind"] == "measure-extra"
    assert order["keep_out"] == [VICE]
    assert "keep_out_replaces" not in order


@pytest.mark.parametrize(
    ("boxes", "said"),
    [
        ([VICE, {**VICE, "name": None}], "vice; Box 2"),
        ([], "Keep-out boxesnone"),
    ],
)
def test_the_check_says_and_shows_what_is_kept_clear(panel, service, boxes, said):
    service.connected = True
    service.plan["keep_out"] = boxes
    job = service.new_job("measure-otf", state="ready")["id"]
    page = panel.open(f"#/check/{job}")
    expect(page.locator(".card", has_text="This run").last).to_contain_text(said)
    page.locator(".path-view[data-drawn]").wait_for()
    legend = page.locator(".path-legend .is-box")
    expect(legend).to_have_count(1 if boxes else 0)
    edges = page.locator('.path-view [data-trace="4"] path')
    expect(edges).to_have_count(1 if boxes else 0)
    if boxes:
        assert edges.get_attribute("d").count("M") == 12 * len(boxes)
