"""The volumetric error as a person sees it: its first line, arrows, planes, numbers."""

import re

from playwright.sync_api import Page, expect

from page_steps import DESK, PHONE, SLOW_MS, choose, expect_texts, go, overlapping
from scripted_data import verification, volumetric_error
from scripted_service import ScriptedService

MEAN_AND_LARGEST = re.compile(r"mean \d+\.\d+ µm, largest 13\.46 µm at X 0 mm, Y 0 mm")


def show(panel, service: ScriptedService, **more) -> Page:
    service.result["volumetric_error"] = volumetric_error()
    service.result["measured_range"] = {"X": {"from_mm": 20.0, "to_mm": 500.0}}
    return panel.open(f"#/result/{service.measured()}", **more)


def test_the_first_line_is_the_error_before_and_after_with_uncertainty(panel, service):
    page = show(panel, service)
    values = page.locator(".headline-value")
    expect(values.nth(0)).to_contain_text("15.3µm± 0.2 µm")
    expect(values.nth(1)).to_contain_text("0.7µm± 0.1 µm")
    lost = page.locator("[data-lost-motion]")
    expect(lost).to_contain_text("Lost motion")
    expect(lost).to_contain_text("15.6 ± 0.2 µm as measured, and 3.1 ± 0.4 µm after")
    expect(page.locator(".conformity")).to_contain_text("Enter a tolerance")
    # A machine without a tolerance is not judged.
    expect(page.locator(".machine-tolerance")).to_be_hidden()
    page.get_by_label("Tolerance of the mean").fill("2")
    expect(page.locator(".conformity")).to_contain_text("mean is within 2.0 µm")
    assert service.looks[-1] == ("volumetric-error", 2.0)
    page.get_by_label("Tolerance of the mean").fill("-2")
    expect(page.locator(".headline")).to_contain_text("Give a number above 0")


def test_a_verification_of_this_result_stands_last_in_the_first_line(panel, service):
    for proves, mean in (("job-9", 7.0), ("job-3", 0.9)):
        content = verification(proves)
        content["volumetric_error_um"]["measured"]["mean"] = mean
        service.verified(content, verification={"report_html": ""})
    page = show(panel, service)  # the third job
    values = page.locator(".headline-value")
    expect(values).to_have_count(3)
    expect_texts(values.nth(2), "0.9µm± 0.1 µm", "as left", "every place within 5.0 µm")


def test_the_tolerance_of_the_machine_is_decided_without_asking(panel, service):
    service.conformity = {
        "machine_tolerance_um": 15.0,
        "before": {"conformity": None, "conformity_p95": "outside"},
        "after_expected": {"conformity": None, "conformity_p95": "within"},
    }
    page = show(panel, service)
    judged = page.locator(".machine-tolerance")
    rows = judged.locator(".machine-conformity")
    named = "Tolerance of the machine: 95 % of the places within 15.0 µm"
    expect(judged.locator("p").first).to_have_text(named)
    now = "As measured outside it: 26.0 ± 0.3 µm"
    after = "After compensation within it, as expected: 1.2 ± 0.2 µm"
    expect(rows).to_have_text([now, after])
    expect(rows.first).to_have_attribute("data-conformity", "outside")
    expect(rows.last).to_have_attribute("data-conformity", "within")
    stated = page.locator(".conformity")
    expect(stated).not_to_have_attribute("data-conformity", re.compile(""))
    asked = {look for look in service.looks if look[0] == "volumetric-error"}
    assert asked == {("volumetric-error", None)}
    # One that is typed is kept, and an undecided one is said.
    service.conformity["before"]["conformity"] = "outside"
    service.conformity["after_expected"]["conformity"] = "undecided"
    choose(page, "Deutsch")
    tolerance = page.get_by_label("Toleranz des Mittels")
    tolerance.fill("0,7")
    expect(stated).to_contain_text("U ist zu groß")
    go(page, "#/records")
    go(page, f"#/result/{service.measured()}")
    expect(tolerance).to_have_value("0,7")
    expect(stated).to_contain_text("U ist zu groß")


def test_without_a_graphics_processor_arrows_are_drawn_flat_and_turn(panel, service):
    page = show(panel, service)
    card = page.locator("[data-card=map]")
    expect(card.locator(".map-picture.is-volume")).to_have_attribute("data-drawn", "")
    expect(card.locator(".flat-scene circle")).to_have_count(125)
    expect(card.locator(".flat-scene .axis")).to_have_text(
        ["X (mm)", "Y (mm)", "Z (mm)"]
    )
    arrows = "document.querySelector('[data-trace=\"1\"]').innerHTML"
    seen = {page.evaluate(arrows)}

    def is_drawn_anew() -> None:
        page.wait_for_function(f"(seen) => !seen.includes({arrows})", arg=list(seen))
        seen.add(page.evaluate(arrows))

    page.get_by_label("Exaggeration").press("ArrowRight")
    is_drawn_anew()
    card.get_by_role("button", name="Front").click()
    is_drawn_anew()
    expect(card.locator(".flat-scene .axis")).to_have_text(["X (mm)", "Z (mm)"])
    box = card.locator(".flat-scene").bounding_box()
    page.mouse.move(box["x"] + 90, box["y"] + 90)
    page.mouse.down()
    page.mouse.move(box["x"] + 150, box["y"] + 120)
    page.mouse.up()
    is_drawn_anew()
    assert not page.evaluate("'Plotly' in window"), "loaded without need"
    for width, height in (DESK, PHONE):  # its texts are whole and apart
        page.set_viewport_size({"width": width, "height": height})
        for view, axes in {"Space": 3, "Top": 2, "Front": 2, "Side": 2}.items():
            card.get_by_role("button", name=view).click()
            expect(card.locator(".flat-scene .axis")).to_have_count(axes)
            assert overlapping(page, ".flat-scene text", ".flat-scene") == []


def test_a_plane_shows_what_lies_in_it_and_is_moved_by_keys(panel, service):
    page = show(panel, service)
    card = page.locator("[data-card=map]")
    card.get_by_text("The same in numbers").click()
    expect(card.locator("tbody tr")).to_have_count(27)
    cells = card.locator("tbody tr").first.locator("td")
    expect(cells.nth(3)).to_have_text("−10.00 ± 0.20")
    expect(cells.last).to_have_text("not measured")
    card.get_by_role("button", name="XY").click()
    expect(card.locator(".slice .arrow").first).to_be_visible()
    # The middle of the grid has no error; ends of X were not reached.
    expect(card.locator(".slice circle")).to_have_count(25)
    expect(card.locator(".slice .outside")).to_have_count(1)
    expect(card.locator(".slice .axis")).to_have_text(["X (mm)", "Y (mm)"])
    card.get_by_role("button", name="YZ").click()
    level = card.get_by_label("Plane at")
    expect(level).to_have_attribute("aria-valuetext", "X 250 mm")
    level.press("ArrowLeft")
    expect(level).to_have_attribute("aria-valuetext", "X 125 mm")
    expect(card.locator(".slice .axis")).to_have_text(["Y (mm)", "Z (mm)"])


def test_compensation_shrinks_the_arrows_on_the_same_scale(panel, service):
    page = show(panel, service)
    card = page.locator("[data-card=map]")
    card.get_by_role("button", name="XY").click()
    arrows = card.locator(".slice .arrow")
    expect(arrows).not_to_have_count(0)
    marks = card.locator(".scale-marks").inner_text()
    card.get_by_role("button", name="After compensation").click()
    expect(card).to_contain_text("its direction is not")
    expect(arrows).to_have_count(0)
    page.locator("#next button", has_text="Correct the machine").click()
    page.locator("[data-card=export]").get_by_text("LinuxCNC").click()
    expect(page.locator(".kept-list")).to_contain_text("LinuxCNC")
    page.locator("#back button", has_text="Result").click()
    card.get_by_role("button", name="XY").click()
    with page.expect_response("**/volumetric-map?*compensation=linuxcnc-10-hold*"):
        card.get_by_role("button", name="With tables for LinuxCNC").click()
    expect(arrows).not_to_have_count(0)
    expect(card.locator(".scale-marks")).to_have_text(marks.replace("\n", ""))


def verified(panel, service, *, compensated: bool, **more) -> Page:
    content = verification("job-2") | {"compensated": compensated}
    service.verified(content, verification={"report_html": ""})
    return show(panel, service, **more)


def test_arrows_as_left_stand_where_the_verification_stood_still(panel, service):
    page = verified(panel, service, compensated=True)
    card = page.locator("[data-card=map]")
    card.get_by_role("button", name="XY").click()
    card.get_by_role("button", name="As left").click()
    expect(card.locator(".slice circle")).to_have_count(29)
    expect(card.locator(".slice .arrow")).to_have_count(29)
    expect(card).to_contain_text("all 29 places of the volume at once")
    expect(card.get_by_label("Plane at")).to_be_hidden()
    expect(card.locator(".is-slice")).to_have_attribute(
        "aria-label", re.compile("mean 2.50 µm, largest 2.50 µm")
    )
    card.get_by_text("The same in numbers").click()
    expect(card.locator("tbody tr")).to_have_count(29)
    expect(card.locator("tbody td").nth(3)).to_have_text("1.50 ± 0.40")
    card.get_by_role("button", name="As measured").click()
    expect(card.locator(".slice circle")).to_have_count(25)
    expect(card.get_by_label("Plane at")).to_be_visible()


def test_arrows_in_space_follow_the_slider(panel, service):
    page = verified(panel, service, compensated=False, card=True)
    card = page.locator("[data-card=map]")
    picture = page.locator(".map-picture.is-volume")
    expect(picture).to_have_attribute("data-drawn", "", timeout=SLOW_MS)
    expect(picture).to_have_attribute("aria-label", MEAN_AND_LARGEST)
    slider = page.get_by_label("Exaggeration")
    before = slider.get_attribute("aria-valuetext")
    tips = (
        "() => document.querySelector('.is-volume').data[1].x.filter(Number.isFinite)"
    )
    short = page.evaluate(tips)
    slider.press("ArrowRight")
    expect(slider).not_to_have_attribute("aria-valuetext", before)
    page.wait_for_function(
        f"(short) => String(({tips})()) !== String(short)", arg=short
    )
    # By keys: a pointer on the picture while plotly.js takes it away makes it fail.
    page.locator("#open-settings").press("Enter")
    page.locator("#settings").get_by_role("button", name="Deutsch").press("Enter")
    page.keyboard.press("Escape")
    again = card.get_by_role("button", name="Wie erneut gemessen")
    expect(again).to_be_visible(timeout=SLOW_MS)
    expect(card.get_by_role("button", name="Wie hinterlassen")).to_have_count(0)
    expect(picture).to_have_attribute("data-drawn", "", timeout=SLOW_MS)
    again.click()
    expect(card).to_contain_text("an 29 Stellen im Stillstand")
    page.wait_for_function(
        "() => document.querySelector('.is-volume').data[2].x.length === 29"
    )


def test_picture_scale_and_tolerance_are_in_view_at_once(panel, service):
    page = show(panel, service)
    expect(page.locator(".map-picture.is-volume")).to_have_attribute("data-drawn", "")
    footer = page.locator("footer").bounding_box()
    for part in (".map-frame", ".scale-key", "#tolerance"):
        box = page.locator(part).bounding_box()
        assert box["y"] + box["height"] <= footer["y"], part
