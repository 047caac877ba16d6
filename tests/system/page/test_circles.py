"""Circles that a verification drove on the fly, as a ballbar shows them."""

import re

import numpy as np
import pytest
from playwright.sync_api import Locator, expect

from page_steps import DESK, PHONE, assert_fits, choose, go
from scripted_data import circles_in_motion, verification


def read_radii(path: Locator) -> np.ndarray:
    points = re.findall(r"([\d.]+) ([\d.]+)", path.get_attribute("d") or "")
    return np.linalg.norm(np.array(points, float) - 210.0, axis=1)


def test_a_circle_is_drawn_about_its_centre_with_both_senses_and_its_figures(
    panel, service
):
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
