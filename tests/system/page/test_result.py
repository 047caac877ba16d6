"""What the result says beside its tables."""

import re

from playwright.sync_api import expect

from page_steps import choose
from scripted_data import (
    GRADE,
    comparison,
    half_differences,
    residuals,
    result,
    turntable_estimate,
)


def test_a_result_says_beside_its_tables_what_they_rest_on(panel, service):
    def part(um):
        return {"x": um / 2, "y": um / 2, "z": um / 2, "volume": um}

    found = service.result
    found["axis_location"] = turntable_estimate(20)["axis_location"]
    found["grade"] = GRADE
    found["uncertainty_budget"] = {
        "sources_um": {"tracker": part(0.3), "model": part(0.4), "thermal": part(0.0)},
        "total_um": part(0.5),
    }
    found["observability"]["unobservable"] = [
        "ECZ (roll of Z) is not distinguishable from EXZ and EYZ with one tool length; "
        "a second target at least 140 mm to the side, in X or Y, separates them "
        "(to 3.0 µrad, k = 2, on the same path)"
    ]
    page = panel.open(f"#/result/{service.measured()}")
    row = page.locator("tr", has_text="XOC")
    expect(row).to_contain_text("Location of C")
    expect(row.locator("td.right")).to_have_text(["12.5 µm", "± 0.8 µm"])
    expect(page.locator("h2", has_text="location of rotary axes")).to_be_visible()
    card = page.locator(".card", has_text="Grade of the set-up")
    expect(card.locator(".grade")).to_have_text("0.86: usable")
    expect(card).to_contain_text("volumetric uncertainty U = 13.0 µm (k = 2)")
    expect(card).to_contain_text("up to 0.25 good, up to 1.00 usable")
    expect(card).to_contain_text("ECX, Tilt of X about Z")
    expect(card).to_contain_text("add a line along Y at the low end of X")
    rows = page.locator("[data-card=budget] tbody tr")  # the largest first
    expect(rows).to_have_count(3)
    expect(rows.nth(0)).to_contain_text("prior and knots64 %0.80")
    expect(rows.nth(1)).to_contain_text("Noise of the tracker36 %0.60")
    expect(rows.nth(2)).to_contain_text("Total1.00")
    chart = page.locator("[data-symbol=ECZ]")
    expect(chart).to_have_class(re.compile("is-missing"))
    expect(chart).to_contain_text("Not determined by these data")
    # Why it is not determined is said once, and so in German.
    said = (
        "ECZ (roll of Z) is not distinguishable from EXZ and EYZ with one tool length"
    )
    expect(page.get_by_text(said)).to_have_count(1)
    choose(page, "Deutsch")
    card = page.locator(".card", has_text="Nicht bestimmbare Größen")
    expect(card.locator("li")).to_have_text(
        "ECZ (Rollen von Z) ist mit diesen Daten nicht von EXZ und EYZ unterscheidbar. "
        "Erkennbar wird es mit einem Reflektor mindestens 140 mm seitlich. "
        "Auf derselben Bahn wird es dann auf 3,0 µrad bekannt (k = 2)."
    )


def test_directions_and_what_was_not_measured_are_drawn_and_listed(panel, service):
    half = half_differences()
    service.result["direction"] = {"model": "constant", "half_difference": half}
    service.result["measured_range"] = {"X": {"from_mm": 100.0, "to_mm": 500.0}}
    table = service.result["error_tables"]["EXX"]
    table["extrapolated"] = [position < 100.0 for position in table["position_mm"]]
    page = panel.open(f"#/result/{service.measured()}")
    expect(page.locator(".key .is-up")).to_have_text("+ direction")
    expect(page.locator(".key .is-hatched")).to_have_text("Continued, not measured")
    page.locator("[data-symbol=EXX]").get_by_role("button").click()
    sheet = page.locator("#detail")
    expect(sheet.locator("thead th")).to_have_count(5)
    first, last = sheet.locator("tbody tr").first, sheet.locator("tbody tr").last
    expect(first.locator("td").nth(3)).to_have_text("2.5")
    expect(first.locator("td").nth(4)).to_have_text("−2.5")
    expect(first.locator("td").first).to_have_text("0*")
    expect(last.locator("td").first).to_have_text("500")
    expect(sheet.locator("caption")).to_contain_text("Beyond what was measured")


def test_residuals_are_seen_by_row_along_lines_and_as_a_distribution(panel, service):
    found = residuals()
    along = found.pop("along_lines")
    service.result["residuals"] |= found
    service.result["runs"] = [{"residuals": {"along_lines": along}}]
    page = panel.open(f"#/result/{service.measured()}")
    card = page.locator("[data-card=residuals]")
    expect(card.locator(".column")).to_have_count(6)
    expect(card).to_contain_text("Largest in row 5: 3.00 µm")
    card.get_by_role("button", name="Along a line").click()
    expect(card.locator(".trace")).to_have_count(3)
    slider = card.get_by_role("slider")
    first = card.locator(".trace").first.get_attribute("d")
    slider.press("ArrowRight")
    expect(slider).to_have_attribute("aria-valuetext", "towards row 3 of the path")
    expect(card.locator(".trace").first).not_to_have_attribute("d", first)
    card.get_by_role("button", name="Distribution").click()
    expect(card.locator(".level")).to_have_count(1)
    expect(card.locator(".axis")).to_have_text(
        ["Residual (µm)", "Share of the cells (%)"]
    )


def test_a_result_is_held_against_an_earlier_calibration(panel, service):
    earlier = service.measured(result={"report": "report.html"})
    page = panel.open(f"#/result/{service.measured()}")
    before = result()
    moved = before["error_tables"]["EYX"]
    moved["value_um"] = [v - 8.0 for v in moved["value_um"]]
    address = f"**/jobs/{earlier}/result"
    page.route(address, lambda route: route.fulfill(json=before))
    card = page.locator("[data-card=compare]")
    card.get_by_label("Calibration", exact=True).select_option(index=1)
    expect(card).to_contain_text("1 of 20 errors have changed by more")
    first = card.locator("tbody tr").first
    expect(first).to_contain_text("EYX")
    expect(first).to_contain_text("8.0 µm")
    expect(first).to_contain_text("changed")
    first.get_by_role("button").click()
    expect(page.locator("#detail-title")).to_contain_text("EYX")
    page.keyboard.press("Escape")
    volume = page.locator("[data-card=map]")
    volume.get_by_role("button", name="XY").click()
    volume.get_by_role("button", name="Calibration of").click()
    expect(volume.locator(".slice .arrow").first).to_be_visible()
    before["machine"] = {**before["machine"], "tool_offset_mm": [0.0, 0.0, -90.0]}
    card.get_by_label("Calibration", exact=True).select_option(index=0)
    card.get_by_label("Calibration", exact=True).select_option(index=1)
    expect(card.locator(".notice")).to_contain_text("different tool offsets")


def take(card, content: bytes) -> None:
    file = {"name": "laser.csv", "mimeType": "text/csv", "buffer": content}
    card.locator("input[type=file]").set_input_files(file)


def test_a_result_is_held_against_the_file_of_a_direct_measurement(
    panel, service, witness
):
    witness.expect("422")
    service.comparison = comparison()
    result = service.measured()
    page = panel.open(f"#/result/{result}")
    card = page.locator("[data-card=reference]")
    take(card, b"x,y\n")  # a file that cannot be read is named with its row
    expect(card.locator(".notice")).to_contain_text("laser.csv, row 1")
    service.requests.clear()
    choose(page, "Deutsch")
    expect(card.locator("h2")).to_contain_text("vergleichen")  # drawn anew
    card.locator("#reference_um").fill("-1")
    expect(card.get_by_role("button")).to_be_disabled()
    card.locator("#reference_um").fill("0,4")
    take(card, b"error,position_mm,direction,value,unit\nEXX,0,+,0.1,um\n")
    expect(card).to_contain_text("1 von 2 Abweichungen")
    sent = service.requests.pop()
    assert sent == ("POST", f"/jobs/{result}/comparisons", ("laser.csv", 0.2, 0.0))
    first = card.locator("tbody tr").first
    expect(first).to_contain_text("C0Y")
    expect(first).to_contain_text("weicht ab")
    expect(card).to_contain_text("EYX")
    expect(card.locator(".notice")).to_have_count(0)
    address = re.compile(comparison()["links"]["report_html"] + "$")
    expect(card.get_by_role("link")).to_have_attribute("href", address)


def test_who_may_not_compare_is_not_asked_to(panel, service):
    service.log_in_required, service.user = True, ("olga", "operator")
    page = panel.open(f"#/result/{service.measured()}")
    expect(page.locator("[data-card=map]")).to_be_visible()
    expect(page.locator("[data-card=reference]")).to_be_hidden()
