"""A result beside a direct measurement that the operator has as a file."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect
from scripted_data import comparison
from test_journey import measured

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

ROWS = b"error,position_mm,direction,value,unit\nEXX,0,+,0.1,um\n"


def choose(card, content: bytes) -> None:
    file = {"name": "laser.csv", "mimeType": "text/csv", "buffer": content}
    card.locator("input[type=file]").set_input_files(file)


@pytest.mark.parametrize(
    ("language", "said", "differs"),
    [
        ("en", "1 of 2 errors differ", "differs"),
        ("de", "1 von 2 Abweichungen", "weicht ab"),
    ],
)
def test_a_result_is_held_against_the_file_with_its_uncertainty(
    panel, service, language, said, differs
):
    service.comparison = comparison()
    result = measured(service)
    page = panel.open(f"#/result/{result}", language=language)
    card = page.locator("[data-card=reference]")
    card.locator("#reference_um").fill("-1")
    expect(card.get_by_role("button")).to_be_disabled()
    card.locator("#reference_um").fill("0,4" if language == "de" else "0.4")
    choose(card, ROWS)
    expect(card).to_contain_text(said)
    sent = service.requests[-1]
    assert sent == ("POST", f"/jobs/{result}/comparisons", ("laser.csv", 0.2, 0.0))
    first = card.locator("tbody tr").first
    expect(first).to_contain_text("C0Y")
    expect(first).to_contain_text(differs)
    expect(card).to_contain_text("EYX")
    report = card.get_by_role("link")
    address = re.compile(comparison()["links"]["report_html"] + "$")
    expect(report).to_have_attribute("href", address)


def test_a_file_that_cannot_be_read_is_named_with_its_row(panel, service, witness):
    witness.expect("422")
    result = measured(service)
    page = panel.open(f"#/result/{result}")
    card = page.locator("[data-card=reference]")
    choose(card, b"x,y\n")
    expect(card.locator(".notice")).to_contain_text("laser.csv, row 1")
    service.comparison = comparison()
    choose(card, ROWS)
    expect(card.locator("tbody tr")).to_have_count(2)
    expect(card.locator(".notice")).to_have_count(0)


def test_who_may_not_compare_is_not_asked_to(panel, service):
    service.log_in_required, service.user = True, ("olga", "operator")
    page = panel.open(f"#/result/{measured(service)}")
    expect(page.locator("[data-card=map]")).to_be_visible()
    expect(page.locator("[data-card=reference]")).to_be_hidden()
