"""The plan is asked for the tracker's place, and says what each station brings."""

from playwright.sync_api import expect

from page_steps import go, prepare


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
    prepare(page)
    right = {"min_mm": [1000, 0, -100], "max_mm": [3000, 400, -100]}
    front = {"min_mm": [-2500, -2500, -100], "max_mm": [3000, -500, -100]}
    areas = [{"name": "Right (+X)", **right}, {"name": "Front (−Y)", **front}]
    wish = {"perpendicular_only": False}
    assert service.orders("/plans") == [
        {
            "mode": "otf",
            "minutes": 3,
            **wish,
            "max_feed_mm_min": 4000,
            "workspace": {"tracker": {"areas": areas}},
            "stations": 2,
        }
    ]
    drive = {"kind": "measure-otf", "plan_id": "plan-1", **wish}
    assert service.orders() == [drive]


def test_the_check_says_places_what_each_brings_and_what_is_advised(panel, service):
    service.plan["place"] = PLACE
    job = service.ready()
    page = panel.open(f"#/check/{job}")
    card = page.locator(".card", has=page.locator(".advised"))
    for text in (
        "Station 2",
        "X −650 mm, Y 200 mm, Z 40 mm",
        "1:30 min; U = 2.40 µm after it",
        "2 stations are advised.",
        "It pays: one place leaves EBZ (Tilt of Z about Y) weak.",
    ):
        expect(card).to_contain_text(text)
    service.change(job, state="aborted")
    expect(page.locator("#state")).to_have_text("Aborted")
    # One chosen place is said before motion.
    service.plan["place"] = PLACE | {
        "at_stations": None,
        "stations": PLACE["stations"] | {"recommended": 1},
    }
    go(page, f"#/check/{service.ready()}")
    card = page.locator(".card", has_text="Stand it at")
    expect(card).to_contain_text("X 1,200 mm, Y 300 mm, Z −80 mm")
    expect(card).to_contain_text("One station is enough.")


def _option(count: int, um: float, pays: bool, because: str | None) -> dict:
    return {
        "count": count,
        "minutes": 3.0,
        "volumetric_uncertainty_um": um,
        "one_place_as_long": {"volumetric_uncertainty_um": 2.0},
        "pays": pays,
        "because": because,
    }


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
        "options": [_option(1, 2.1, False, None), _option(2, 1.3, True, "EBZ")],
    },
}
