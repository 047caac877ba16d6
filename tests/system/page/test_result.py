"""What a result says of itself, first in words, beside its tables, and by its proof."""

import re

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect

from page_steps import DESK, PHONE, assert_fits, choose, expect_texts, go, job_of
from scripted_data import (
    EXAMPLES,
    circles_in_motion,
    comparison,
    half_differences,
    residuals,
    result,
    turntable_estimate,
    verification,
)
from scripted_service import ScriptedService
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.files.environment import CAUSES, Refraction
from truepath.results.result_assessment import assess_air


def test_a_result_says_beside_its_tables_what_they_rest_on(panel, service):
    def part(um):
        return {"x": um / 2, "y": um / 2, "z": um / 2, "volume": um}

    found = service.result
    found["axis_location"] = turntable_estimate(20)["axis_location"]
    found["grade"] = EXAMPLES["get_plan_grade"]
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
    expect(card.locator(".grade")).to_have_text("1.47: poor")
    expect(card).to_contain_text("volumetric uncertainty U = 22.6 µm (k = 2)")
    expect(card).to_contain_text("ECX, Tilt of X about Z")
    expect(card).to_contain_text("add a line along Y at the high end of X")
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
    expect_texts(first, "EYX", "8.0 µm", "changed")
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


def test_a_result_is_held_against_a_direct_measurements_file(panel, service, witness):
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
    expect_texts(first, "C0Y", "weicht ab")
    expect(card).to_contain_text("EYX")
    expect(card.locator(".notice")).to_have_count(0)
    address = re.compile(comparison()["links"]["report_html"] + "$")
    expect(card.get_by_role("link")).to_have_attribute("href", address)


LEFT_OUT = Reason(
    "samples-left-out",
    "usable",
    {"samples": 42, "line": 7, "from_s": 61.2, "to_s": 61.3, "distance_um": 5012.0},
)
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
SHIFTED = Reason("axis-shifted", "doubtful", {"axes": "X", "by": "+0.42 mm"})
(AIR,) = assess_air(
    [Refraction("nobody", why=CAUSES["no-temperature"])], ["run"]
).reasons
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


def turn_to(page: Page, service: ScriptedService, *reasons: Reason) -> Locator:
    verdict = Verdict(reasons)
    service.result["verdict"] = verdict_json(verdict)
    job = service.measured(verdict=verdict.state)
    go(page, f"#/result/{job}")
    expect(page.locator(".verdict .tile").first).to_be_visible()
    return page.locator(".verdict-band")


def test_a_result_not_to_be_used_is_loud_says_why_and_offers_no_files(panel, service):
    page = panel.open("#/records")
    band = turn_to(page, service, LEFT_OUT, OPEN, BEYOND)
    heading = band.get_by_role("heading")
    expect(heading).to_have_text("Not to be used")
    expect(band).to_have_attribute("role", "alert")
    expect(band.locator("li")).to_have_text(
        [f"{reason} {reason.remedy}" for reason in (BEYOND, OPEN)]
        + [f"{LEFT_OUT} {LEFT_OUT.remedy}".replace("5012.0", "5,012.0")]
    )
    box, first = band.bounding_box(), page.locator(".card.verdict").bounding_box()
    assert box["y"] + box["height"] <= first["y"]
    size = heading.evaluate("e => getComputedStyle(e).fontSize")
    assert float(size.removesuffix("px")) >= 30
    colour = band.evaluate("e => getComputedStyle(e).backgroundColor")
    assert colour == "rgb(179, 19, 31)"
    # Its tables are named so when taken away.
    link, job = page.get_by_role("link", name="CSV"), job_of(page)
    address = f"/api/v1/jobs/{job}/result/error-tables.csv?accept_verdict=true"
    expect(link).to_have_attribute("href", re.compile(re.escape(address) + "$"))
    expect(link).to_have_attribute("download", f"not-to-be-used-{job}.csv")
    # A list and a run that has ended say it, too.
    go(page, f"#/run/{job}")
    fault = page.locator(".notice.is-fault").first
    expect(fault).to_contain_text("Not to be used")
    go(page, f"#/export/{job}")
    expect(page.locator(".notice.is-fault")).to_contain_text("No files are made")
    expect(page.locator("[data-card=export]")).to_have_count(0)
    go(page, "#/records")
    expect(page.locator(".records").first).to_contain_text("Not to be used")
    turn_to(page, service, LEFT_OUT, OPEN, SHIFTED, AIR, BEYOND)
    choose(page, "Deutsch")
    expect(heading).to_have_text("Nicht verwenden")
    rows = band.locator("li")
    expect(rows.nth(0)).to_contain_text("das 3,50-Fache des Rauschens")
    expect(rows.nth(1)).to_contain_text("weichen um 9,0 µm voneinander ab")
    expect(rows.nth(2)).to_contain_text("um +0,42 mm neben ihrem Ort")
    expect(rows.nth(3)).to_contain_text("die Temperatur der Luft wurde nicht gemessen")
    expect(rows.nth(4)).to_contain_text("42 Messpunkte der Geraden 8, von 61,2 s bis")


def test_a_result_that_may_be_used_or_is_doubtful_says_so_quietly(panel, service):
    page = panel.open("#/records")
    band = turn_to(page, service, LEFT_OUT)
    expect(band).to_have_attribute("role", "note")
    expect(band).to_contain_text("The result may be used.")
    expect(band.locator("li")).to_contain_text("42 samples of line 8")
    go(page, "#/records")
    expect(page.locator(".job-state")).to_have_count(1)
    expect(page.locator(".verdict-mark")).to_have_count(0)
    # One with nothing to say has no band.
    turn_to(page, service)
    expect(band).to_have_count(0)
    mark = page.locator(".view-head .verdict-mark")
    expect(mark).to_have_text("May be used")
    turn_to(page, service, OPEN)
    expect(band.get_by_role("heading")).to_have_text("Doubtful")
    assert page.locator(".verdict-mark").count() == 0
    expect(band.locator("li")).to_have_count(1)
    # Words of a later version stand as they are.
    moon = {"kind": "moon", "state": "doubtful", "run": "", "values": {}}
    service.result["verdict"] = {
        "state": "doubtful",
        "reasons": ["The moon is full."],
        "details": [moon | {"remedy": "Wait a fortnight."}],
    }
    go(page, f"#/result/{service.measured()}")
    expect(band.locator("li")).to_have_text("The moon is full. Wait a fortnight.")


def read_radii(path: Locator) -> np.ndarray:
    points = re.findall(r"([\d.]+) ([\d.]+)", path.get_attribute("d") or "")
    return np.linalg.norm(np.array(points, float) - 210.0, axis=1)


def test_a_circle_is_about_its_centre_with_both_senses_and_its_figures(panel, service):
    content = verification(service.measured()) | circles_in_motion()
    page = panel.open(f"#/verify/{service.verified(content)}")
    card = page.locator("[data-card=circles]")
    expect(card).to_be_visible()
    chart = card.get_by_role("img", name=re.compile("circle XY, diameter 307.2 mm"))
    expect(chart).to_have_accessible_name(re.compile(r"H 6\.1 ± 1\.8 µm; G 13\.6"))
    there = read_radii(chart.locator("path.is-counterclockwise"))
    back = read_radii(chart.locator("path.is-clockwise"))
    predicted = read_radii(chart.locator("path.is-predicted").first)
    assert len(there) == len(back) == 120
    assert chart.locator("path").first.get_attribute("d").endswith("Z")
    nominal = float(chart.locator("circle.base").get_attribute("r"))
    rings = sorted(float(c.get_attribute("r")) for c in chart.locator("circle").all())
    marks = chart.locator("text.ring").all_text_contents()
    assert marks == ["−10", "−5", "0", "5", "10"]
    per_um = (rings[-1] - nominal) / 10.0
    angle = np.radians(np.arange(1.5, 360.0, 3.0))
    half_um, oval_um = 3.0 * np.sign(np.sin(angle)), 4.0 * np.cos(2.0 * angle)
    assert np.allclose(there, nominal + per_um * (oval_um + half_um), atol=0.05)
    assert np.allclose(back, nominal + per_um * (oval_um - half_um), atol=0.05)
    assert np.allclose(predicted, nominal + per_um * oval_um, atol=0.05)
    expect(card.locator("[data-figure=H] td").first).to_have_text("6.1 ± 1.8")
    expect(card).to_contain_text("The result does not predict H within")
    expect(card.locator("figcaption")).to_contain_text("Ring to ring 5.0 µm")
    card.get_by_text("Deviation by angle as a table").click()
    row = card.locator(".map-table tbody tr").nth(1)
    expect(row).to_have_text(re.compile(r"^4\.5\s*7\.0\s*1\.0\s*4\.0\s*4\.0$"))
    # It fits a phone and a panel and speaks German.
    choose(page, "Dark", "Deutsch")
    expect(card).to_contain_text("XY, Durchmesser 307,2 mm, 3.000 mm/min")
    expect(card).to_contain_text("G im Uhrzeiger")
    expect(card.locator(".notice")).to_contain_text("Zeilen des Plans")
    for width, height in (PHONE, DESK):
        page.set_viewport_size({"width": width, "height": height})
        box = card.locator(".circle-plot").bounding_box()
        assert box["width"] == pytest.approx(box["height"], abs=1.0)
        assert min(420, 0.75 * width) <= box["width"] + 1.0
        assert box["x"] + box["width"] <= width
        assert_fits(page)
    # One without its centre is stated and not drawn.
    circles = circles_in_motion() | {"circles_missing": []}
    circles["circles_in_motion"][0]["centre_um"] = None
    proof = service.verified(verification(service.measured()) | circles)
    go(page, f"#/verify/{proof}")
    choose(page, "English")
    expect(card).to_contain_text("An earlier version computed this circle")
    expect(card.locator("[data-figure=G] td").first).to_have_text("13.6 ± 1.8")
    expect(card.locator("svg.circle-plot, .notice")).to_have_count(0)


@pytest.mark.parametrize(
    ("language", "said"),
    [
        ("en", ("27 within the tolerance", "1 undecided", "2 outside")),
        ("de", ("27 innerhalb der Toleranz", "1 nicht entscheidbar", "2 außerhalb")),
    ],
)
def test_measured_places_have_colour_and_shape_in_space(panel, service, language, said):
    content = verification(service.measured(), "outside")
    content["places"]["conformity"][2] = "undecided"
    proof = service.verified(content)
    page = panel.open(f"#/verify/{proof}", language=language)
    picture = page.locator(".path-view[data-drawn]")
    for trace, shape, count in (
        (1, "circle:not([fill=none])", 27),
        (2, "circle[fill=none]", 1),
        (3, "polygon", 2),
    ):
        places = picture.locator(f"[data-trace='{trace}'] {shape}")
        expect(places).to_have_count(count)
    expect_texts(page.locator(".places-key"), *said)
    go(page, "#/records")  # the picture is taken away without an error
    expect(page.locator("#to-records[aria-current=page]")).to_be_visible()
