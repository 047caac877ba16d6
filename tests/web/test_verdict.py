"""What a result says of itself is seen first, in words, in the operator's language."""

from __future__ import annotations

import re
from string import Formatter

import pytest
from playwright.sync_api import expect

from truepath.files.earlier.verdict import (
    SENTENCES,
    TITLES,
    Reason,
    Verdict,
    verdict_json,
)
from truepath.files.environment.refraction import CAUSES, Refraction
from truepath.results.verdict import judge_air
from truepath.service.page.pages import LANGUAGES, catalogue

pytestmark = [pytest.mark.ui, pytest.mark.xdist_group("browser")]

LEFT_OUT = Reason(
    "samples-left-out",
    "usable",
    {"samples": 42, "line": 7, "from_s": 61.2, "to_s": 61.3, "distance_um": 5012.0},
)
OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
SHIFTED = Reason("axis-shifted", "doubtful", {"axes": "X", "by": "+0.42 mm"})
(AIR,) = judge_air(
    [Refraction("nobody", why=CAUSES["no-temperature"])], ["run"]
).reasons
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


def shown(panel, service, *reasons, where="result", **options):
    """Open the page of a job that has ended with a verdict."""
    verdict = Verdict(reasons)
    service.connected = True
    service.result["verdict"] = verdict_json(verdict)
    job = service.new_job("measure-otf", state="running", stage="measuring")
    job["verdict"] = verdict.state
    service.finish(job["id"])
    address = f"#/{where}" if where == "records" else f"#/{where}/{job['id']}"
    return panel.open(address, **options)


def test_a_result_that_is_not_to_be_used_is_loud_and_says_why(panel, service):
    page = shown(panel, service, LEFT_OUT, OPEN, BEYOND)
    band = page.locator(".verdict-band")
    expect(band.get_by_role("heading")).to_have_text("Not to be used")
    expect(band).to_have_attribute("role", "alert")
    expect(band.locator("li")).to_have_text(
        [f"{reason} {reason.remedy}" for reason in (BEYOND, OPEN)]
        + [f"{LEFT_OUT} {LEFT_OUT.remedy}".replace("5012.0", "5,012.0")]
    )
    box, first = band.bounding_box(), page.locator(".card.verdict").bounding_box()
    assert box["y"] + box["height"] <= first["y"]
    size = band.get_by_role("heading").evaluate("e => getComputedStyle(e).fontSize")
    assert float(size.removesuffix("px")) >= 30
    colours = "e => [getComputedStyle(e).backgroundColor, getComputedStyle(e).color]"
    assert band.evaluate(colours)[0] == "rgb(179, 19, 31)"


def test_the_reasons_are_told_in_german(panel, service):
    page = shown(panel, service, LEFT_OUT, OPEN, SHIFTED, AIR, BEYOND, language="de")
    band = page.locator(".verdict-band")
    expect(band.get_by_role("heading")).to_have_text("Nicht verwenden")
    rows = band.locator("li")
    expect(rows.nth(0)).to_contain_text("das 3,50-Fache des Rauschens")
    expect(rows.nth(1)).to_contain_text("weichen um 9,0 µm ab")
    expect(rows.nth(2)).to_contain_text("um +0,42 mm neben ihrem Ort")
    expect(rows.nth(3)).to_contain_text("die Temperatur der Luft wurde nicht gemessen")
    expect(rows.nth(4)).to_contain_text("42 Messpunkte der Geraden 7, von 61,2 s bis")


def test_a_doubtful_result_says_so(panel, service):
    page = shown(panel, service, OPEN)
    band = page.locator(".verdict-band")
    expect(band.get_by_role("heading")).to_have_text("Doubtful")
    assert page.locator(".verdict-mark").count() == 0
    expect(band.locator("li")).to_have_count(1)


def test_what_was_left_out_of_a_usable_result_is_listed_quietly(panel, service):
    band = shown(panel, service, LEFT_OUT).locator(".verdict-band")
    expect(band).to_have_attribute("role", "note")
    expect(band).to_contain_text("The result may be used.")
    expect(band.locator("li")).to_contain_text("42 samples of line 7")


def test_a_result_with_nothing_to_say_has_no_band(panel, service):
    page = shown(panel, service)
    expect(page.locator(".verdict .tile").first).to_be_visible()
    expect(page.locator(".verdict-band")).to_have_count(0)
    mark = page.locator(".view-head .verdict-mark")
    expect(mark).to_have_text("May be used")


def test_a_reason_of_a_later_version_is_told_in_its_own_words(panel, service):
    service.result["verdict"] = {
        "state": "doubtful",
        "reasons": ["The moon is full."],
        "details": [
            {
                "kind": "moon",
                "state": "doubtful",
                "run": "",
                "values": {},
                "remedy": "Wait a fortnight.",
            }
        ],
    }
    service.connected = True
    job = service.new_job("measure-otf", state="running", stage="measuring")
    service.finish(job["id"])
    band = panel.open(f"#/result/{job['id']}").locator(".verdict-band")
    expect(band.locator("li")).to_have_text("The moon is full. Wait a fortnight.")


def test_tables_that_are_not_to_be_used_are_named_so_when_taken_away(panel, service):
    link = shown(panel, service, BEYOND).get_by_role("link", name="CSV")
    address = "/api/v1/jobs/job-1/result/error-tables.csv?accept_verdict=true"
    expect(link).to_have_attribute("href", re.compile(re.escape(address) + "$"))
    expect(link).to_have_attribute("download", "not-to-be-used-job-1.csv")


@pytest.mark.parametrize("where", ["records", "run"])
def test_a_list_and_a_run_that_has_ended_say_it_too(panel, service, where):
    page = shown(panel, service, BEYOND, where=where)
    place = ".records" if where == "records" else ".notice.is-fault"
    expect(page.locator(place).first).to_contain_text("Not to be used")


def test_a_usable_result_is_not_marked_in_the_list(panel, service):
    page = shown(panel, service, LEFT_OUT, where="records")
    expect(page.locator(".job-state")).to_have_count(1)
    expect(page.locator(".verdict-mark")).to_have_count(0)


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("kind", sorted(SENTENCES))
def test_every_reason_has_words_in_every_language(kind, language):
    texts, (english, remedy) = catalogue(language), SENTENCES[kind]
    assert blanks(texts[f"verdict.{kind}"]) == blanks(english)
    assert bool(texts.get(f"verdict.{kind}_remedy")) == bool(remedy)
    if language == "en":
        assert texts[f"verdict.{kind}"] == english
        assert texts.get(f"verdict.{kind}_remedy", "") == remedy
        assert {texts[f"verdict.{s}"] for s in TITLES if s != "usable"} == {
            title for state, title in TITLES.items() if state != "usable"
        }


def blanks(text):
    return {name for _, name, _, _ in Formatter().parse(text) if name}
