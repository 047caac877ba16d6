"""Boxes that no motion may touch: stated on the page, sent with each order, shown."""

import json

import pytest
from playwright.sync_api import Page, expect

from page_steps import NEXT, choose, go, prepare
from scripted_data import ASK, DISCOVERY, made_plan

VICE = {"name": "vice", "min_mm": [100, 50, -300], "max_mm": [220.5, 180, -200]}
KEPT = f"localStorage.setItem('truepath.keep_out', '{json.dumps({'default': [VICE]})}')"


def fill_box(page: Page, box: dict) -> None:
    card = page.locator("[data-card=keep-out]")
    card.get_by_role("button", name="Add a box").click()
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
    expect(page.locator(".curve-tiles")).to_be_visible()
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
    expect(page.locator(".curve-tiles")).to_be_visible()
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
def test_a_box_of_the_measurement_holds_until_somebody_says_that_it_is_gone(
    panel, service, stated
):
    usual, other = "These as well", "As in the measurement"
    if not stated:
        usual, other = other, usual
    ways = {
        None: {"keep_out": stated} if stated else {},
        other: {},
        "Only these": {"keep_out": stated, "keep_out_replaces": True},
    }
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
        expect(page.locator("#state")).to_have_text("Aborted")


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
