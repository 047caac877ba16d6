"""What an order wants of the error compensation of the control."""

from __future__ import annotations

import pytest

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

NEXT = "#next button"
WISHES = {"en": ("No wish", "Off", "On"), "de": ("Keine Vorgabe", "Aus", "Ein")}


@pytest.mark.parametrize("language", WISHES)
def test_the_order_says_what_is_wanted_and_nothing_without_a_wish(
    panel, service, language
):
    service.connected = True
    none, *wishes = WISHES[language]
    page = panel.open("#/plan", language=language)
    field = page.locator("#control-compensation")

    def order(chosen: str | None) -> dict:
        page.goto(f"{panel.address}/#/plan")
        if chosen:
            field.get_by_role("button", name=chosen, exact=True).click()
        page.locator(NEXT).click()
        page.wait_for_url("**/#/check/*")
        job = page.url.rsplit("/", 1)[1]
        service.change(job, state="aborted")
        return service.requests[-1][2]

    assert "control_compensation" not in order(None)
    assert [order(one)["control_compensation"] for one in wishes] == ["off", "on"]
    assert "control_compensation" not in order(none)
