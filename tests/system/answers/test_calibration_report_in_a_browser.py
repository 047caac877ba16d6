"""The report in a real browser."""

import os
import re
import shutil

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from truepath.answers.calibration_report import render_calibration_report

pytestmark = pytest.mark.ui


@pytest.fixture(scope="module")
def browser():
    executable = os.environ.get("CHROMIUM") or shutil.which("chromium")
    assert executable, "Chromium is not installed"
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=executable)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def file(found, tmp_path_factory):
    place = tmp_path_factory.mktemp("report") / "report.html"
    place.write_text(render_calibration_report(found), encoding="utf-8")
    return place


@pytest.mark.parametrize(("width", "scheme"), [(420, "light"), (1180, "dark")])
def test_the_report_fits_the_screen_and_asks_for_nothing(browser, file, scheme, width):
    screen = {"width": width, "height": 900}
    page = browser.new_page(viewport=screen, color_scheme=scheme)
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    assert said == []
    assert asked == [file.as_uri()]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    style = "getComputedStyle(document.querySelector('{}')).{}".format
    ink = page.evaluate(style("svg text", "fill"))
    paper = page.evaluate(style("section", "backgroundColor"))
    assert contrast(ink, paper) > 4.5


def contrast(*colours):
    """Return the contrast ratio of two CSS colours (WCAG 2.2)."""
    shown = [re.findall(r"[\d.]+", colour)[:3] for colour in colours]
    parts = np.array(shown, float) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    dark, light = np.sort(linear @ [0.2126, 0.7152, 0.0722])
    return (light + 0.05) / (dark + 0.05)


def test_folded_tables_open_on_a_click_and_are_all_printed(browser, file):
    page = browser.new_page(viewport={"width": 1180, "height": 900})
    page.goto(file.as_uri())
    tables = page.locator(".folded table")
    assert tables.count() == 3
    assert not tables.first.is_visible()
    page.locator(".fold label").first.click()
    assert tables.first.is_visible()
    assert not tables.last.is_visible()
    page.emulate_media(media="print")
    assert all(table.is_visible() for table in tables.all())
