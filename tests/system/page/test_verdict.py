"""What a result says of itself is seen first, in words, in the operator's language."""

import re

from playwright.sync_api import Locator, Page, expect

from page_steps import choose, go, job_of
from scripted_service import ScriptedService
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.files.environment.refraction import CAUSES, Refraction
from truepath.results.result_assessment import assess_air

LEFT_OUT = Reason(
    "samples-left-out",
    "usable",
    {"samples": 42, "line": 7, "from_s": 61.2, "to_s": 61.3, "distance_um": 5012.0},
)
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
SHIFTED = Reason("axis-shifted", "doubtful", {"axes": "X", "by": "+0.42 mm"})
(AIR,) = assess_air(
    [Refraction("nobody", why=CAUSES["no-temperature"])], ["run"]
).reasons
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


def turn_to(page: Page, service: ScriptedService, *reasons: Reason) -> Locator:
    verdict = Verdict(reasons)
    service.result["verdict"] = verdict_json(verdict)
    job = service.measured(verdict=verdict.state)
    go(page, f"#/result/{job}")
    expect(page.locator(".verdict .tile").first).to_be_visible()
    return page.locator(".verdict-band")


def test_a_result_that_is_not_to_be_used_is_loud_and_says_why(panel, service):
    page = panel.open("#/records")
    band = turn_to(page, service, LEFT_OUT, OPEN, BEYOND)
    heading = band.get_by_role("heading")
    expect(heading).to_have_text("Not to be used")
    expect(band).to_have_attribute("role", "alert")
    expect(band.locator("li")).to_have_text(
        [f"{reason} {reason.remedy}" for reason in (BEYOND, OPEN)]
        + [f"{LEFT_OUT} {LEFT_OUT.remedy}".replace("5012.0", "5,012.0")]
    )
    box, first = band.bounding_box(), page.locator(".card.verdict").bounding_box()
    assert box["y"] + box["height"] <= first["y"]
    size = heading.evaluate("e => getComputedStyle(e).fontSize")
    assert float(size.removesuffix("px")) >= 30
    colour = band.evaluate("e => getComputedStyle(e).backgroundColor")
    assert colour == "rgb(179, 19, 31)"
    # Its tables are named so when taken away.
    link, job = page.get_by_role("link", name="CSV"), job_of(page)
    address = f"/api/v1/jobs/{job}/result/error-tables.csv?accept_verdict=true"
    expect(link).to_have_attribute("href", re.compile(re.escape(address) + "$"))
    expect(link).to_have_attribute("download", f"not-to-be-used-{job}.csv")
    # A list and a run that has ended say it, too.
    go(page, f"#/run/{job}")
    fault = page.locator(".notice.is-fault").first
    expect(fault).to_contain_text("Not to be used")
    go(page, "#/records")
    expect(page.locator(".records").first).to_contain_text("Not to be used")
    turn_to(page, service, LEFT_OUT, OPEN, SHIFTED, AIR, BEYOND)
    choose(page, "Deutsch")
    expect(heading).to_have_text("Nicht verwenden")
    rows = band.locator("li")
    expect(rows.nth(0)).to_contain_text("das 3,50-Fache des Rauschens")
    expect(rows.nth(1)).to_contain_text("weichen um 9,0 µm voneinander ab")
    expect(rows.nth(2)).to_contain_text("um +0,42 mm neben ihrem Ort")
    expect(rows.nth(3)).to_contain_text("die Temperatur der Luft wurde nicht gemessen")
    expect(rows.nth(4)).to_contain_text("42 Messpunkte der Geraden 8, von 61,2 s bis")


def test_a_result_that_may_be_used_or_is_doubtful_says_so_quietly(panel, service):
    page = panel.open("#/records")
    band = turn_to(page, service, LEFT_OUT)
    expect(band).to_have_attribute("role", "note")
    expect(band).to_contain_text("The result may be used.")
    expect(band.locator("li")).to_contain_text("42 samples of line 8")
    go(page, "#/records")
    expect(page.locator(".job-state")).to_have_count(1)
    expect(page.locator(".verdict-mark")).to_have_count(0)
    # One with nothing to say has no band.
    turn_to(page, service)
    expect(band).to_have_count(0)
    mark = page.locator(".view-head .verdict-mark")
    expect(mark).to_have_text("May be used")
    turn_to(page, service, OPEN)
    expect(band.get_by_role("heading")).to_have_text("Doubtful")
    assert page.locator(".verdict-mark").count() == 0
    expect(band.locator("li")).to_have_count(1)
    # Words of a later version stand as they are.
    moon = {"kind": "moon", "state": "doubtful", "run": "", "values": {}}
    service.result["verdict"] = {
        "state": "doubtful",
        "reasons": ["The moon is full."],
        "details": [moon | {"remedy": "Wait a fortnight."}],
    }
    go(page, f"#/result/{service.measured()}")
    expect(band.locator("li")).to_have_text("The moon is full. Wait a fortnight.")
