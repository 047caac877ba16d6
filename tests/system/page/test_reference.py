"""A result beside a direct measurement that the operator has as a file."""

import re

from playwright.sync_api import expect

from page_steps import choose
from scripted_data import comparison

ROWS = b"error,position_mm,direction,value,unit\nEXX,0,+,0.1,um\n"


def take(card, content: bytes) -> None:
    file = {"name": "laser.csv", "mimeType": "text/csv", "buffer": content}
    card.locator("input[type=file]").set_input_files(file)


def test_a_result_is_held_against_the_file_with_its_uncertainty(
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
    for language, title, typed, said, differs in (
        ("Deutsch", "vergleichen", "0,4", "1 von 2 Abweichungen", "weicht ab"),
        ("English", "Compare", "0.4", "1 of 2 errors differ", "differs"),
    ):
        choose(page, language)
        expect(card.locator("h2")).to_contain_text(title)  # drawn anew
        card.locator("#reference_um").fill("-1")
        expect(card.get_by_role("button")).to_be_disabled()
        card.locator("#reference_um").fill(typed)
        take(card, ROWS)
        expect(card).to_contain_text(said)
        sent = service.requests.pop()
        assert sent == ("POST", f"/jobs/{result}/comparisons", ("laser.csv", 0.2, 0.0))
        first = card.locator("tbody tr").first
        expect(first).to_contain_text("C0Y")
        expect(first).to_contain_text(differs)
        expect(card).to_contain_text("EYX")
        expect(card.locator(".notice")).to_have_count(0)
        address = re.compile(comparison()["links"]["report_html"] + "$")
        expect(card.get_by_role("link")).to_have_attribute("href", address)


def test_who_may_not_compare_is_not_asked_to(panel, service):
    service.log_in_required, service.user = True, ("olga", "operator")
    page = panel.open(f"#/result/{service.measured()}")
    expect(page.locator("[data-card=map]")).to_be_visible()
    expect(page.locator("[data-card=reference]")).to_be_hidden()
