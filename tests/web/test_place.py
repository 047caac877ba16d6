"""The plan is asked for the tracker's place, and says what each station brings."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

NEXT = "#next button"


def test_stations_are_asked_for_in_areas_beside_the_travel(panel, service):
    service.connected = True
    page = panel.open("#/plan")
    page.locator("[data-place=chosen]").click()
    expect(page.locator("#minutes")).to_have_value("3")
    page.locator(".segments [data-value='2']").click()
    expect(page.locator("#target")).to_be_hidden()
    for side in ("left", "right", "front", "back"):
        page.locator(f"[data-side={side}]").click()
    expect(page.locator("#reason")).to_have_text("Choose at least one free side.")
    page.locator("[data-side=front]").click()
    page.locator("[data-side=right]").click()
    page.locator("#feed").fill("4000")
    page.locator("#height").fill("-100")
    page.locator(NEXT).click()
    page.wait_for_url("**/#/check/*")
    areas = [
        {
            "name": "Right (+X)",
            "min_mm": [1000, 0, -100],
            "max_mm": [3000, 400, -100],
        },
        {
            "name": "Front (−Y)",
            "min_mm": [-2500, -2500, -100],
            "max_mm": [3000, -500, -100],
        },
    ]
    assert service.requests == [
        (
            "POST",
            "/plans",
            {
                "mode": "otf",
                "minutes": 3,
                "perpendicular_only": False,
                "max_feed_mm_min": 4000,
                "workspace": {"tracker": {"areas": areas}},
                "stations": 2,
            },
        ),
        (
            "POST",
            "/jobs",
            {"kind": "measure-otf", "perpendicular_only": False, "plan_id": "plan-1"},
        ),
    ]


@pytest.mark.parametrize(
    ("language", "said"),
    [
        (
            "en",
            [
                "Station 2",
                "X −650 mm, Y 200 mm, Z 40 mm",
                "1:30 min; U = 2.40 µm after it",
                "2 stations are advised.",
                "It pays: one place leaves EBZ (Tilt of Z about Y) weak.",
            ],
        ),
        (
            "de",
            [
                "Standort 2",
                "1:30 min; danach U = 2,40 µm",
                "2 Standorte sind zu empfehlen.",
                "Es lohnt sich: ein Standort lässt EBZ",
            ],
        ),
    ],
)
def test_the_check_says_places_what_each_brings_and_what_is_advised(
    panel, service, language, said
):
    service.connected = True
    service.plan["place"] = PLACE
    job = service.new_job("measure-otf", state="ready")["id"]
    page = panel.open(f"#/check/{job}", language=language)
    card = page.locator(".card", has=page.locator(".advised"))
    for text in said:
        expect(card).to_contain_text(text)


def test_one_chosen_place_is_said_before_motion(panel, service):
    service.connected = True
    service.plan["place"] = PLACE | {
        "at_stations": None,
        "stations": PLACE["stations"] | {"recommended": 1},
    }
    job = service.new_job("measure-otf", state="ready")["id"]
    card = panel.open(f"#/check/{job}").locator(".card", has_text="Stand it at")
    expect(card).to_contain_text("X 1,200 mm, Y 300 mm, Z −80 mm")
    expect(card).to_contain_text("One station is enough.")


def _option(count: int, um: float, **more: object) -> dict[str, object]:
    left = {"volumetric_uncertainty_um": um}
    stay = {"volumetric_uncertainty_um": 2.0}
    return {"count": count, "minutes": 3.0, **left, "one_place_as_long": stay, **more}


PLACE = {
    "tracker": {"position_mm": [1200.0, 300.0, -80.0], "chosen": True},
    "at_stations": [
        {
            "position_mm": place,
            "rows": 20,
            "duration_s": 90.0,
            "volumetric_uncertainty_um": um,
        }
        for place, um in (([1200.0, 300.0, -80.0], 1.8), ([-650.0, 200.0, 40.0], 1.2))
    ],
    "stations": {
        "recommended": 2,
        "move_minutes": 10.0,
        "options": [
            _option(1, 2.1, pays=False, because=None),
            _option(2, 1.3, pays=True, because="EBZ"),
        ],
    },
}
