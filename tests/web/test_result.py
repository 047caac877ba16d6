"""What the result says beside its tables."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect
from scripted_data import GRADE, half_differences, turntable_estimate

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]


def test_the_location_of_a_rotary_axis_stands_with_the_squarenesses(panel, service):
    service.result["axis_location"] = turntable_estimate(20)["axis_location"]
    page = panel.open(f"#/result/{done(service)}")
    row = page.locator("tr", has_text="XOC")
    expect(row).to_contain_text("Location of C")
    expect(row.locator("td.right")).to_have_text(["12.5 µm", "± 0.8 µm"])
    expect(page.locator("h2", has_text="location of rotary axes")).to_be_visible()


def test_both_directions_of_approach_are_drawn_and_listed(panel, service):
    service.result["direction"] = {
        "model": "constant",
        "half_difference": half_differences(),
    }
    job = done(service)
    page = panel.open(f"#/result/{job}")
    expect(page.locator(".key .is-up")).to_have_text("+ direction")
    page.locator("[data-symbol=EXX]").get_by_role("button").click()
    sheet = page.locator("#detail")
    expect(sheet.locator("thead th")).to_have_count(5)
    first = sheet.locator("tbody tr").first.locator("td")
    expect(first.nth(3)).to_have_text("2.5")
    expect(first.nth(4)).to_have_text("−2.5")


def test_the_grade_of_the_set_up_comes_with_what_would_better_it(panel, service):
    service.result["grade"] = GRADE
    page = panel.open(f"#/result/{done(service)}")
    card = page.locator(".card", has_text="Grade of the set-up")
    expect(card.locator(".grade")).to_have_text("0.86: usable")
    expect(card).to_contain_text("volumetric uncertainty U = 13.0 µm (k = 2)")
    expect(card).to_contain_text("up to 0.25 good, up to 1.00 usable")
    expect(card).to_contain_text("ECX, Tilt of X about Z")
    expect(card).to_contain_text("add a line along Y at the low end of X")


def test_a_machine_without_backlash_has_one_line_a_table(panel, service):
    page = panel.open(f"#/result/{done(service)}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator(".key .is-up")).to_have_count(0)


def done(service) -> str:
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")
    service.finish(job["id"])
    return job["id"]
