"""What every view says: in one language, and in words and not in values of files."""

import contextlib
import re

import pytest
from playwright.sync_api import Page, TimeoutError, expect
from tests.system.page.test_accessibility import views_of_a_calibration

from page_steps import DESK, PHONE, choose, go

UUID = r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"
VALUES = r"(?<![\w.])(?:true|false|null|undefined|NaN|None)(?![\w.])|\[object "
KEYS = r"\b[a-z]+(?:_[a-z0-9]+)+\b"
LITERAL = re.compile("|".join((r"\d{4}-\d\d-\d\dT\d\d:\d\d", UUID, VALUES, KEYS)))
# Files and columns that an operator is asked for bear the names that they have.
FILES = re.compile(r"\b[\w-]+\.(?:csv|json|zip)\b|\bposition_mm\b")
SENSOR = {
    "channel": "air_degC",
    "how": 'address = 12, word_order = "big"',
    "value": 20.5,
}
# What is asked for after the view is there.
LATER = {
    "run": ".path-view[data-drawn]",
    "result": ".map-picture[data-drawn]",
    "discover": "[data-versions] .versions b",
    "export": "[data-format]",
    "records": "td.number:has-text('±')",
    "verify": ".circle-plot",
}
# A view goes on filling in after its first part is there.
SAYS_ALL = """(found) => {
    const said = document.querySelector("main").innerText.split("\\n");
    return found.every((line) => said.includes(line));
}"""


def said(page: Page, view: str, shown: str) -> list[str]:
    go(page, f"#/{view}")
    return lines(page, view, shown)


def lines(page: Page, view: str, shown: str) -> list[str]:
    for selector in (shown, LATER.get(view.split("/")[0], shown)):
        expect(page.locator(selector).first).to_be_visible()
    return page.locator("main").inner_text().splitlines()


def test_a_language_changed_in_place_is_that_of_all_words(panel, service, witness):
    witness.expect("status of 404")  # nothing stands of the machine before
    views = views_of_a_calibration(service)
    opened = panel.open("#/records", language="de")
    changed = panel.open("#/records")
    differing = []
    for view, shown in views.items():
        said(opened, view, shown)
        said(changed, view, shown)
        choose(changed, "Deutsch")
        expect(changed.locator("html")).to_have_attribute("lang", "de")
        found = lines(changed, view, shown)
        with contextlib.suppress(TimeoutError):  # what is missing is named below
            opened.wait_for_function(SAYS_ALL, arg=found)
        wanted = lines(opened, view, shown)
        differing += [(view, line) for line in found if line not in wanted]
        choose(changed, "English")
        expect(changed.locator("html")).to_have_attribute("lang", "en")
    assert differing == []


@pytest.mark.parametrize(("language", "size"), [("en", DESK), ("de", PHONE)])
def test_no_view_has_raw_values_keys_or_times(panel, service, witness, language, size):
    witness.expect("status of 404")  # nothing stands of the machine before
    views = views_of_a_calibration(service)
    for run in service.runs:
        run["name"] = "VMC 500 2026-03-14T08:00:00.129Z"  # as the service names them
    service.machine = service.machine | {"sensors": [SENSOR]}
    page = panel.open("#/records", language=language, size=size)
    found = []
    for view, shown in views.items():
        said(page, view, shown)
        page.locator("main details").evaluate_all(
            "all => all.forEach((one) => { one.open = true; })"
        )
        found += [
            (view, line)
            for line in lines(page, view, shown)
            if LITERAL.search(FILES.sub("", line))
        ]
    assert found == []
