"""The files for the controller: seen for what they leave before they are taken."""

import json
import re

import pytest
from playwright.sync_api import Locator, Page, expect

from page_steps import DESK, PHONE, assert_fits, choose, go
from scripted_data import rotary_account, verification, volumetric_error
from scripted_service import ScriptedService

FILES = "/api/v1/jobs/job-1/compensations/{}/archive"


def show(panel, service: ScriptedService, **more) -> tuple[Page, Locator]:
    page = panel.open(f"#/export/{service.measured()}", **more)
    return page, page.locator("[data-card=export]")


def test_residual_sign_and_unmeasured_range_come_before_taking(panel, service, witness):
    witness.expect("status of 422")
    service.result["volumetric_error"] = volumetric_error()
    page, card = show(panel, service)
    expect(card.get_by_role("radio")).to_have_count(2)
    expect(card.get_by_role("link")).to_have_count(0)
    card.get_by_text("LinuxCNC").click()
    expect(card).to_contain_text("20.72 µm")
    expect(card).to_contain_text("14.32 µm ± 0.08 µm (k = 2)")
    expect(card).to_contain_text("The 15.3 µm of the result is the mean over a regular")
    expect(card).to_contain_text("straightness, angular errors, squareness")
    expect(card).not_to_contain_text("sign is not settled")
    with page.expect_download() as taken:
        card.get_by_role("link", name="Files (ZIP)").click()
    assert taken.value.suggested_filename == "linuxcnc-10-hold.zip"
    # Files of a machine of straight axes say nothing of rotary ones.
    expect(card.locator("[data-rotary]")).to_have_count(0)
    card.get_by_text("Heidenhain TNC").click()
    expect(card.locator(".notice")).to_contain_text("sign is not settled")
    expect(card).to_contain_text("Z not measured from 0 to 10 and 532.058 to 542.058")
    expect(card).to_contain_text("13.40 µm ± 0.07 µm (k = 2)")
    card.get_by_role("button", name="Fade to 0").click()
    expect(card.get_by_role("link")).to_have_attribute(
        "href", re.compile(FILES.format("heidenhain-10-fade") + "$")
    )
    card.get_by_role("button", name="Refuse").click()
    expect(card.locator(".notice.is-fault")).to_contain_text("X not measured")
    expect(card.get_by_role("link")).to_have_count(0)


def test_what_files_leave_of_rotary_axes_stands_beside_straight_ones(panel, service):
    service.rotary_account = rotary_account()
    page, card = show(panel, service)
    account = card.locator("[data-rotary]")
    choose(page, "Deutsch")
    card.get_by_text("LinuxCNC").click()
    for width, height in (DESK, PHONE):
        page.set_viewport_size({"width": width, "height": height})
        for text, count in (
            ("48,3 → 1,6 µrad ± 0,7 µrad (k = 2)", 1),
            ("Nicht im Ergebnis", 2),
            ("Nichts", 1),
        ):
            expect(account.locator("dd", has_text=text)).to_have_count(count)
        for text in (
            "21,40 µm ± 0,52 µm",
            "6,32 µm ± 0,41 µm",
            "24,0 → 0,9 µrad",
            "EXC, EYC, EZC, EAC, EBC, AOC, BOC",
        ):
            expect(account).to_contain_text(text)
        assert_fits(page)
        for value in account.locator("dd").all():
            assert value.evaluate("e => e.scrollWidth <= e.clientWidth + 1")


def test_of_two_choices_in_haste_the_last_one_stands(panel, service):
    page, card = show(panel, service)
    held: list = []

    def is_order(request):
        return request.method == "POST" and request.url.endswith("/compensations")

    def hold(route):
        order = json.loads(route.request.post_data or "{}")
        if order.get("format") == "heidenhain":
            held.append(route)
        else:
            route.continue_()

    page.route("**/compensations", hold)
    with page.expect_request(is_order):
        card.get_by_text("Heidenhain TNC").click()
    card.get_by_text("LinuxCNC").click()
    link = card.get_by_role("link", name="Files (ZIP)")
    expect(link).to_be_visible()
    with page.expect_response("**/compensations"):
        held[0].continue_()
    page.evaluate("() => new Promise(requestAnimationFrame)")
    expect(link).to_have_attribute(
        "href", re.compile(FILES.format("linuxcnc-10-hold") + "$")
    )


def test_how_a_format_is_written_is_chosen_on_the_page(panel, service):
    _, card = show(panel, service, language="de")
    card.get_by_text("LinuxCNC").click()
    expect(card.locator("[data-way]")).to_have_count(0)
    card.get_by_text("Heidenhain TNC").click()
    expect(card).to_contain_text("X nicht gemessen von 0 bis 10 und 524,143 bis")
    way = card.get_by_role("group", name="So liest die Steuerung BACKLASH")
    usual = way.get_by_role("button", name="Wert bei negativer Fahrt")
    expect(usual).to_have_attribute("aria-pressed", "true")
    expect(card).to_contain_text("BACKLASH; sie enthält den Wert")
    way.get_by_role("button", name="Zuschlag bei negativer Fahrt").click()
    expect(card).to_contain_text("BACKLASH; sie enthält, was bei negativer Fahrt zur")
    wanted = [body["choices"] for _, path, body in service.requests if "comp" in path]
    word = "backlash_reading"
    assert wanted == [{}, {word: "negative-value"}, {word: "difference"}]


def test_a_simulated_control_is_given_the_files_and_verified_with_them(panel, service):
    page, card = show(panel, service)
    job = page.url.rsplit("/", 1)[1]
    card.get_by_text("LinuxCNC").click()
    load = page.locator("[data-load='linuxcnc-10-hold']")
    load.click()
    unload = page.locator("[data-unload='linuxcnc-10-hold']")
    expect(unload).to_be_visible()
    expect(load).to_have_count(0)
    files = {"job_id": job, "compensation_id": "linuxcnc-10-hold"}
    assert service.loaded_tables == files
    go(page, f"#/verify/{job}")
    chosen = page.locator("#verify-files")
    expect(chosen).to_have_value("linuxcnc-10-hold")
    page.go_back()
    unload.click()
    expect(load).to_be_visible()
    assert service.loaded_tables == {}
    # Files of another result in the control are said on Verify.
    service.loaded_tables = {"job_id": "job-9", "compensation_id": "isg-csv-10-hold"}
    go(page, f"#/verify/{job}")
    said = page.locator(".notice.is-held")
    expect(said).to_contain_text("of another result")
    expect(said.locator("a")).to_have_attribute("href", "#/export/job-9")
    expect(chosen).to_have_value("")


def test_the_machines_own_control_comes_first_with_what_it_would_leave(panel, service):
    service.machines[0]["control"] = "LinuxCNC 2.9"
    page, card = show(panel, service)
    expect(card.get_by_role("radio").first).to_have_text("LinuxCNC")
    expect(card.get_by_role("radio").first).to_be_checked()
    bars = card.locator(".gap i")
    expect(bars).to_have_count(2)
    before, after = (bars.nth(i).bounding_box()["width"] for i in (0, 1))
    assert after / before == pytest.approx(14.32 / 20.72, abs=0.02)
    shown = card.locator(".gap").bounding_box()
    assert shown["y"] + shown["height"] < page.locator("footer").bounding_box()["y"]


def test_export_and_verify_are_ticked_once_they_were_done(panel, service):
    service.verified(verification("job-2"))
    page = panel.open(f"#/result/{service.measured()}")
    steps = page.locator("#steps .step")
    for name, done in (("Export", False), ("Verify", True), ("Discover", False)):
        ticked = steps.filter(has_text=name).and_(page.locator("[data-done]"))
        expect(ticked).to_have_count(int(done))
    go(page, "#/export/job-2")
    page.locator("[data-card=export]").get_by_text("LinuxCNC").click()
    expect(page.locator("[data-card=export] .gap")).to_be_visible()
    go(page, "#/result/job-2")
    ticked = steps.filter(has_text="Export").and_(page.locator("[data-done]"))
    expect(ticked).to_have_count(1)
